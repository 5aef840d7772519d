"""Places of the texture of one picture in another (Lucas-Kanade)."""

from __future__ import annotations

import cv2
import numpy as np

from guara_perception.arrays import Float, Image


def follow(before: Image, after: Image, points: Float, window: int, levels: int) -> Float:
    """(n, 2) where points (n, 2) of one grey picture are in another [px]; NaN where they were lost.

    Args:
        before, after: (h, w) uint8.
        points: x and y [px].
        window: side of the square about a point that is compared [px].
        levels: number of times that the pictures are halved, for motions larger than the window.
    """
    if not len(points):
        return np.empty((0, 2))
    given = points.astype(np.float32).reshape(-1, 1, 2)
    size = (window, window)
    there, found, _ = cv2.calcOpticalFlowPyrLK(before, after, given, given.copy(), winSize=size, maxLevel=levels)
    return np.where(found == 0, np.nan, np.asarray(there[:, 0], np.float64))
