"""Result of one comparison of the suite: a table, its description, and the same as plain numbers."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True, slots=True)
class Section:
    """One comparison of the suite.

    Attributes:
        name: short, by which the targets find it.
        title: heading.
        description: what is compared with what, and in which clock.
        header: names of the columns.
        rows: cells, as printed.
        figures: the same as numbers, JSON values only.
    """

    name: str
    title: str
    description: str
    header: tuple[str, ...]
    rows: list[tuple[str, ...]]
    figures: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Effort:
    """Amount of measurement.

    Attributes:
        rounds: number of rounds of every comparison.
        slow_rounds: number of rounds for contenders that take seconds.
        size, stripes: picture size and number of stripes of the simulated scan.
        synthetic_stripes: number of synthetic stripes per kind of light.
        faulty_sweeps: number of sweeps with faulty triggers.
    """

    rounds: int
    slow_rounds: int
    size: tuple[int, int]
    stripes: int
    synthetic_stripes: int
    faulty_sweeps: int


FULL = Effort(9, 3, (1280, 1024), 70, 70, 200)
QUICK = Effort(3, 1, (1280, 1024), 70, 10, 20)
