"""The paper's way to find a stripe: a skeleton of the red difference, by whatever library makes one."""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from guara_perception.arrays import Image

Contender = Callable[[Image, Image], Any]


def red_skeleton(skeleton: Callable[[Image], npt.NDArray[Any]]) -> Contender:
    """The paper's way: Otsu on the red difference, a skeleton of the mask (0 and 255), mean row per column."""

    def extract(on: Image, off: Image) -> npt.NDArray[np.float32]:
        light = cv2.subtract(on[:, :, 2], off[:, :, 2])
        _, mask = cv2.threshold(light, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
        thin = skeleton(np.asarray(mask, np.uint8)) > 0
        count = thin.sum(axis=0)
        rows = (thin * np.arange(thin.shape[0])[:, None]).sum(axis=0)
        return np.where(count > 0, rows / np.maximum(count, 1), np.nan).astype(np.float32)

    return extract


def library_skeletons() -> dict[str, Contender]:
    """The paper's way with each library that is installed and makes skeletons; none of them is in the lock file."""
    found: dict[str, Contender] = {}
    if find_spec("skimage") is not None:
        from skimage.morphology import skeletonize

        found["scikit-image"] = red_skeleton(lambda mask: skeletonize(mask > 0))
    if hasattr(cv2, "ximgproc"):
        found["OpenCV contrib"] = red_skeleton(cv2.ximgproc.thinning)
    return found
