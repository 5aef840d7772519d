"""The yardstick of speed: the plainest extraction of a stripe, written with care and without any guard."""

from __future__ import annotations

import cv2
import numpy as np

from guara_perception.arrays import Float32, Image

# Rows of a block, and rows of the centre of gravity on each side of the highest one.
BLOCK, HALF = 16, 4
# Grey levels after smoothing up to which a column holds no stripe.
DARK = 14
# Share of the highest weight of a window that is taken off every weight of it.
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
        """Row of the stripe per column, NaN where nothing shines."""
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
