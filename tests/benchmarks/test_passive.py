"""Stereo and flow see the scene that the laser sees, and the laser sees it better."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.passive import measured
from testbed.gravel_scene import Scene, truth


@pytest.mark.heavy
def test_each_way_sees_the_boxes() -> None:
    """Mean errors of some millimetres by pictures alone, below one by the laser; every way finds most of the ground."""
    size = (640, 512)
    true, flat = truth(Scene(size))
    means, heights = {}, {}
    for way in ("precise", "paper", "stereo, SGBM, 60 mm", "flow, DIS, 35 mm"):
        heights[way], milliseconds, megabytes = measured(way, size)
        known = flat & np.isfinite(heights[way])
        assert known.sum() > 0.7 * flat.sum() and milliseconds > 0 and megabytes >= 0
        means[way] = float(np.abs(heights[way] - true.elevation)[known].mean())
    assert means["precise"] < means["paper"] < 0.001
    assert 0.001 < means["stereo, SGBM, 60 mm"] < 0.004 and 0.001 < means["flow, DIS, 35 mm"] < 0.004
