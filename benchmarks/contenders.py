"""Stripe extraction by this project and by others: (laser on, laser off) of a band or frame -> row in each column."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import cv2
import numpy as np

import guara_perception as gp
from benchmarks.reference import Reference
from benchmarks.skeletons import library_skeletons, red_skeleton
from guara_perception.arrays import Float32, Image
from guara_perception.stripes.extract import METHODS
from guara_perception.stripes.paper import skeleton

Extract = Callable[[Image, Image], Float32]

REFERENCE = "reference: cv2 + numpy, band"
LITERAL = "paper taken literally"
LOOPS = "paper point by point"
USER = "OpenCV user"
OURS = {f"ours: {name}": name for name in ("precise", "paper") if name in METHODS}
# Half the window of the centre of gravity, and the least difference of grey levels that is a stripe to an OpenCV user.
WINDOW_PX = 4
LEAST_LEVEL = 15

# The paper's way with this project's own thinning.
literal: Extract = red_skeleton(lambda mask: skeleton(mask > 0))


def reference(on: Image, off: Image) -> Float32:
    """The plain band reference with buffers made beforehand."""
    return _reference(*on.shape[:2])(on, off)


@lru_cache(maxsize=1024)
def _reference(rows: int, columns: int) -> Reference:
    return Reference(rows, columns)


def opencv_user(on: Image, off: Image) -> Float32:
    """Blurred red difference, its largest value per column, centre of gravity in a window around that."""
    light = cv2.GaussianBlur(cv2.subtract(cv2.extractChannel(on, 2), cv2.extractChannel(off, 2)), (5, 5), 0)
    top = light.argmax(axis=0)
    every = np.arange(light.shape[1])
    around = np.clip(top + np.arange(-WINDOW_PX, WINDOW_PX + 1)[:, None], 0, len(light) - 1)
    weights = light[around, every].astype(np.float32)
    row = (weights * around).sum(axis=0) / np.maximum(weights.sum(axis=0), 1)
    return np.where(light[top, every] > LEAST_LEVEL, row, np.nan).astype(np.float32)


def of_this_project(method: str) -> Extract:
    """One method of this project."""

    def extract(on: Image, off: Image) -> Float32:
        return gp.extract_stripe(on, off, method=method).position_px

    return extract


def extractors() -> dict[str, Extract]:
    """All that find a stripe; skeletons of other libraries only where those happen to be installed."""
    found: dict[str, Extract] = {REFERENCE: reference}
    found |= {name: of_this_project(method) for name, method in OURS.items()}
    found |= {LITERAL: literal, USER: opencv_user}
    return found | {f"{LITERAL}, {name}": extract for name, extract in library_skeletons().items()}


def touch(*arrays: Image) -> int:
    """Read every byte once: nothing that looks at all pixels is faster."""
    total = 0
    for array in arrays:
        flat = array.reshape(-1)
        numbers = flat[: flat.size // 8 * 8].view(np.uint64)
        total ^= int(np.bitwise_xor.reduce(numbers))
    return total


def copy(*arrays: Image) -> None:
    """Copy every byte once."""
    for array in arrays:
        np.copyto(_buffer(array.shape), array)


@lru_cache(maxsize=1024)
def _buffer(shape: tuple[int, ...]) -> Image:
    return np.empty(shape, np.uint8)
