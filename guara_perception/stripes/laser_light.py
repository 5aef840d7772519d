"""Laser light of a pair of frames: its channel, changes of exposure, clipping, and a background without frames."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from guara_perception.arrays import Image, Index, Mask
from guara_perception.stripes.band import picture_fault
from guara_perception.stripes.kernel.library import Picture, address, addresses, kernel

# Half the height of the opening that stands in for a missing off frame: wider than any stripe, narrower than texture.
BACKGROUND_HALF_HEIGHT_PX = 12
# Largest change of the brightness beside the stripe between laser off and on, as a share of full scale: beyond it the
# frames are no pair.
MAX_AMBIENT_CHANGE = 0.15


@dataclass(frozen=True, slots=True)
class Judgement:
    """Assessment of a pair of frames by some columns of a band.

    Attributes:
        channel: number of the channel in which the stripe stands out most from the noise; 0 for mono.
        is_swapped: the dark side looks like a stripe and the bright side does not.
        change: how much brighter the surroundings of the stripe are than the background [grey levels].
        is_uneven: whether the surroundings are brighter or darker in any channel.
        is_core_clipped: whether the stripe's core is clipped in that channel in more than a fifth of the columns.
    """

    channel: int
    is_swapped: bool
    change: float
    is_uneven: bool
    is_core_clipped: bool


def judge(on: Image, off: Image | None) -> Judgement:
    """Judge a pair by some columns: which channel shows the stripe best, and whether its core is clipped.

    Args:
        on: (rows, columns[, channels]) uint8 or uint16, laser on.
        off: the same with the laser off, or None.
    """
    first, second = pictures_of(on, off)
    found, work = np.empty(5), np.empty(kernel().judge_size(*first.shape), np.float32)
    kernel().judge(first, second, *addresses(work, found))
    return Judgement(int(found[0]), bool(found[1]), float(found[2]), bool(found[3]), bool(found[4]))


def pictures_of(on: Image, off: Image | None) -> tuple[Picture, Picture | None]:
    """A pair as the kernel takes it; both arrays must outlive it.

    Raises:
        ValueError: they are no pair of pictures.
    """
    if fault := picture_fault(on):
        raise ValueError(f"the laser-on picture is {fault}")
    if off is not None and (off.shape != on.shape or off.dtype != on.dtype):
        raise ValueError(f"the laser-off picture is {off.dtype} {off.shape}, allowed: {on.dtype} {on.shape}")
    return Picture(on), None if off is None else Picture(off)


def opening(picture: Image) -> Image:
    """Vertical grey opening: the picture without anything as narrow as a stripe."""
    column = np.ones((2 * BACKGROUND_HALF_HEIGHT_PX + 1, 1), np.uint8)
    return np.asarray(cv2.morphologyEx(picture, cv2.MORPH_OPEN, column))


def clipped_columns(on: Image, top: Index, sigma: float, channel: int, *, is_fused: bool) -> tuple[Mask, Mask]:
    """Columns whose core is clipped in one channel, and those whose core is lost.

    Args:
        on: (rows, columns[, channels]) laser on.
        top: (columns,) rows of the stripe.
        sigma: width of the stripe [px].
        channel: channel that the laser lights most.
        is_fused: whether light of all channels was used: then the core is lost only where all are clipped.
    """
    top, masks = np.ascontiguousarray(top, np.int64), np.empty((2, on.shape[1]), np.bool_)
    kernel().clipped_columns(Picture(on), address(top), sigma, channel, is_fused, *addresses(*masks))
    return masks[0], masks[1]
