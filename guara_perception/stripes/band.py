"""Pictures of a stripe: their checks and light, the band of rows that can hold it, the profile extracted from them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any

import cv2
import numpy as np

from guara_perception.arrays import Codes, Float, Float32, Image, Mask
from guara_perception.stripes.kernel.library import Picture, addresses, kernel
from kinematics.arrays import FrozenArrays

# A band is checked for white in every eighth row, and in 40 to 79 columns of a wide picture.
CHECKED_ROWS, CHECKED_COLUMNS = 8, 40
# From this share of full scale a pixel counts as clipped; JPEG and demosaicing keep it from reaching 1.
CLIPPED = 0.98
# Columns of a grey picture differ from their neighbours by a thousandth, those behind a colour filter by 2 %
# under white light at the least, and by 30 to 95 % of its light in a red laser's.
LEAST_AMBIENT_CONTRAST = 0.012
LEAST_LASER_CONTRAST = 0.25
LEAST_LASER_LEVEL = 0.15
QUARTERS = 4
# Half the height of the opening that stands in for a missing off frame: wider than any stripe, narrower than texture.
BACKGROUND_HALF_HEIGHT_PX = 12
# Largest change of the brightness beside the stripe between laser off and on, as a share of full scale: beyond it the
# frames are no pair.
MAX_AMBIENT_CHANGE = 0.15


@dataclass(frozen=True, slots=True)
class FramePair:
    """The pictures of one stripe. They are not copied: nothing may write into them before they have been processed.

    Attributes:
        index: index of the stripe in the standard pattern.
        on: picture with the laser on, (h, w) or (h, w, 3) BGR as OpenCV reads it, uint8 or uint16.
        off: picture with the laser off, or None: earlier frames of the sweep serve instead.
        dark: picture of the dark flash that came after the stripe, None where none did.
        instant: time of the flash [s], by the clock of the body's track; NaN where it is not known.
        instant_sigma: standard deviation of that time [s].
    """

    index: int
    on: Image
    off: Image | None = None
    dark: Image | None = None
    instant: float = math.nan
    instant_sigma: float = 0.0


@dataclass(frozen=True, slots=True)
class Band:
    """The rows of a pair of frames that can hold one stripe.

    Attributes:
        on: (rows, columns[, 3]) uint8 or uint16, laser on.
        off: the same rows with the laser off, or None.
        first_row: row of the full picture in which the band begins.
    """

    on: Image
    off: Image | None
    first_row: int = 0


def channel_of(frame: Image, number: int) -> Image:
    """One channel of a frame (rows, columns[, channels]) as a contiguous picture."""
    if frame.ndim == 2:
        return np.ascontiguousarray(frame)
    if frame.shape[2] == 1:
        return np.ascontiguousarray(frame[:, :, 0])
    return np.asarray(cv2.extractChannel(np.ascontiguousarray(frame), number))


def has_colour(frame: Image) -> bool:
    """Test that a picture has three channels."""
    return frame.ndim == 3 and frame.shape[2] == 3


def is_clipped(values: Image) -> Mask:
    """Mask of the grey levels at the end of the scale."""
    return np.asarray(values >= clipped_from(values.dtype))


def clipped_from(kind: np.dtype[Any]) -> int:
    """Grey level from which a pixel of this type counts as clipped."""
    return int(np.ceil(CLIPPED * np.iinfo(kind).max))


def picture_fault(on: Image) -> str:
    """Text that says what was given in place of a camera's picture; empty for a picture."""
    if not isinstance(on, np.ndarray):
        return f"{type(on).__name__}, it must be a numpy array"
    if on.dtype not in (np.uint8, np.uint16) or on.ndim not in (2, 3) or (on.ndim == 3 and on.shape[2] not in (1, 3)):
        return f"{on.dtype} {on.shape}, it must be uint8 or uint16, (h, w) or (h, w, 3)"
    return ""


def unusable_frame(band: Image, off: Image | None, shape: tuple[int, ...]) -> str:
    """Reason for which a frame cannot be used; empty for a usable one.

    Args:
        band: the rows of the laser-on frame that will be searched.
        off: the whole laser-off frame, or None.
        shape: shape of the whole laser-on frame.
    """
    if off is not None:
        if not isinstance(off, np.ndarray) or off.dtype != band.dtype or off.shape != shape:
            given = f"{off.dtype} {off.shape}" if isinstance(off, np.ndarray) else type(off).__name__
            return f"laser-off frame is {given}, laser-on frame is {band.dtype} {shape}: they must be alike"
    sampled = np.ascontiguousarray(band[::CHECKED_ROWS, :: max(band.shape[1] // CHECKED_COLUMNS, 1)])
    low, high = float(sampled.min()), float(sampled.max())
    if low == high and float(band.min()) == float(band.max()):
        return f"the frame is blank: every pixel is {low:.0f}"
    if np.count_nonzero(is_clipped(sampled)) > 0.5 * sampled.size:
        return "more than half of the frame is white: exposure too long or too much light"
    return ""


def is_raw_bayer(on: Image, off: Image | None) -> bool:
    """Detect the 2 x 2 pattern of a colour filter in a picture of one channel, or in its rows from an even one on.

    Grey pictures have no reason to differ between even and odd columns all over; behind a colour filter these differ,
    in even rows otherwise than in odd ones.
    """
    if on.ndim == 3 and on.shape[2] != 1:
        return False
    if off is None or off.shape != on.shape:
        return _agree(_of_sums(_sums(on)), LEAST_AMBIENT_CONTRAST)
    dark = _sums(off)
    light = _sums(on) - dark
    # Rows of one kind hardly take in the laser: each kind is judged by itself, and only where there is more than noise.
    apart = np.abs(light[..., 0] - light[..., 1]) / (on.shape[0] / 2 * on.shape[1] / QUARTERS)
    laser = np.where(apart > LEAST_LASER_LEVEL, _of_sums(light), 0.0)
    return _agree(laser, LEAST_LASER_CONTRAST) or _agree(_of_sums(dark), LEAST_AMBIENT_CONTRAST)


def _sums(picture: Image) -> Float:
    """(2 kinds of row, QUARTERS of the width, 2 kinds of column) sums of levels."""
    height, width = picture.shape[0] // 2 * 2, picture.shape[1] // (2 * QUARTERS) * 2 * QUARTERS
    plane = picture.reshape(picture.shape[:2])[:height, :width]
    by_column = np.array([plane[row::2].sum(axis=0, dtype=np.float64) for row in (0, 1)])
    return by_column.reshape(2, QUARTERS, -1, 2).sum(axis=2)


def _of_sums(sums: Float) -> Float:
    """(2, QUARTERS) difference over sum of even and odd columns."""
    return np.asarray((sums[..., 0] - sums[..., 1]) / np.maximum(np.abs(sums).sum(axis=-1), 1e-9))


def _agree(contrast: Float, least: float) -> bool:
    """Test that one kind of row differs by more than `least`, with one sign, in all quarters but one at the most."""
    more, less = (contrast > least).sum(axis=1), (contrast < -least).sum(axis=1)
    return bool((np.maximum(more, less) >= QUARTERS - 1).any())


class StripeStatus(IntEnum):
    """Result of one column; the values never change."""

    OK = 0
    DROPOUT = 1
    AMBIGUOUS = 2
    SATURATED = 3
    MIXED_EDGE = 4
    OUT_OF_BAND = 5
    FRAME_BAD = 6


@dataclass(frozen=True, slots=True)
class StripeProfile(FrozenArrays):
    """One stripe, column by column (row by row when it was extracted along rows).

    Attributes:
        position_px: (n,) float32, row of the stripe centre in full-picture coordinates, NaN where there is none.
        sigma_px: (n,) float32, standard deviation of the position, NaN where there is none.
        status: (n,) uint8, a StripeStatus per column.
        peak: (n,) float32, height of the smoothed peak above background [grey levels], NaN in a bad frame.
        doubtful_px: (n,) float32, row of a return that may not be used (ambiguous or mixed), NaN where there is none.
        reason: reason for which the whole frame is bad; empty for a good one.
        remark: what is wrong with the laser-off picture, used or not; empty when nothing is, or there was none.
    """

    position_px: Float32
    sigma_px: Float32
    status: Codes
    peak: Float32
    doubtful_px: Float32
    reason: str = ""
    remark: str = ""

    @property
    def is_frame_bad(self) -> bool:
        """True where the whole frame was rejected."""
        return bool(self.reason)

    def mirrored(self) -> StripeProfile:
        """The profile of the same picture seen in a mirror, its columns in reverse order."""
        return replace(self, remark="", **{name: getattr(self, name)[::-1] for name in PROFILE_ARRAYS})


PROFILE_ARRAYS = StripeProfile.__slots__[:5]


def profile_of(profile: Float32, status: Codes, doubtful: Float32 | None = None, remark: str = "") -> StripeProfile:
    """Profile of a measured stripe; the arrays become read-only, so that it keeps them without a copy.

    Args:
        profile: (3, columns) position, its sigma, and the peak [grey levels].
        status, doubtful: (columns,), None where no return is doubtful.
        remark: as in a StripeProfile.
    """
    doubtful = nothing(status.size) if doubtful is None else doubtful
    for array in (profile, status, doubtful):
        array.setflags(write=False)
    position, sigma, peak = profile
    return StripeProfile(position, sigma, status, peak, doubtful, remark=remark)


def bad_frame(n: int, reason: str) -> StripeProfile:
    """The profile of a frame that cannot be used: nothing is known but the reason."""
    status = np.full(n, StripeStatus.FRAME_BAD, dtype=np.uint8)
    return StripeProfile(nothing(n), nothing(n), status, nothing(n), nothing(n), reason)


def nothing(n: int) -> Float32:
    """NaN (n,) read-only, in the memory of one number: a scan keeps the profiles of all its stripes."""
    one = np.full((), np.nan, dtype=np.float32)
    one.setflags(write=False)
    return np.broadcast_to(one, n)


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
