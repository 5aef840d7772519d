"""`guara info`: describe the contents of a file or folder."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from guara_perception.app.options import FILE

# Length above which a list is abbreviated, since a walk can have hundreds of scans; --json prints all entries.
LONGEST_LIST = 8


@click.command(name="info")
@click.argument("file", type=FILE)
@click.option("--json", "as_json", is_flag=True, help="print one JSON object instead")
def command(file: Path, as_json: bool) -> None:
    """Describe FILE: a grid, recording, calibration, or the folder of a scan, session or robot.

    \b
    Example:
      guara info terrain.npz
      guara info walk.mcap --json
    """
    from guara_perception.app.files.info import describe_file

    found = describe_file(file)
    if as_json:
        click.echo(json.dumps(found))
        return
    for name, value in found.items():
        click.echo(f"{name.replace('_', ' ') + ':':<20} {_text_of(value)}")


def _text_of(value: Any) -> str:
    if value in (None, [], {}):
        return "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, dict):
        return ", ".join(f"{name} {_text_of(entry)}" for name, entry in value.items())
    if isinstance(value, list):
        between = "; " if isinstance(value[0], dict) else ", "
        texts = list(map(_text_of, value))
        if len(texts) > LONGEST_LIST:
            return between.join([*texts[:3], "...", texts[-1]]) + f" ({len(texts)} in all)"
        return between.join(texts)
    return str(value)
