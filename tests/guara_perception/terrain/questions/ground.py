"""Ground in front of the robot for queries."""

from __future__ import annotations

from typing import Any

import numpy as np
from hypothesis import settings

import guara_perception as gp
from tests.thorough import examples

PROPERTY = settings(max_examples=examples(40), deadline=None, derandomize=True)
ORIGIN = (0.4, -0.3)


def grid(heights: np.ndarray, **keywords: Any) -> gp.TerrainGrid:
    """Grid of any heights in front of the robot."""
    return gp.assess_terrain(heights, 0.005, origin=ORIGIN, **keywords)


def world(seed: int) -> gp.TerrainGrid:
    """Flat ground with boxes and holes."""
    rng = np.random.default_rng(seed)
    heights = np.zeros((120, 120))
    for _ in range(int(rng.integers(0, 6))):
        iy, ix = rng.integers(0, 110, 2)
        heights[iy : iy + 8, ix : ix + 10] = rng.choice([0.02, 0.05, -0.03, np.nan])
    return grid(heights)
