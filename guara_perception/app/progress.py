"""A progress bar for people, silent without a terminal."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from guara_perception.progress import Progress


@contextmanager
def progress(what: str) -> Iterator[Progress]:
    """Show a bar on standard error while the block runs; nothing when it is no terminal.

    Args:
        what: what is being done, in a few words.

    Yields:
        A function that is called with the number of items that are done and the number of all.
    """
    if not sys.stderr.isatty() or not sys.stdout.isatty():

        def ignore(done: int, total: int) -> None:
            """There is no terminal."""

        yield ignore
        return
    from rich.console import Console
    from rich.progress import Progress as Bar

    with Bar(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=None)

        def show(done: int, total: int) -> None:
            bar.update(task, completed=done, total=total)

        yield show
