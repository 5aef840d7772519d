"""Growth of the cost with stripes, pixels and cells: exponents fitted to the measured CPU times."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

import guara_perception as gp
from benchmarks.rounds import alternate, number
from benchmarks.scans import process
from benchmarks.section import Effort, Section
from guara_perception.terrain.scan.assess_terrain import default_limits
from testbed.scenes import ScanInMemory, resized, simulated

SMALL = (640, 512)
CELL_M = 0.005


def growth(standard: ScanInMemory, effort: Effort) -> Section:
    """Cost over the number of stripes, of pixels and of cells, with the exponent of each."""
    series = {
        "stripes": [(n, _scan(simulated(SMALL, n))) for n in effort.stripe_counts],
        "pixels": [(w * h, _scan(resized(standard, (w, h)))) for w, h in effort.picture_sizes],
        "cells": [(side * side, _layers(side)) for side in effort.cell_sides],
    }
    rows: list[tuple[str, ...]] = []
    figures: dict[str, Any] = {}
    for name, runs in series.items():
        timings = alternate({str(size): run for size, run in runs}, effort.rounds)
        sizes = [size for size, _ in runs]
        times = [timings.milliseconds(str(size)) for size in sizes]
        exponent = fit(sizes, times)
        steepest = float(np.max(np.diff(np.log(times)) / np.diff(np.log(sizes))))
        figures[name] = {"sizes": sizes, "milliseconds": times, "exponent": exponent, "steepest": steepest}
        rows.append(
            (name, f"{sizes[0]:,} ... {sizes[-1]:,}", f"{times[0]:.2f} ... {times[-1]:.1f}")
            + (number(times[-1] / times[0]), number(sizes[-1] / sizes[0]), f"{exponent:.2f}", f"{steepest:.2f}")
        )
    return Section(
        "growth",
        "Growth",
        "CPU time of a whole scan over the number of stripes (640 x 512) and of pixels (the standard scan, resized), "
        "and of all traversability layers over the number of 5 mm cells. The exponent is the slope of a straight line "
        "through the logarithms, 1 is proportional; the steepest is the largest one between two neighbouring sizes.",
        ("with", "from ... to", "ms CPU", "time x", "size x", "exponent", "steepest"),
        rows,
        figures,
    )


def fit(sizes: list[int], times: list[float]) -> float:
    """Exponent of the power law that fits times over sizes best."""
    return float(np.polyfit(np.log(sizes), np.log(times), 1)[0])


def _scan(scan: ScanInMemory) -> Callable[[], object]:
    return lambda: process(scan, "precise")


def _layers(side: int) -> Callable[[], object]:
    random = np.random.default_rng(0)
    elevation = random.normal(0, 0.002, (side, side))
    elevation[random.random((side, side)) < 0.01] = np.nan
    limits = default_limits()
    return lambda: gp.assess_terrain(elevation, CELL_M, limits=limits)
