"""`guara convert`: convert recordings, scans and grids between formats, and repair damaged recordings."""

from __future__ import annotations

from pathlib import Path

import click

from guara_perception.app.options import FILE
from guara_perception.app.progress import progress
from guara_perception.exceptions import InvalidInput
from guara_perception.terrain.layers.layered_grid import EXTENTS

# Endings of files to which grids are exported for other tools.
GRID_ENDINGS = (".ply", ".pcd", ".csv")

file_argument = click.argument("source", type=FILE)
step_option = click.option(
    "--step", type=int, help="pause to convert from a recording; default: its only scan or last grid"
)
extent_option = click.option(
    "--extent", type=click.Choice(EXTENTS), help="kind of grid in a recording; default: footprint"
)


@click.command(name="convert")
@file_argument
@click.argument("target", type=FILE)
@step_option
@extent_option
@click.option("-c", "--calibration", type=FILE, help="calibration.json to store; default: that of the scan")
def command(source: Path, target: Path, step: int | None, extent: str | None, calibration: Path | None) -> None:
    """Convert SOURCE to TARGET, depending on the kind of SOURCE and the ending of TARGET.

    \b
    scan folder -> .mcap       recording of the scan
    .mcap -> folder            scan folder
    .mcap -> .mcap             copy of the intact data up to the first damaged record, with an index
    .npz, .mcap -> .ply, .pcd  points of a grid, one per known cell
    .npz, .mcap -> .csv        cells of a grid, one per line; unknown cells with the cause

    A copy of a recording leaves out damaged chunks.

    \b
    Example:
      guara convert scans/paper paper.mcap
      guara convert cut.mcap whole.mcap
      guara convert walk.mcap map.csv --extent map
    """
    is_grid = target.suffix in GRID_ENDINGS or source.suffix == ".npz"
    if calibration is not None and (is_grid or source.suffix == target.suffix == ".mcap"):
        raise InvalidInput(
            f"-c is only for a scan that becomes a recording or a folder, not for {target}: leave it out"
        )
    if is_grid:
        export_grid(source, target, step, extent)
        return
    if extent is not None:
        raise InvalidInput(
            f"--extent is only for targets {', '.join(GRID_ENDINGS)}, not for {target}: leave --extent out"
        )
    if source.suffix == target.suffix == ".mcap":
        if step is not None:
            raise InvalidInput("--step is given, but a repaired recording keeps all pauses: leave --step out")
        repair(source, target)
        return
    from guara_perception.app.files.convert import convert

    with progress("Converting") as show:
        convert(source, target, step=step, calibration=calibration, progress=show)
    click.echo(f"{target}: written")


def export_grid(source: Path, target: Path, step: int | None, extent: str | None) -> None:
    """Export a grid to a file for other tools."""
    from guara_perception.app.files.export import export_terrain
    from guara_perception.app.files.recording import open_grid

    count = export_terrain(open_grid(source, step, extent), target)
    click.echo(f"{target}: {count} {'cells' if target.suffix == '.csv' else 'points'}")


def repair(source: Path, target: Path) -> None:
    """Copy the intact data of a recording up to the first damaged record, without damaged chunks, to a new file."""
    from guara_perception.files import existing_file
    from transport.recording import recover_recording

    result = recover_recording(existing_file(source), target)
    state = "the source was complete" if result.was_whole else f"{result.bytes_lost} bytes at the end were lost"
    damaged = f"; damaged chunks skipped: {result.damaged_chunks}" if result.damaged_chunks else ""
    click.echo(f"{target}: {result.messages} messages, {result.attachments} attachments; {state}{damaged}")


@click.command(name="export", hidden=True)
@file_argument
@click.option("-o", "--out", required=True, type=FILE, help="file to write: .ply, .pcd or .csv")
@step_option
@extent_option
def export(source: Path, out: Path, step: int | None, extent: str | None) -> None:
    """Write a grid for other tools: `guara convert SOURCE OUT`.

    \b
    Example:
      guara export terrain.npz -o terrain.ply
    """
    export_grid(source, out, step, extent)


@click.command(name="recover", hidden=True)
@file_argument
@click.option("-o", "--out", type=FILE, help="new file; default: SOURCE-recovered.mcap")
def recover(source: Path, out: Path | None) -> None:
    """Copy the intact data of a damaged .mcap up to the first damaged record: `guara convert SOURCE OUT.mcap`.

    Damaged chunks are skipped.

    \b
    Example:
      guara recover walk.mcap -o whole.mcap
    """
    repair(source, out or source.with_name(f"{source.stem}-recovered{source.suffix}"))
