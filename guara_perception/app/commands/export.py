"""`guara export`: a grid as PLY, PCD or CSV."""

from __future__ import annotations

from pathlib import Path

import click

from guara_perception.terrain.layers.layered_grid import EXTENTS


@click.command(name="export")
@click.argument("grid", type=click.Path(path_type=Path))
@click.option("-o", "--out", required=True, type=click.Path(path_type=Path), help="file to write: .ply, .pcd or .csv")
@click.option("--step", type=int, help="which pause of a recording; default: its last")
@click.option("--extent", type=click.Choice(EXTENTS), help="which grid of a recording; default: footprint")
def command(grid: Path, out: Path, step: int | None, extent: str | None) -> None:
    """Write GRID (.npz, or a grid of an .mcap recording) for other tools.

    PLY and PCD hold a point per known cell, CSV a line per cell with the cause where it is unknown.

    \b
    Example:
      guara export terrain.npz -o terrain.ply
      guara export walk.mcap --extent map -o map.csv
    """
    from guara_perception.app.files.export import export_terrain
    from guara_perception.app.files.open_grid import open_grid

    count = export_terrain(open_grid(grid, step, extent), out)
    click.echo(f"{out}: {count} {'cells' if out.suffix == '.csv' else 'points'}")
