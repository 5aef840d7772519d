"""Worlds with stepping stones for a robot that walks along x from the origin."""

from __future__ import annotations

import numpy as np

from guara_perception.arrays import Float
from guara_perception.simulation.features import Box, Pit
from guara_perception.simulation.world import World

# First and last x of the pit with the stones; the ground is level before and behind it.
START_M, END_M = 0.65, 1.65
WIDTH_M, DEPTH_M = 1.6, 0.12
GAP_M, UNEVEN_M = 0.040, 0.004
SMALLEST_M, LARGEST_M = 0.160, 0.240
STONES_AHEAD, COLUMNS = 4, 5


def stepping_stones(seed: int) -> World:
    """Create columns of stones of 160 to 240 mm with gaps of 40 mm and tops within 4 mm of the level ground."""
    rng = np.random.default_rng(seed)
    stones = []
    y = -0.56
    for width in rng.uniform(SMALLEST_M, LARGEST_M, COLUMNS):
        x = START_M + GAP_M
        for length in _lengths(rng):
            top = DEPTH_M + rng.uniform(-UNEVEN_M, UNEVEN_M)
            centre = x + length / 2, y + width / 2
            stones.append(Box(x=centre[0], y=centre[1], size=(length, width), height=top, material="concrete"))
            x += length + GAP_M
        y += width + GAP_M
    pit = Pit(x=(START_M + END_M) / 2, y=0.0, size=(END_M - START_M, WIDTH_M), depth=DEPTH_M)
    return World((-1.0, 3.0), (-WIDTH_M / 2, WIDTH_M / 2), (pit, *stones), undulation=0.0, seed=seed)


def _lengths(rng: np.random.Generator) -> Float:
    """Draw the lengths of the stones of a column, which fill the pit together with the gaps [m]."""
    space = END_M - START_M - (STONES_AHEAD + 1) * GAP_M
    while True:
        lengths = rng.uniform(SMALLEST_M, LARGEST_M, STONES_AHEAD)
        lengths *= space / lengths.sum()
        if lengths.min() >= SMALLEST_M and lengths.max() <= LARGEST_M:
            return np.asarray(lengths)
