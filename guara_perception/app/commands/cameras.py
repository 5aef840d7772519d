"""`guara cameras`: the cameras of this machine."""

from __future__ import annotations

import dataclasses
import json

import click


@click.command(name="cameras")
@click.option("--json", "as_json", is_flag=True, help="print one JSON object per camera instead")
@click.pass_context
def command(context: click.Context, as_json: bool) -> None:
    """List the cameras of this machine with what each can prove of its frames; exit 1 when there is none.

    The first column is what --camera of the other commands takes.

    \b
    Example:
      guara cameras
    """
    from guara_perception.app.find_cameras import find_cameras

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
        click.echo("no camera found: check cable, power and that your user is in the group `video`", err=True)
        context.exit(1)
