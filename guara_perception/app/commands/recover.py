"""`guara recover`: a recording that was cut short becomes readable again."""

from __future__ import annotations

from pathlib import Path

import click


@click.command(name="recover")
@click.argument("file", type=click.Path(path_type=Path))
@click.option("-o", "--out", type=click.Path(path_type=Path), help="new file; default: FILE-recovered.mcap")
def command(file: Path, out: Path | None) -> None:
    """Copy all that is whole in FILE, a cut or damaged .mcap, into a new file with an index.

    \b
    Example:
      guara recover walk.mcap -o whole.mcap
    """
    from guara_perception.exceptions import MissingFile
    from transport.recording import recover_recording

    if not file.is_file():
        raise MissingFile(f"{file}: no such file")
    target = out or file.with_name(f"{file.stem}-recovered{file.suffix}")
    result = recover_recording(file, target)
    state = "it was whole" if result.was_whole else f"{result.bytes_lost} bytes at the end were lost"
    damaged = f", {result.damaged_chunks} damaged pieces left out" if result.damaged_chunks else ""
    click.echo(f"{target}: {result.messages} messages, {result.attachments} attachments; {state}{damaged}")
