"""`guara convert`: a recorded scan from folder to MCAP and back."""

from __future__ import annotations

from pathlib import Path

import click

from guara_perception.app.progress import progress


@click.command(name="convert")
@click.argument("source", type=click.Path(path_type=Path))
@click.argument("target", type=click.Path(path_type=Path))
@click.option("--step", type=int, help="which scan of a recording that holds several")
def command(source: Path, target: Path, step: int | None) -> None:
    """Convert the scan SOURCE (folder or .mcap) into TARGET (the other kind).

    \b
    Example:
      guara convert scans/paper paper.mcap
    """
    from guara_perception.app.files.convert import convert

    with progress("Converting") as show:
        convert(source, target, step=step, progress=show)
    click.echo(f"{target}: written")
