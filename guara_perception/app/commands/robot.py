"""`guara robot`: create and check a robot folder, test its rangefinder, and install its node as a service."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import click

from guara_perception.app.commands import acceptance, service
from guara_perception.app.options import FILE


@click.group(name="robot")
def command() -> None:
    """Create and check a robot folder, test the rangefinder, and install the node as a service.

    \b
    Example:
      guara robot new my_robot.urdf -o robots/mine
      guara robot check robots/mine --picture mine.png
    """


command.add_command(acceptance.command)
command.add_command(service.command)


@command.command(name="new")
@click.argument("urdf", type=FILE)
@click.option("-o", "--out", type=FILE, required=True, help="folder to create")
@click.option("--name", help="name of the robot; default: that of the folder")
@click.option(
    "--height",
    type=click.FloatRange(0.02, 5.0),
    help="height of the hips above the soles during a scan [m]; default: chosen for the reach of the legs",
)
def new(urdf: Path, out: Path, name: str | None, height: float | None) -> None:
    """Create a robot folder from a URDF.

    It contains robot.toml, URDF, SRDF and README. Legs, feet, soles, postures, camera and laser mounts, scan pattern
    and limits are proposed, each with its reason. The table [assumed] of robot.toml lists the values to be measured
    before the robot walks.

    \b
    Example:
      guara robot new a1.urdf -o robots/mine
    """
    from guara_perception.app.robot_folder.folder_texts import assumed, camera_height
    from guara_perception.app.robot_folder.new_robot import new_robot
    from guara_perception.app.robot_folder.propose import kind_of

    made = new_robot(urdf, out, name=name, hip_height=height)
    for leg, found in zip(made.leg_configs, made.legs, strict=True):
        click.echo(f"{leg.name}: {kind_of(found.leg, found.foot)}, hip {leg.hip}, joints {', '.join(leg.joints)}")
    x, y, camera = made.mounts.area_x, made.mounts.area_y, camera_height(made, made.scan)
    click.echo(
        f"scan posture: hips at {made.scan.hip_height:.3f} m, camera at {camera:.3f} m; area: "
        f"x {x[0]:.2f} ... {x[1]:.2f}, y {y[0]:.2f} ... {y[1]:.2f} m; soles {made.sole[0]:.3f} x {made.sole[1]:.3f} m"
    )
    for text in made.urdf.notes:
        click.echo(f"not used or not checked: {text}", err=True)
    click.echo(f"{out}: {len(assumed(made))} values are assumed; its README.md describes how to measure them")
    click.echo(f"next: guara robot check {shlex.quote(str(out))}")


@command.command(name="check")
@click.argument("folder", type=FILE)
@click.option("--picture", type=FILE, help="draw robot, scanned area, camera and laser to this .png file")
@click.option("--walk", is_flag=True, help="also simulate a walk of ten pauses with scans")
@click.option("--view", is_flag=True, help="show the robot in a browser until Ctrl-C (extra `view`)")
@click.option("--port", type=click.IntRange(1, 65535), default=8080, help="port of the page of --view")
@click.option("--json", "as_json", is_flag=True, help="print one JSON object with all findings instead")
@click.pass_context
def check(
    context: click.Context, folder: Path, picture: Path | None, walk: bool, view: bool, port: int, as_json: bool
) -> None:
    """Report everything that is wrong or doubtful in a robot folder.

    FOLDER may also be the name of a robot. Exit 0: sound; 1: something is wrong; 2: the folder cannot be used. Notes do
    not affect the exit code.

    \b
    Example:
      guara robot check robots/mine --picture mine.png
    """
    from guara_perception.app.progress import progress
    from guara_perception.app.robot_folder.check import check_robot, walk_findings
    from guara_perception.app.robot_folder.finding import Weight
    from guara_perception.app.robot_folder.trial_walk import trial_walk

    def report(text: str) -> None:
        click.echo(text, err=as_json)

    if as_json and view:
        raise click.UsageError("--json and --view are mutually exclusive: a page is served until Ctrl-C")
    robot, findings = check_robot(folder)
    found: dict[str, object] = {"folder": str(folder), "robot": robot and robot.name}
    usable = None if any(finding.weight is Weight.UNUSABLE for finding in findings) else robot
    if usable is not None and walk:
        with progress("Walking") as advance:
            walked = trial_walk(usable, progress=advance)
        report(f"simulated walk: {walked.pauses} pauses, {walked.feet} footholds, {walked.known:.0%} of the area known")
        found["walk"] = {"pauses": walked.pauses, "footholds": walked.feet, "known": walked.known}
        findings += walk_findings(walked)
    if usable is not None and picture is not None:
        from guara_perception.app.robot_folder.show import draw_robot

        draw_robot(usable, picture)
        report(f"picture: {picture}")
    in_order = [finding for weight in Weight for finding in findings if finding.weight is weight]
    worst = in_order[0].weight if in_order else Weight.NOTE
    notes = sum(finding.weight is Weight.NOTE for finding in findings)
    if as_json:
        verdict = "sound" if worst is Weight.NOTE else worst.value
        click.echo(json.dumps({**found, "verdict": verdict, "findings": [finding.to_dict() for finding in in_order]}))
    else:
        for finding in in_order:
            click.echo(str(finding))
        verdict = "sound" if worst is Weight.NOTE else _count(len(findings) - notes, "finding")
        click.echo(f"{folder}: {verdict}, {_count(notes, 'note')}")
    if usable is not None and view:
        from guara_perception.app.robot_folder.show import show_robot

        show_robot(usable, port)
    context.exit({Weight.UNUSABLE: 2, Weight.WRONG: 1, Weight.NOTE: 0}[worst])


def _count(number: int, what: str) -> str:
    return f"{number} {what}" if number == 1 else f"{number} {what}s"
