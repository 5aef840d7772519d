"""Options of the programs, their parts, and tables that are printed row by row."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any


def options(text: str | None, **declared: tuple[Any, ...]) -> argparse.Namespace:
    """Read the options of a program from the command line.

    Args:
        text: description in its help.
        declared: by name, default and help, and further keywords of `add_argument`. A name in capitals is a positional
            argument, a type as default means that there is none, False is a flag, a list takes several values.
    """
    parser = argparse.ArgumentParser(description=text, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, (default, explained, *more) in declared.items():
        keywords: dict[str, Any] = dict(*more)
        if default is False:
            keywords["action"] = "store_true"
        else:
            one = default[0] if isinstance(default, list) else default
            keywords |= {"default": default, "type": type(one)}
            if isinstance(default, type):
                keywords |= {"default": None, "type": default}
            elif isinstance(default, list):
                keywords["nargs"] = "+"
        parser.add_argument(
            name.lower() if name.isupper() else f"--{name.replace('_', '-')}", help=explained, **keywords
        )
    return parser.parse_args()


def run_part(program: str, parts: Mapping[str, Callable[[], None]]) -> None:
    """Run the part named by the first argument; without one, list the parts and exit with 2."""
    name = sys.argv[1] if len(sys.argv) > 1 else "--help"
    if name in parts:
        del sys.argv[1]
        sys.argv[0] = f"benchmarks {program} {name}"
        parts[name]()
        return
    help_is_asked = name in ("-h", "--help")
    lines = [f"  {each:<14} {(run.__doc__ or '').splitlines()[0]}" for each, run in parts.items()]
    text = "\n".join([f"usage: benchmarks {program} PART ...; parts:", *lines])
    print(text, file=None if help_is_asked else sys.stderr)
    sys.exit(0 if help_is_asked else 2)


def columns_of(text: str) -> list[tuple[str, str]]:
    """Names of columns and formats of their values, from a text such as "scan:<20 | mean mm:7.3f"."""
    pairs = (column.strip().rsplit(":", 1) for column in text.split("|"))
    return [(name, form) for name, form in pairs]


class Table:
    """Table that is printed row by row, in columns or as Markdown."""

    def __init__(self, columns: str, *, markdown: bool = False, write: Callable[[str], object] | None = None) -> None:
        """Print the head; `columns` are as in `columns_of`, `write` takes each line."""
        self._columns = columns_of(columns)
        self._markdown, self._write = markdown, write or partial(print, flush=True)
        self._print([name for name, _ in self._columns])
        if markdown:
            self._print(["---"] * len(self._columns))

    def row(self, *values: Any) -> None:
        """Print a row; None as "-"."""
        pairs = zip(values, self._columns, strict=True)
        self._print(["-" if value is None else f"{value:{form}}" for value, (_, form) in pairs])

    def _print(self, cells: list[str]) -> None:
        if self._markdown:
            self._write(f"| {' | '.join(cell.strip() for cell in cells)} |")
            return
        padded = []
        for cell, (name, form) in zip(cells, self._columns, strict=True):
            width = max(len(name), int("0" + re.sub(r"\..*|\D", "", form)))
            padded.append(cell.ljust(width) if "<" in form else cell.rjust(width))
        self._write("  ".join(padded).rstrip())
