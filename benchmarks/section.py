"""Result of one comparison of the suite: a table and its description."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from benchmarks.command import Table, columns_of


@dataclass(frozen=True, slots=True)
class Section:
    """One comparison of the suite.

    Attributes:
        name: short, by which the targets find it.
        title: heading.
        description: what is compared with what, and in which clock.
        columns: names and formats of the columns, as in `Table`.
        rows: values; None is printed as "-".
    """

    name: str
    title: str
    description: str
    columns: str
    rows: list[tuple[Any, ...]]

    @property
    def header(self) -> tuple[str, ...]:
        """Names of the columns."""
        return tuple(name for name, _ in columns_of(self.columns))

    def table(self, *, markdown: bool = False) -> str:
        """The table as text, in columns or as Markdown."""
        lines: list[str] = []
        table = Table(self.columns, markdown=markdown, write=lines.append)
        for row in self.rows:
            table.row(*row)
        return "\n".join(lines)


@dataclass(frozen=True, slots=True)
class Effort:
    """Amount of measurement.

    Attributes:
        rounds: number of rounds of every comparison.
        slow_rounds: number of rounds for contenders that take seconds.
        size, stripes: picture size and number of stripes of the simulated scan.
        synthetic_stripes: number of synthetic stripes per kind of light.
    """

    rounds: int
    slow_rounds: int
    size: tuple[int, int]
    stripes: int
    synthetic_stripes: int


FULL = Effort(9, 3, (1280, 1024), 70, 70)
QUICK = Effort(3, 1, (1280, 1024), 70, 10)
