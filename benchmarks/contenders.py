"""Stripe extraction by this project and by others: (laser on, laser off) of a band or frame -> row in each column."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import cv2
import numpy as np

import guara_perception as gp
from guara_perception.arrays import Float32, Image
from guara_perception.stripes.extract import METHODS

Extract = Callable[[Image, Image], Float32]

REFERENCE = "reference: cv2 + numpy, band"
USER = "OpenCV user"
OURS = {f"ours: {name}": name for name in ("precise", "paper") if name in METHODS}
# Half the window of the centre of gravity, and the least difference of grey levels that is a stripe to an OpenCV user.
WINDOW_PX = 4
LEAST_LEVEL = 15
# The reference: rows of a block, rows of the centre of gravity on each side of the highest one, grey levels after
# smoothing up to which a column holds no stripe, and the share of a window's highest weight that is taken off each.
BLOCK, HALF = 16, 4
DARK = 14
PEDESTAL = 0.2
TAPS = np.array([1, 4, 6, 4, 1], np.float32) / 16


class Reference:
    """Rows of a stripe in bands of one size: red planes subtracted, five taps, block maxima, centre of gravity.

    It takes the highest peak for the stripe: no guard against two stripes, clipped light, texture or a changed
    background, and no sigma. All that does not depend on the frames is made once, and buffers are used again.
    """

    def __init__(self, rows: int, columns: int) -> None:
        """Buffers for bands of this many rows and columns, BGR."""
        self._rows = rows
        whole = -(-rows // BLOCK) * BLOCK
        self._on, self._off = np.empty((2, rows, columns), np.uint8)
        # Rows that fill up the last block stay dark.
        self._light = np.zeros((whole, columns), np.uint8)
        self._smooth = np.zeros((whole, columns), np.int16)
        every = np.arange(columns)
        self._columns = columns
        self._in_block = np.arange(BLOCK)[:, None] * columns + every
        self._in_window = np.arange(-HALF, HALF + 1)[:, None] * columns + every
        self._offsets = np.arange(-HALF, HALF + 1, dtype=np.float32)

    def __call__(self, on: Image, off: Image) -> Float32:
        """Row of the stripe in each column, NaN without a stripe."""
        cv2.mixChannels([on], [self._on], [2, 0])
        cv2.mixChannels([off], [self._off], [2, 0])
        cv2.subtract(self._on, self._off, dst=self._light[: self._rows])
        cv2.sepFilter2D(
            self._light[: self._rows], cv2.CV_16S, np.ones(1, np.float32), TAPS, dst=self._smooth[: self._rows]
        )
        blocks = self._smooth.reshape(-1, BLOCK, self._columns).max(axis=1)
        first = blocks.argmax(axis=0) * BLOCK
        top = first + self._smooth.ravel().take(first * self._columns + self._in_block).argmax(axis=0)
        np.clip(top, HALF, len(self._smooth) - HALF - 1, out=top)
        weights = self._light.ravel().take(top * self._columns + self._in_window).astype(np.float32)
        weights -= PEDESTAL * weights.max(axis=0)
        np.maximum(weights, 0, out=weights)
        row = top + (self._offsets @ weights) / np.maximum(weights.sum(axis=0), 1e-3)
        row[blocks.max(axis=0) <= DARK] = np.nan
        return np.asarray(row, np.float32)


_reference = lru_cache(maxsize=1024)(Reference)


def reference(on: Image, off: Image) -> Float32:
    """The plain band reference, with buffers allocated in advance."""
    return _reference(*on.shape[:2])(on, off)


def opencv_user(on: Image, off: Image) -> Float32:
    """Blurred red difference, its largest value per column, centre of gravity in a window around that."""
    light = cv2.GaussianBlur(cv2.subtract(cv2.extractChannel(on, 2), cv2.extractChannel(off, 2)), (5, 5), 0)
    top = light.argmax(axis=0)
    every = np.arange(light.shape[1])
    around = np.clip(top + np.arange(-WINDOW_PX, WINDOW_PX + 1)[:, None], 0, len(light) - 1)
    weights = light[around, every].astype(np.float32)
    row = (weights * around).sum(axis=0) / np.maximum(weights.sum(axis=0), 1)
    return np.where(light[top, every] > LEAST_LEVEL, row, np.nan).astype(np.float32)


def extractors() -> dict[str, Extract]:
    """All contenders, by name."""
    found: dict[str, Extract] = {REFERENCE: reference}
    for name, method in OURS.items():
        found[name] = lambda on, off, method=method: gp.extract_stripe(on, off, method=method).position_px  # type: ignore[misc]
    return found | {USER: opencv_user}


def over(extract: Callable[..., object], pairs: Sequence[tuple[Any, ...]]) -> Callable[[], None]:
    """Function that extracts from each pair (laser on, laser off); further entries of a tuple are ignored."""

    def run() -> None:
        for on, off, *_ in pairs:
            extract(on, off)

    return run


def touch(*arrays: Image) -> int:
    """Read every byte once, which bounds the time of any method that reads all pixels from below."""
    total = 0
    for array in arrays:
        flat = array.reshape(-1)
        numbers = flat[: flat.size // 8 * 8].view(np.uint64)
        total ^= int(np.bitwise_xor.reduce(numbers))
    return total
