"""Looks at some columns of a pair of frames: which channel shows the stripe best, and whether its core is clipped."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from guara_perception.stripes.middle import middle

Float32 = npt.NDArray[np.float32]

# Every so many rows of so many columns: a thin stripe is missed in some of them, never in all.
JUDGED_ROWS, JUDGED_COLUMNS = 3, 16
# Mean deviations by which the peak of a column must exceed it: noise alone reaches four of them.
NOISE_DEVIATIONS, PEAK_DEVIATIONS = 4.0, 6.0
# From this share of full scale a pixel counts as clipped; JPEG and demosaicing keep it from reaching 1.
CLIPPED = 0.98
# From this share of clipped tops on, the channels are fused.
FUSE_FROM_CLIPPED = 0.2


@dataclass(frozen=True, slots=True)
class Judgement:
    """What some columns of a band say.

    Attributes:
        channel: number of the channel in which the stripe stands out most from the noise; 0 for mono.
        is_swapped: whether the dark side looks like a stripe and the bright side does not.
        change: how much brighter the surroundings of the stripe are than the background [grey levels].
        is_core_clipped: whether the stripe's core is clipped in that channel in a good part of the columns.
    """

    channel: int
    is_swapped: bool
    change: float
    is_core_clipped: bool


def judge(on: npt.NDArray[Any], off: npt.NDArray[Any] | None) -> Judgement:
    """Judge a pair.

    Args:
        on: (rows, columns[, channels]) uint8 or uint16, laser on.
        off: the same with the laser off, or None.
    """
    step = max(on.shape[1] // JUDGED_COLUMNS, 1)
    seen = _judged(on, step)
    light = seen - (np.median(seen, axis=0) if off is None else _judged(off, step))
    # Mean absolute value instead of a robust spread: the stripe is a small part of a column and raises it alike.
    noise = np.add.reduce(np.abs(light)) / np.float32(len(light))
    height = light.max(axis=0)
    channel = int(np.add.reduce(height - NOISE_DEVIATIONS * noise).argmax())
    change = middle(light[:, :, channel])
    tops = seen[:, :, channel].max(axis=0)[height[:, channel] > PEAK_DEVIATIONS * noise[:, channel]]
    clipped = np.count_nonzero(tops >= clipped_from(on.dtype))
    is_swapped = _is_swapped(-light.min(axis=0), height, noise)
    return Judgement(channel, is_swapped, change, clipped > FUSE_FROM_CLIPPED * max(tops.size, 1))


def _judged(frame: npt.NDArray[Any], step: int) -> Float32:
    """Judged pixels (rows, columns, channels)."""
    some = frame[::JUDGED_ROWS, ::step]
    return some.astype(np.float32).reshape(*some.shape[:2], -1)


def _is_swapped(depth: Float32, height: Float32, noise: Float32) -> bool:
    """Whether the deepest dips exceed twice the highest peaks, and most columns (columns, channels) have one."""
    if depth.max() <= 2 * height.max():
        return False
    channel = int(np.argmax(depth.mean(axis=0)))
    return bool(np.median(depth[:, channel] - PEAK_DEVIATIONS * noise[:, channel]) > 0)


def is_clipped(values: npt.NDArray[Any]) -> npt.NDArray[np.bool_]:
    """Which grey levels of a picture are at the end of its scale."""
    return np.asarray(values >= clipped_from(values.dtype))


def clipped_from(kind: np.dtype[Any]) -> int:
    """Grey level from which a pixel of this type counts as clipped."""
    return int(np.ceil(CLIPPED * np.iinfo(kind).max))
