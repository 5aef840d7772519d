"""Progress bar of the command line."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from guara_perception.progress import Progress


@contextmanager
def progress(what: str) -> Iterator[Progress]:
    """Show a progress bar on standard error while the block runs.

    No bar is shown unless standard output and standard error are terminals.

    Args:
        what: short description of the work.

    Yields:
        Function to call with the number of items done and the total number of items.
    """
    if not sys.stderr.isatty() or not sys.stdout.isatty():
        yield lambda done, total: None
        return
    from rich.console import Console
    from rich.progress import Progress as Bar

    with Bar(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)
