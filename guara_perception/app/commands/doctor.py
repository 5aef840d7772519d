"""`guara doctor`: what works on this machine, and how to mend what does not."""

from __future__ import annotations

import json
from pathlib import Path

import click


@click.command(name="doctor")
@click.option("-c", "--calibration", type=click.Path(path_type=Path), help="calibration.json to check")
@click.option("--devices", type=click.Path(path_type=Path), help="devices.toml: camera, settings and board to check")
@click.option("--camera", help="as `guara cameras` lists it; default: that of --devices, or 0")
@click.option("--trigger", metavar="LINE", help="line of the camera that the board triggers")
@click.option("--listen", default="tcp/127.0.0.1:7447", show_default=True, help="where the node would listen")
@click.option("--scan", type=click.Path(path_type=Path), help="recorded scan with floor in view, for the drift check")
@click.option("--security", type=click.Path(path_type=Path), help="security folder whose certificates to check")
@click.option("--only", "checks", multiple=True, help="run only this check; repeatable", metavar="NAME")
@click.option("--json", "as_json", is_flag=True, help="print one JSON object per check instead")
@click.pass_context
def command(
    context: click.Context,
    calibration: Path | None,
    devices: Path | None,
    camera: str | None,
    trigger: str | None,
    listen: str,
    scan: Path | None,
    security: Path | None,
    checks: tuple[str, ...],
    as_json: bool,
) -> None:
    """Check camera, USB board, permissions, Zenoh, calibration, disk and speed; exit 1 when something must be mended.

    \b
    Example:
      guara doctor -c calibration.json
      guara doctor --devices devices.toml --only camera --only board
    """
    from guara_perception.app.devices_file import devices_of
    from guara_perception.app.doctor import CHECKS, FAIL, examine
    from guara_perception.exceptions import InvalidInput

    unknown = [name for name in checks if name not in CHECKS]
    if unknown:
        raise InvalidInput(f"--only is {', '.join(unknown)}, allowed: {', '.join(CHECKS)}")
    failed = False
    for finding in examine(
        devices=devices_of(devices, camera=camera, trigger=trigger),
        calibration=calibration,
        listen=listen,
        folder=Path.cwd(),
        scan=scan,
        checks=checks,
        security=security,
    ):
        if as_json:
            click.echo(json.dumps({"name": finding.name, "level": finding.level, "message": finding.message}))
        else:
            click.echo(f"{finding.level:<5} {finding.name:<12} {finding.message}")
        failed |= finding.level == FAIL
    if failed:
        context.exit(1)
