"""The figures that this project wants to reach, and whether it does: all of them ratios within one run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from benchmarks import starting
from benchmarks.contenders import LITERAL, LOOPS
from benchmarks.section import Section

PRECISE = "ours: precise"


@dataclass(frozen=True, slots=True)
class Target:
    """One figure.

    Attributes:
        what: text that says what is measured.
        must, goal: limits; the value may not be larger (smaller when `at_least`).
        value: takes it from the sections.
        at_least: whether more is better.
    """

    what: str
    must: float
    goal: float | None
    value: Callable[[Mapping[str, Section], str], float]
    at_least: bool = False


def _whole(sections: Mapping[str, Section], scan: str, contender: str, key: str) -> float:
    return float(sections["whole_scans"].figures[scan][contender][key])


TARGETS = (
    Target(
        "extraction / reference extraction, synthetic clean stripes",
        2.6,
        1.75,
        lambda s, scan: s["extraction_synthetic"].figures["clean"][PRECISE]["ratio"],
    ),
    Target(
        "extraction / reference extraction, frames of the scan",
        2.6,
        1.75,
        lambda s, scan: s["extraction_scans"].figures[scan][PRECISE],
    ),
    Target(
        "CPU of a whole scan / reference extraction of its frames",
        7.0,
        3.7,
        lambda s, scan: _whole(s, scan, PRECISE, "ratio"),
    ),
    Target(
        "last frame to grid / reference extraction of one frame",
        26.0,
        14.0,
        lambda s, scan: s["stages"].figures["latency"]["ratio"],
    ),
    Target("memory growth in a scan, MB", 14.0, 12.0, lambda s, scan: s["memory"].figures["first_mb"]),
    Target(
        "paper taken literally / ours, whole scan",
        5.0,
        10.0,
        lambda s, scan: _whole(s, scan, LITERAL, "to_precise"),
        at_least=True,
    ),
    Target(
        "paper point by point / ours, whole scan",
        20.0,
        50.0,
        lambda s, scan: _whole(s, scan, LOOPS, "to_precise"),
        at_least=True,
    ),
    Target("exponent in stripes", 1.05, None, lambda s, scan: s["growth"].figures["stripes"]["exponent"]),
    Target("exponent in cells", 1.05, None, lambda s, scan: s["growth"].figures["cells"]["exponent"]),
    Target(
        "import guara_perception / import numpy, cv2",
        1.3,
        None,
        lambda s, scan: s["starting"].figures[starting.PACKAGE]["ratio"],
    ),
    Target(
        "cold guara process of 35 frames of 640 x 512, s wall",
        3.0,
        None,
        lambda s, scan: s["starting"].figures[starting.COMMAND]["seconds_wall"],
    ),
)


def judged(sections: Mapping[str, Section], scan: str) -> Section:
    """Every target with what was measured."""
    rows: list[tuple[str, ...]] = []
    figures: dict[str, Any] = {}
    for target in TARGETS:
        value = target.value(sections, scan)
        sign = ">=" if target.at_least else "<="
        is_met = value >= target.must if target.at_least else value <= target.must
        goal = "" if target.goal is None else f"{sign} {target.goal:g}"
        figures[target.what] = {"value": value, "must": target.must, "met": is_met}
        rows.append((target.what, f"{value:.2f}", f"{sign} {target.must:g}", goal, "reached" if is_met else "not yet"))
    return Section(
        "targets",
        "Targets",
        f"On the standard scan ({scan}) where nothing else is said.",
        ("figure", "measured", "limit", "goal", "limit is"),
        rows,
        figures,
    )
