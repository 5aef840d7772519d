"""Bayer mosaics: colour of each pixel, and the red pixels."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.cameras.bayer import PATTERNS, mosaic, red_pixels


@pytest.mark.parametrize("pattern", PATTERNS)
def test_the_red_pixels_are_those_that_see_red(pattern: str) -> None:
    """Green and blue have no effect, and the result owns its memory."""
    rng = np.random.default_rng(2)
    picture = rng.integers(0, 256, (20, 30, 3), dtype=np.uint8)
    red = red_pixels(mosaic(picture, pattern), pattern)
    column_of_red = pattern[5:7].find("R")
    row, column = (0, column_of_red) if column_of_red >= 0 else (1, 1 if pattern == "BayerBG8" else 0)
    assert np.array_equal(red, picture[row::2, column::2, 2])
    assert red.flags.owndata and red.flags.c_contiguous
