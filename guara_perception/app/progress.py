"""A progress bar for people, silent where nobody watches."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def progress(what: str, total: int) -> Iterator[Callable[..., None]]:
    """Show a bar on standard error while the block runs; nothing when it is no terminal.

    Args:
        what: a few words.
        total: number of items.

    Yields:
        A function that takes the number of items just done (default 1).
    """
    if not sys.stderr.isatty() or not sys.stdout.isatty():

        def ignore(items: int = 1) -> None:
            """Nobody watches."""

        yield ignore
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=total)

        def advance(items: int = 1) -> None:
            bar.advance(task, items)

        yield advance
