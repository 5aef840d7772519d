"""What a scan holds besides its frames is bounded by the pixels of a band, the columns of stripes and a grid's cells.

Memory is counted as numpy and Python request it, which is the same on every machine, however busy.
"""

from __future__ import annotations

import functools
import tracemalloc
from collections.abc import Callable, Iterator

import numpy as np
import pytest

import guara_perception as gp
from tests.guara_perception.recordings import guara, recorded_scan, truth


@pytest.fixture
def tracing() -> Iterator[None]:
    """Allocations are counted while the test runs."""
    tracemalloc.start(1)
    try:
        yield
    finally:
        tracemalloc.stop()


def needed(work: Callable[[], object]) -> tuple[int, int]:
    """Peak memory of some work, and memory that is kept after it [bytes]."""
    before, _ = tracemalloc.get_traced_memory()
    tracemalloc.reset_peak()
    result = work()
    kept, peak = tracemalloc.get_traced_memory()
    del result
    return peak - before, kept - before


@pytest.mark.slow
def test_a_scan_holds_little_besides_its_frames(tracing: None) -> None:
    """During the search the light of a band twice, then its profile and points, at the end a few layers."""
    scan, frames = recorded_scan("paper")

    def begun() -> gp.ScanProcessor:
        return gp.ScanProcessor(truth(), guara(), scan.stance, scan.mode)

    first = begun()
    for index, on, off in frames:
        first.add(index, on, off)
    # The first scan fills the caches that all scans share.
    first.finish()
    width = frames[0][1].shape[1]
    made, beside, kept = begun(), [], []
    for index, on, off in frames:
        begin, end = made.band(index)
        peak, stays = needed(functools.partial(made.add, index, on, off))
        # Light as it is and smoothed, two bytes a pixel each.
        beside.append((peak - 4 * (end - begin) * width) / width)
        kept.append(stays / width)
    assert np.median(beside) < 400, "bytes per column while a stripe is sought"
    # The laser-off picture in grey, for the walk, and at half its size, for the test of the camera's motion.
    kept[0] -= 1.25 * frames[0][2].shape[0]
    assert np.mean(kept) < 70, "bytes per column of each stripe, surface included"
    peak, _ = needed(made.finish)
    assert peak / made.grid.size < 190, "bytes per cell while a scan is finished"
