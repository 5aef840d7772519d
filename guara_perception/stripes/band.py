"""Pictures of a stripe, the band of rows that can hold it, and the profile that is extracted from them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum

import cv2
import numpy as np

from guara_perception.arrays import Codes, Float32, Image, Index
from kinematics.arrays import read_only

# Rows and columns from one sample of a band's statistics to the next.
SAMPLE_ROWS, SAMPLE_COLUMNS = 8, 24


@dataclass(frozen=True, slots=True)
class FramePair:
    """The pictures of one stripe. They are not copied: nothing may write into them before they have been processed.

    Attributes:
        index: index of the stripe in the standard pattern.
        on: picture with the laser on, (h, w) or (h, w, 3) BGR as OpenCV reads it, uint8 or uint16.
        off: picture with the laser off, or None: earlier frames of the sweep serve instead.
    """

    index: int
    on: Image
    off: Image | None = None


class SharedFrame:
    """A frame that serves several stripes; nothing may be written into it meanwhile.

    Attributes:
        frame: (rows, columns[, channels]).
    """

    def __init__(self, frame: Image) -> None:
        self.frame = frame
        self._channels: dict[int, Image] = {}

    def channel(self, number: int) -> Image:
        """Extract one channel, once."""
        if number not in self._channels:
            self._channels[number] = channel_of(self.frame, number)
        return self._channels[number]


@dataclass(frozen=True, slots=True)
class OffRows:
    """Some rows with the laser off.

    Attributes:
        frame: (rows, columns[, channels]).
        shared: the whole frame to which the rows belong, where it serves other stripes as well.
        first_row: row of the first of them in that frame.
    """

    frame: Image
    shared: SharedFrame | None = None
    first_row: int = 0

    def channel(self, number: int) -> Image:
        """One channel (rows, columns)."""
        if self.shared is None:
            return channel_of(self.frame, number)
        return self.shared.channel(number)[self.first_row : self.first_row + len(self.frame)]


@dataclass(frozen=True, slots=True)
class Band:
    """The rows of a pair of frames that can hold one stripe.

    Attributes:
        on: (rows, columns[, 3]) uint8 or uint16, laser on.
        off: the same rows with the laser off, or None.
        first_row: row of the full picture in which the band begins.
    """

    on: Image
    off: OffRows | None
    first_row: int = 0

    @classmethod
    def of(cls, on: Image, off: Image | None, first_row: int = 0) -> Band:
        """The band of two arrays."""
        return cls(on, None if off is None else OffRows(off), first_row)


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


def sampled(picture: Image) -> Image:
    """Some pixels (n, m[, channels]) of a picture, evenly distributed."""
    return picture[::SAMPLE_ROWS, ::SAMPLE_COLUMNS]


def rows_from(picture: Image, first: Index, count: int, columns: Index, channel: int = 0) -> Image:
    """Values in a window of rows; what lies beyond the edges of the picture is taken at the edge.

    Args:
        picture: (rows, columns[, channels]).
        first: (n,) first row of the window in each column.
        count: rows of a window.
        columns: (n,) columns.
        channel: the one that is read.

    Returns:
        (count, n) values, in the type of the picture.
    """
    rows, width = picture.shape[:2]
    channels = picture.shape[2] if picture.ndim == 3 else 1
    start, down = columns * channels + channel, np.arange(count)[:, None]
    if first.size and (first.min() < 0 or first.max() + count > rows):
        indices = np.minimum(np.maximum(first + down, 0), rows - 1) * (width * channels) + start
    else:
        indices = (first * (width * channels) + start) + down * (width * channels)
    # Indices into the flat picture: several times as quick as an index per axis.
    return np.asarray(picture.reshape(-1).take(indices))


def at_rows(picture: Image, rows: Index, columns: Index, channel: int = 0) -> Image:
    """Values (n,) of one channel at one row (n,) in each column (n,), taken at the edge where it lies beyond.

    Args:
        picture: (rows, columns[, channels]).
        rows, columns: (n,) rows and columns of the pixels.
        channel: the one that is read.
    """
    return rows_from(picture, rows, 1, columns, channel)[0]


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
class StripeProfile:
    """One stripe, column by column (row by row when it was extracted along rows).

    Attributes:
        position_px: (n,) float32, row of the stripe centre in full-picture coordinates, NaN where there is none.
        sigma_px: (n,) float32, standard deviation of the position, NaN where there is none.
        status: (n,) uint8, a StripeStatus per column.
        peak: (n,) float32, height of the smoothed peak above background [grey levels], NaN in a bad frame.
        doubtful_px: (n,) float32, row of a return that may not be used (ambiguous or mixed), NaN where there is none.
        reason: reason for which the whole frame is bad; empty for a good one.
        remark: reason for which the laser-off picture was not used; empty when it was, or there was none.
    """

    position_px: Float32
    sigma_px: Float32
    status: Codes
    peak: Float32
    doubtful_px: Float32
    reason: str = ""
    remark: str = ""

    def __post_init__(self) -> None:
        for name in PROFILE_ARRAYS:
            object.__setattr__(self, name, read_only(getattr(self, name)))

    @property
    def is_frame_bad(self) -> bool:
        """True where the whole frame was rejected."""
        return bool(self.reason)

    def mirrored(self) -> StripeProfile:
        """The profile of the same picture seen in a mirror, its columns in reverse order."""
        return replace(self, remark="", **{name: getattr(self, name)[::-1] for name in PROFILE_ARRAYS})


PROFILE_ARRAYS = StripeProfile.__slots__[:5]


def bad_frame(n: int, reason: str) -> StripeProfile:
    """The profile of a frame that cannot be used: nothing is known but the reason."""
    status = np.full(n, StripeStatus.FRAME_BAD, dtype=np.uint8)
    return StripeProfile(nothing(n), nothing(n), status, nothing(n), nothing(n), reason)


def nothing(n: int) -> Float32:
    """NaN (n,) read-only, in the memory of one number: a scan keeps the profiles of all its stripes."""
    one = np.full((), np.nan, dtype=np.float32)
    one.setflags(write=False)
    return np.broadcast_to(one, n)
