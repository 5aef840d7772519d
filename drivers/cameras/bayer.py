"""Bayer mosaics: patterns, simulation, and extraction of the red pixels."""

from __future__ import annotations

import numpy as np

from drivers.frame import Image

RED = 2
# By GenICam pixel format: BGR channel of each pixel in the upper left 2 x 2 block, by row.
PATTERNS = {
    "BayerRG8": ((2, 1), (1, 0)),
    "BayerGR8": ((1, 2), (0, 1)),
    "BayerGB8": ((1, 0), (2, 1)),
    "BayerBG8": ((0, 1), (1, 2)),
}


def mosaic(picture: Image, pattern: str) -> Image:
    """Simulate the mosaic that a sensor with a Bayer filter would record.

    Args:
        picture: (height, width, 3) BGR image.
        pattern: one of PATTERNS.

    Returns:
        (height, width) mosaic of the same dtype.
    """
    seen = np.empty(picture.shape[:2], picture.dtype)
    for row in (0, 1):
        for column in (0, 1):
            seen[row::2, column::2] = picture[row::2, column::2, PATTERNS[pattern][row][column]]
    return seen


def red_pixels(seen: Image, pattern: str) -> Image:
    """Extract the red pixels of a mosaic as an image of half the width and height, without interpolation.

    Args:
        seen: mosaic (height, width); both must be even.
        pattern: one of PATTERNS.

    Returns:
        (height / 2, width / 2) image of the same dtype; a copy.
    """
    row, column = next((r, c) for r in (0, 1) for c in (0, 1) if PATTERNS[pattern][r][c] == RED)
    red: Image = seen[row::2, column::2].copy()
    return red
