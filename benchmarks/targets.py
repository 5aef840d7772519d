"""Target figures of this project, compared with their limits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from benchmarks.memory import BY_STRIPE
from benchmarks.rounds import Ratio
from benchmarks.scans import LATENCY
from benchmarks.section import Section

PRECISE = "ours: precise"


@dataclass(frozen=True, slots=True)
class Target:
    """One figure.

    Attributes:
        what: text that says what is measured.
        must, goal: limits; the value may not be larger.
        path: section, first values of the row, and column; SCAN stands for the name of the standard scan.
    """

    what: str
    must: float
    goal: float
    path: tuple[str, ...]

    def value(self, sections: Mapping[str, Section], scan: str) -> float:
        """The measured figure."""
        name, *keys, column = (scan if key == SCAN else key for key in self.path)
        section = sections[name]
        (row,) = [row for row in section.rows if row[: len(keys)] == tuple(keys)]
        value = row[section.header.index(column)]
        return value.median if isinstance(value, Ratio) else float(value)


SCAN, RATIO = "the standard scan", "x reference"
SYNTHETIC = "extraction_synthetic", "clean"
FRAMES, WHOLE = (("extraction_scans", SCAN), ("whole_scans", SCAN))
TARGETS = (
    Target("extraction / reference extraction, synthetic clean stripes", 0.8, 0.5, (*SYNTHETIC, PRECISE, RATIO)),
    Target("extraction / reference extraction, frames of the scan", 0.8, 0.5, (*FRAMES, PRECISE, RATIO)),
    Target("CPU of a whole scan / reference extraction of its frames", 2.0, 1.2, (*WHOLE, PRECISE, RATIO)),
    Target("last frame to grid / reference extraction of one frame", 8.0, 5.0, ("stages", LATENCY, RATIO)),
    Target("memory growth in a scan, MB", 16.0, 11.0, ("memory", BY_STRIPE, "MB")),
)


def judged(sections: Mapping[str, Section], scan: str) -> Section:
    """Every target with what was measured."""
    values = [(target, target.value(sections, scan)) for target in TARGETS]
    rows = [(t.what, value, t.must, t.goal, "reached" if value <= t.must else "not yet") for t, value in values]
    return Section(
        "targets",
        "Targets",
        f"On the standard scan ({scan}) where nothing else is said.",
        "figure: | measured:.2f | at most:g | goal:g | limit is:",
        rows,
    )
