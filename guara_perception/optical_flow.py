"""Tracking of points from one image to another (Lucas-Kanade)."""

from __future__ import annotations

import cv2
import numpy as np

from guara_perception.arrays import Float, Image


def follow(before: Image, after: Image, points: Float, window: int, levels: int) -> Float:
    """Track points from one greyscale image to another; return their positions (n, 2) [px], NaN for a lost point.

    Args:
        before, after: (h, w) uint8 images.
        points: (n, 2) x and y in `before` [px].
        window: side of the square around a point that is compared [px].
        levels: number of times that the image size is halved, to track motions larger than the window.
    """
    if not len(points):
        return np.empty((0, 2))
    given = points.astype(np.float32).reshape(-1, 1, 2)
    size = (window, window)
    there, found, _ = cv2.calcOpticalFlowPyrLK(before, after, given, given.copy(), winSize=size, maxLevel=levels)
    return np.where(found == 0, np.nan, np.asarray(there[:, 0], np.float64))
