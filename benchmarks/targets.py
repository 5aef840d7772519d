"""Figures that this project wants to reach, measured beside their limits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from benchmarks.section import Section

PRECISE = "ours: precise"


@dataclass(frozen=True, slots=True)
class Target:
    """One figure.

    Attributes:
        what: text that says what is measured.
        must, goal: limits; the value may not be larger.
        path: section, and keys of its figures; SCAN stands for the name of the standard scan.
    """

    what: str
    must: float
    goal: float
    path: tuple[str, ...]

    def value(self, sections: Mapping[str, Section], scan: str) -> float:
        """The measured figure."""
        figure: Any = sections[self.path[0]].figures
        for key in self.path[1:]:
            figure = figure[scan if key == SCAN else key]
        return float(figure)


SCAN = "the standard scan"
SYNTHETIC, WHOLE = ("extraction_synthetic", "clean"), ("whole_scans", SCAN)
TARGETS = (
    Target("extraction / reference extraction, synthetic clean stripes", 0.8, 0.5, (*SYNTHETIC, PRECISE, "ratio")),
    Target("extraction / reference extraction, frames of the scan", 0.8, 0.5, ("extraction_scans", SCAN, PRECISE)),
    Target("CPU of a whole scan / reference extraction of its frames", 2.0, 1.2, (*WHOLE, PRECISE, "ratio")),
    Target("last frame to grid / reference extraction of one frame", 8.0, 5.0, ("stages", "latency", "ratio")),
    Target("memory growth in a scan, MB", 16.0, 11.0, ("memory", "first_mb")),
)


def judged(sections: Mapping[str, Section], scan: str) -> Section:
    """Every target with what was measured."""
    rows: list[tuple[str, ...]] = []
    figures: dict[str, Any] = {}
    for target in TARGETS:
        value = target.value(sections, scan)
        is_met, limits = value <= target.must, (f"<= {target.must:g}", f"<= {target.goal:g}")
        figures[target.what] = {"value": value, "must": target.must, "met": is_met}
        rows.append((target.what, f"{value:.2f}", *limits, "reached" if is_met else "not yet"))
    return Section(
        "targets",
        "Targets",
        f"On the standard scan ({scan}) where nothing else is said.",
        ("figure", "measured", "limit", "goal", "limit is"),
        rows,
        figures,
    )
