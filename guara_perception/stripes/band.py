"""Images of a stripe: validity checks, the band of rows that can contain it, and the profile extracted from them."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace
from enum import IntEnum

import cv2
import numpy as np

from guara_perception.arrays import Array, Codes, Float, Float32, Image, Mask
from guara_perception.stripes.kernel.library import Picture, addresses, kernel
from kinematics.arrays import FrozenArrays

# Spacing of the rows, and minimum number of columns, that are sampled to detect blank and white frames.
CHECKED_ROWS, CHECKED_COLUMNS = 8, 40
# Types of pixels.
KINDS = np.dtype(np.uint8), np.dtype(np.uint16)
# Fraction of full scale from which a pixel counts as clipped. JPEG and demosaicing make clipped pixels slightly darker.
CLIPPED = 0.98
# Minimum contrast between even and odd columns that proves a colour filter. The contrast is about 0.1 % in grey images;
# behind a colour filter it is at least 2 % in white light and 30 to 95 % in red laser light.
LEAST_AMBIENT_CONTRAST = 0.012
LEAST_LASER_CONTRAST = 0.25
# Mean difference of the laser light between even and odd columns above which it is not noise [grey levels].
LEAST_LASER_LEVEL = 0.15
# Number of parts into which the width is divided; each is tested separately.
QUARTERS = 4
# Half height of the morphological opening that replaces a missing laser-off image. The opening is taller than any
# stripe, but shorter than typical texture of the ground.
BACKGROUND_HALF_HEIGHT_PX = 12
# Largest change of brightness beside the stripe between laser off and on, as a fraction of full scale. After a larger
# change, `paper` rejects the frame, and `precise` uses the laser-off image only if it shows the same view.
MAX_AMBIENT_CHANGE = 0.15


@dataclass(frozen=True, slots=True)
class FramePair:
    """Images of one stripe. The arrays are not copied: do not modify them before they have been processed.

    Attributes:
        index: index of the stripe in the standard pattern.
        on: laser-on image, (h, w) or (h, w, 3) BGR as OpenCV reads it, uint8 or uint16.
        off: laser-off image; None = use earlier frames of the sweep instead.
        dark: image of the dark flash (a frame with the laser off) after the stripe; None without one.
        instant: time of the laser-on image on the clock of the body's track [s]; NaN if unknown.
        instant_sigma: standard deviation of `instant` [s].
    """

    index: int
    on: Image
    off: Image | None = None
    dark: Image | None = None
    instant: float = math.nan
    instant_sigma: float = 0.0


@dataclass(frozen=True, slots=True)
class Band:
    """Rows of a frame pair that can contain one stripe.

    Attributes:
        on: (rows, columns[, 3]) uint8 or uint16 rows of the laser-on image.
        off: same rows of the laser-off image, or None.
        first_row: row of the whole image in which the band begins.
    """

    on: Image
    off: Image | None
    first_row: int = 0


def channel_of(frame: Image, number: int) -> Image:
    """One channel of a frame (rows, columns[, channels]) as a contiguous image."""
    if frame.ndim == 2:
        return np.ascontiguousarray(frame)
    if frame.shape[2] == 1:
        return np.ascontiguousarray(frame[:, :, 0])
    return np.asarray(cv2.extractChannel(np.ascontiguousarray(frame), number))


def has_colour(frame: Image) -> bool:
    """Return True if an image has three channels."""
    return frame.ndim == 3 and frame.shape[2] == 3


def is_clipped(values: Image) -> Mask:
    """Mask of the clipped grey levels."""
    return np.asarray(values >= clipped_from(values))


def clipped_from(picture: Image) -> int:
    """Grey level from which a pixel of an image counts as clipped."""
    return math.ceil(CLIPPED * full_scale(picture))


def full_scale(picture: Image) -> int:
    """Highest possible level of a uint8 or uint16 image; ten times as fast as `np.iinfo`."""
    return 255 if picture.itemsize == 1 else 65535


def picture_fault(on: Image) -> str:
    """Reason why an object is not a valid camera image; empty for a valid image."""
    if not isinstance(on, np.ndarray):
        return f"of type {type(on).__name__}; it must be a numpy array"
    if on.dtype not in KINDS or on.ndim not in (2, 3) or (on.ndim == 3 and on.shape[2] not in (1, 3)):
        return f"{on.dtype} of shape {on.shape}; it must be uint8 or uint16 of shape (h, w) or (h, w, 3)"
    return ""


def unusable_frame(band: Image, off: Image | None, shape: tuple[int, ...]) -> str:
    """Reason why a frame cannot be used; empty if it is usable.

    Args:
        band: rows of the laser-on frame that will be searched.
        off: the whole laser-off frame, or None.
        shape: shape of the whole laser-on frame.
    """
    if off is not None and (not isinstance(off, np.ndarray) or off.dtype != band.dtype or off.shape != shape):
        given = f"{off.dtype} {off.shape}" if isinstance(off, np.ndarray) else f"of type {type(off).__name__}"
        return (
            f"the laser-off frame is {given}, but the laser-on frame is {band.dtype} {shape}; "
            "they must have the same type and shape"
        )
    sampled = np.ascontiguousarray(band[::CHECKED_ROWS, :: max(band.shape[1] // CHECKED_COLUMNS, 1)])
    low, high = int(sampled.min()), int(sampled.max())
    if low == high and band.min() == band.max():
        return f"the searched rows of the frame are blank: every pixel is {low}"
    if high >= clipped_from(band) and np.count_nonzero(is_clipped(sampled)) > 0.5 * sampled.size:
        return "more than half of the searched pixels are white: exposure too long or too much light"
    return ""


def is_raw_bayer(on: Image, off: Image | None) -> bool:
    """Detect the 2 x 2 pattern of a colour filter in a single-channel image or a band of its rows.

    Even and odd columns of a grey image have the same mean. Behind a colour filter their means differ. Even and odd
    rows are tested separately, because the difference is not the same in both.
    """
    if on.ndim == 3 and on.shape[2] != 1:
        return False
    if off is None or off.shape != on.shape:
        return _agree(_of_sums(_sums(on)), LEAST_AMBIENT_CONTRAST)
    dark = _sums(off)
    light = _sums(on) - dark
    # Rows without red pixels hardly respond to the laser, so small differences are treated as noise.
    apart = np.abs(light[..., 0] - light[..., 1]) / (on.shape[0] / 2 * on.shape[1] / QUARTERS)
    laser = np.where(apart > LEAST_LASER_LEVEL, _of_sums(light), 0.0)
    return _agree(laser, LEAST_LASER_CONTRAST) or _agree(_of_sums(dark), LEAST_AMBIENT_CONTRAST)


def _sums(picture: Image) -> Float:
    """Sums of grey levels (2, QUARTERS, 2): even and odd rows, parts of the width, even and odd columns."""
    height, width = picture.shape[0] // 2 * 2, picture.shape[1] // (2 * QUARTERS) * 2 * QUARTERS
    plane = picture.reshape(picture.shape[:2])[:height, :width]
    by_column = np.array([plane[row::2].sum(axis=0, dtype=np.float64) for row in (0, 1)])
    return by_column.reshape(2, QUARTERS, -1, 2).sum(axis=2)


def _of_sums(sums: Float) -> Float:
    """Contrast (2, QUARTERS) of even and odd columns: their difference divided by their sum."""
    return np.asarray((sums[..., 0] - sums[..., 1]) / np.maximum(np.abs(sums).sum(axis=-1), 1e-9))


def _agree(contrast: Float, least: float) -> bool:
    """Return True if, in the even or in the odd rows, at least QUARTERS - 1 parts exceed `least` with the same sign."""
    more, less = (contrast > least).sum(axis=1), (contrast < -least).sum(axis=1)
    return bool((np.maximum(more, less) >= QUARTERS - 1).any())


class StripeStatus(IntEnum):
    """Result in one image column; the numbers are part of file and message formats and never change."""

    OK = 0
    DROPOUT = 1
    AMBIGUOUS = 2
    SATURATED = 3
    MIXED_EDGE = 4
    OUT_OF_BAND = 5
    FRAME_BAD = 6


@dataclass(frozen=True, slots=True)
class StripeProfile(FrozenArrays):
    """Position of one stripe in each image column (in each image row if it was extracted along rows).

    Attributes:
        position_px: (n,) float32, row of the stripe centre in the whole image; NaN unless status is OK or SATURATED.
        sigma_px: (n,) float32, standard deviation of the position; NaN like the position.
        status: (n,) uint8, a StripeStatus per column.
        peak: (n,) float32, height of the peak above the background [grey levels], NaN in a bad frame. `precise` smooths
            the image first.
        doubtful_px: (n,) float32, row of a return that must not be used, such as an ambiguous one, NaN where there is
            none.
        reason: reason why the whole frame is bad; empty for a usable frame.
        remark: mismatch of the laser-on and laser-off images, whether or not the laser-off image was used; empty if
            there is none.
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
        """True if the whole frame was rejected."""
        return bool(self.reason)

    def mirrored(self) -> StripeProfile:
        """Profile of the image mirrored left to right, without `remark`."""
        return replace(self, remark="", **{name: getattr(self, name)[::-1] for name in PROFILE_ARRAYS})


PROFILE_ARRAYS = StripeProfile.__slots__[:5]


def profile_of(profile: Float32, status: Codes, doubtful: Float32 | None = None, remark: str = "") -> StripeProfile:
    """Profile of a measured stripe; the given arrays are made read-only, so that they need not be copied.

    Args:
        profile: (3, columns) position, its sigma, and the peak [grey levels].
        status: (columns,) status of each column.
        doubtful: (columns,) rows of doubtful returns, or None if no return is doubtful.
        remark: as in a StripeProfile.
    """
    doubtful = nothing(status.size) if doubtful is None else doubtful
    for array in (profile, status, doubtful):
        array.setflags(write=False)
    position, sigma, peak = profile
    return StripeProfile(position, sigma, status, peak, doubtful, remark=remark)


def bad_frame(n: int, reason: str) -> StripeProfile:
    """Profile of a frame that cannot be used, with the reason."""
    status = np.full(n, StripeStatus.FRAME_BAD, dtype=np.uint8)
    return StripeProfile(nothing(n), nothing(n), status, nothing(n), nothing(n), reason)


@functools.lru_cache(maxsize=4)
def nothing(n: int) -> Float32:
    """Read-only array of n NaNs that takes the memory of one, because a scan keeps the profiles of all its stripes."""
    one = np.full((), np.nan, dtype=np.float32)
    one.setflags(write=False)
    return np.broadcast_to(one, n)


def clearest_channel(on: Image) -> int:
    """Number of the channel in which a stripe stands out most from the noise, judged from a sample of a band's columns.

    It is 0 for a monochrome image.
    """
    picture, _ = pictures_of(on, None)
    found, work = np.empty(5), np.empty(kernel().judge_size(*picture.shape), np.float32)
    kernel().judge(picture, None, *addresses(work, found))
    return int(found[0])


def pictures_of(on: Image, off: Image | None) -> tuple[Picture, Picture | None]:
    """Frame pair as passed to the kernel; both arrays must outlive it.

    Raises:
        ValueError: `on` is not an image, or `off` differs in shape or type.
    """
    if fault := picture_fault(on):
        raise ValueError(f"the laser-on picture is {fault}")
    if off is not None and (off.shape != on.shape or off.dtype != on.dtype):
        raise ValueError(f"the laser-off picture is {off.dtype} {off.shape}, allowed: {on.dtype} {on.shape}")
    return Picture(on), None if off is None else Picture(off)


def upper_median(values: Array) -> float:
    """Upper median of one or more values without NaN."""
    return float(np.partition(values, values.size // 2, axis=None)[values.size // 2])


def opening(picture: Image) -> Image:
    """Vertical greyscale opening of an image, which removes bright lines as thin as a stripe."""
    column = np.ones((2 * BACKGROUND_HALF_HEIGHT_PX + 1, 1), np.uint8)
    return np.asarray(cv2.morphologyEx(picture, cv2.MORPH_OPEN, column))
