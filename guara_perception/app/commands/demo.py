"""`guara demo`: walk a simulated robot, from scans to footholds, and check the result."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click
from click.core import ParameterSource

from guara_perception.app.options import FILE
from guara_perception.app.progress import progress
from guara_perception.files import check_folder
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK

if TYPE_CHECKING:
    from guara_perception.app.demo.walk import DemoPause


# Largest number of gait cycles of a crossing; initial distance of the hind feet behind the world's origin [m].
COURSE_CYCLES, HIND_M = 20, 0.4


@click.command(name="demo")
@click.option(
    "--out", type=FILE, default=Path("out/demo"), help="folder for the pictures, and for the recording of a walk"
)
@click.option("--view", is_flag=True, help="show the recording in a browser afterwards (extra `view`)")
@click.option("--cycles", type=click.FloatRange(1, 12), default=10, help="number of gait cycles (140 mm each)")
@click.option("--robot", default="guara", help="name or folder of the robot")
@click.option("--world", default="demo", help="terrain and light: demo, sunlit or a world file")
@click.option(
    "--course",
    metavar="stones|FILE",
    help="instead of a walk: cross stepping stones or the ground of a world file, with strides fitted to the ground",
)
@click.option(
    "--sway",
    type=click.FloatRange(0.05, 2.0),
    help="instead of a walk: scan from a swaying body; amplitude of the sway [degrees]",
)
@click.pass_context
def command(
    context: click.Context,
    out: Path,
    view: bool,
    cycles: float,
    robot: str,
    world: str,
    course: str | None,
    sway: float | None,
) -> None:
    """Walk a simulated robot over mixed terrain; scan, publish and choose footholds at every pause.

    The planner runs in a second process and receives the grids over Zenoh. The pictures and a recording of the
    walk are written to the folder --out. Exit 1 if the demo's own check fails.

    With --course, the planner fits the strides to the ground, for instance to stepping stones. A picture and
    an animation of the crossing are written to the folder, but no recording.

    With --sway, a robot scans while its body sways, with and without a joint stream, and while its body is still. A
    picture of the three scans is written to the folder, but no recording.

    \b
    Example:
      guara demo --out out/demo
      guara demo --world sunlit --cycles 2 --out out/sunlit
      guara demo --course stones --out out/stones
      guara demo --sway 0.5 --out out/sway
    """
    from guara_perception.app.demo.check import DemoCheck
    from guara_perception.app.demo.pictures import draw_demo
    from guara_perception.app.demo.walk import PAUSES_PER_CYCLE, demo_walk, first_recorded

    if course is not None and sway is not None:
        raise click.UsageError("--course and --sway were both given; allowed: one of them")
    for chosen, unused in ((course, ("view", "cycles", "world")), (sway, ("view", "cycles"))):
        for name in unused if chosen is not None else ():
            if context.get_parameter_source(name) is ParameterSource.COMMANDLINE:
                raise click.UsageError(
                    f"--{name} was given with {'--sway' if course is None else '--course'}, which does not use it; "
                    "allowed: one of them"
                )
    check_folder(out)
    out.mkdir(parents=True, exist_ok=True)
    if sway is not None:
        show_sway(context, out, robot, world, sway)
        return
    if course is not None:
        show_course(context, out, robot, course)
        return
    recording = out / "walk.mcap"
    recording.unlink(missing_ok=True)
    check = DemoCheck()
    pauses = round(cycles * PAUSES_PER_CYCLE) + 1
    seen: list[DemoPause] = []
    with progress("Walking") as show:
        for item in demo_walk(check, recording=recording, cycles=cycles, robot_name=robot, world=world):
            click.echo(line(item))
            seen.append(item)
            show(len(seen), pauses)
    for picture in draw_demo(out, seen):
        click.echo(f"picture: {picture}")
    size, first = recording.stat().st_size / 1e6, first_recorded(cycles)
    part = f"the last {pauses - first} of {pauses} pauses" if first else "every pause"
    click.echo(f"recording: {recording}, {size:.0f} MB, {part}")
    judge(context, check.lines(), check.failures(pauses))
    if view:
        from guara_perception.app.commands.view import command as view_command

        context.invoke(view_command, file=recording)


def show_course(context: click.Context, out: Path, robot: str, course: str) -> None:
    """Cross a course, and write a picture and an animation of the crossing to a folder."""
    from guara_perception.app.demo.check import DemoCheck
    from guara_perception.app.demo.pictures import draw_course
    from guara_perception.app.demo.walk import demo_walk, goal_of
    from guara_perception.simulation.world import load_world
    from guara_perception.terrain.drawing.style import styled

    check, ground, seen = DemoCheck(), load_world(course), []
    goal = goal_of(ground)
    walk = demo_walk(check, recording=None, cycles=COURSE_CYCLES, robot_name=robot, world=course, is_course=True)
    with progress("Crossing") as show:
        for item in walk:
            click.echo(line(item))
            seen.append(item)
            hindmost = min(sole[0] for sole in item.pause.soles_in_world.values())
            show(round(1e3 * max(hindmost + HIND_M, 0)), round(1e3 * (goal + HIND_M)))
    with styled():
        for picture in draw_course(out, ground, goal, seen):
            click.echo(f"picture: {picture}")
    failures = check.failures(len(seen))
    if hindmost <= goal:
        failures.append(f"not across after {len(seen) - 1} steps: hindmost foot at x {hindmost:.2f} of {goal:.2f} m")
    judge(context, check.lines(), failures)


def show_sway(context: click.Context, out: Path, robot: str, world: str, degrees: float) -> None:
    """Scan from a still and from a swaying body, and write a picture of the scans to a folder."""
    from guara_perception.app.demo.sway import draw_sway, scans_beside, sway_failures, sway_lines

    scans = []
    with progress("Scanning") as show:
        for each in scans_beside(robot, world, degrees):
            scans.append(each)
            show(len(scans), 3)
    draw_sway(out / "sway.png", scans)
    click.echo(f"picture: {out / 'sway.png'}")
    judge(context, sway_lines(scans), sway_failures(scans))


def judge(context: click.Context, lines: list[str], failures: list[str]) -> None:
    """Print the results and the verdict; exit 1 if a condition failed."""
    for text in lines:
        click.echo(text)
    if failures:
        click.echo("the demo's check failed: " + "; ".join(failures), err=True)
        context.exit(1)
    click.echo("the demo's check passed")


def line(item: DemoPause) -> str:
    """Summary of a pause as one line of text."""
    record = item.terrain.scan_record
    counts = record.hazard_cells or {}
    duration = ((record.scan_end or 0) - (record.scan_start or 0)) * 1e-9
    unknown = int(((item.terrain.hazard & UNKNOWN_MASK) != 0).sum())
    most = sorted((name for name, n in counts.items() if n), key=lambda name: -counts[name])[:3]
    where = "the walk ends here"
    if item.foothold is not None:
        x, y, z = item.answer["foothold"]
        ground = "scanned" if item.foothold.is_scanned else "declared"
        where = f"{item.foothold.leg} to x {x:+.3f} y {y:+.3f} z {z:+.3f} on {ground} ground"
    return (
        f"step {item.pause.step:>2}  {record.mode} {record.stripes_used} stripes "
        f"{duration:.1f} s  coverage {record.coverage or 0.0:4.0%}  "
        f"unknown {unknown:>4}  {' '.join(most):<28}  error {1e3 * item.error:.2f} mm  {where}"
    )
