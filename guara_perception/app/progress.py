"""Progress bar on a terminal, silent without one."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from guara_perception.progress import Progress


@contextmanager
def progress(what: str) -> Iterator[Progress]:
    """Show a bar on standard error while the block runs; nothing without a terminal.

    Args:
        what: the work, in a few words.

    Yields:
        A function that is called with the number of items that are done and the number of all.
    """
    if not sys.stderr.isatty() or not sys.stdout.isatty():
        yield lambda done, total: None
        return
    from rich.console import Console
    from rich.progress import Progress as Bar

    with Bar(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)
