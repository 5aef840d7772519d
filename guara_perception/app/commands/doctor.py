"""`guara doctor`: check devices, configuration and machine, and print a remedy for each failure."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import click

from guara_perception.app.options import FILE, DeviceOptions


@click.command(name="doctor")
@click.option("-c", "--calibration", type=FILE, help="calibration.json to check")
@click.option("--devices", type=FILE, help="devices.toml: camera, settings and board to check")
@click.option("--camera", help="camera as listed by --cameras; default: that of --devices, or 0")
@click.option("--trigger", metavar="LINE", help="camera line wired to the board's TRIGGER")
@click.option("--listen", default="tcp/127.0.0.1:7447", help="endpoint on which the node will listen")
@click.option("--scan", type=FILE, help="recorded scan with floor in view, for the drift check")
@click.option("--robot", help="name or folder of the robot, for the drift check; default: that of the scan")
@click.option("--security", type=FILE, help="security folder with the certificates to check")
@click.option("--only", "checks", multiple=True, help="run only this check; repeatable", metavar="NAME")
@click.option(
    "--cameras", "lists_cameras", is_flag=True, help="only list the cameras and how their frames are verified"
)
@click.option("--bring-up", "powers_up", is_flag=True, help="guide you through the first power-up of a new board")
@click.option("--json", "as_json", is_flag=True, help="print one JSON object per check or camera instead")
@click.pass_context
def command(
    context: click.Context,
    devices: Path | None,
    camera: str | None,
    trigger: str | None,
    checks: tuple[str, ...],
    lists_cameras: bool,
    powers_up: bool,
    as_json: bool,
    **looked_at: Any,
) -> None:
    """Check camera, USB board, permissions, Zenoh, certificates, calibration, drift, disk and speed.

    Exit 1 if a check fails.

    The first column of --cameras is the value for --camera and devices.toml. --bring-up guides you step by step and
    records passed steps in bring_up.json. A laser may be connected only after the board has turned off an LED in time.

    \b
    Example:
      guara doctor -c calibration.json
      guara doctor --devices devices.toml --only camera --only board
      guara doctor --cameras
    """
    from guara_perception.app.devices_file import devices_of
    from guara_perception.app.doctor import CHECKS, FAIL, examine
    from guara_perception.exceptions import InvalidInput

    if lists_cameras:
        list_cameras(context, as_json)
        return
    if powers_up:
        from guara_perception.app.bring_up import bring_up

        board = devices_of(DeviceOptions(devices=devices)).laser_board()
        if not bring_up(board, Path.cwd(), ask=lambda question: str(click.prompt(question)), show=click.echo):
            context.exit(1)
        return
    unknown = [name for name in checks if name not in CHECKS]
    if unknown:
        raise InvalidInput(f"--only is {', '.join(unknown)}, allowed: {', '.join(CHECKS)}")
    failed = False
    chosen = devices_of(DeviceOptions(devices=devices, camera=camera, trigger=trigger))
    for name, finding in examine(devices=chosen, folder=Path.cwd(), checks=checks, **looked_at):
        if as_json:
            click.echo(json.dumps({"name": name, **dataclasses.asdict(finding)}))
        else:
            click.echo(f"{finding.level:<5} {name:<12} {finding.message}")
        failed |= finding.level == FAIL
    if failed:
        context.exit(1)


def list_cameras(context: click.Context, as_json: bool) -> None:
    """Print the cameras found; exit 1 if there are none."""
    from guara_perception.app.doctor import find_cameras

    found, missing = find_cameras()
    for camera in found:
        if as_json:
            click.echo(json.dumps(dataclasses.asdict(camera)))
            continue
        click.echo(f"{camera.source}  {camera.description}")
        click.echo(f"    {camera.evidence}")
        if camera.lines:
            click.echo(f"    --trigger {' or '.join(camera.lines)}")
    if missing:
        click.echo(missing, err=True)
    if not found:
        click.echo("no camera found: check cable and power, and that your user is in the group `video`", err=True)
        context.exit(1)
