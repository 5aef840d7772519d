"""Method `paper` of stripe extraction: red-enhanced grey, background removal, binarisation, thinning, mean rows."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

from guara_perception.arrays import Float, Grey, Image, Index, Mask
from guara_perception.exceptions import InvalidInput
from guara_perception.images import eight_bits
from guara_perception.stripes.band import (
    MAX_AMBIENT_CHANGE,
    Band,
    StripeProfile,
    StripeStatus,
    bad_frame,
    channel_of,
    has_colour,
    opening,
    upper_median,
)

# Weights of the channels in the red-enhanced grey; the paper gives no numbers. Red contains the laser light, and the
# other channels stabilise the grey level.
BLUE_SHARE, GREEN_SHARE, RED_SHARE = 0.05, 0.15, 0.80
# Threshold as a share of Otsu's. Otsu's own threshold is midway between the background and the bright part of the
# stripe, and loses 2 to 38 % of the columns of a recorded scan. The paper only states that the image is binarised.
OTSU_SHARE = 0.4
# Minimum threshold [sigmas of the noise]: without a stripe, Otsu's method would split the noise.
THRESHOLD_SIGMAS = 5.0
# Upper quartile of a normal distribution [sigmas].
UPPER_QUARTILE = 0.674
NAN = np.float32(np.nan)
# Assumed standard deviation of a skeleton's position.
SIGMA_PX = 0.5
# Largest extent of the skeleton of one line in a column. A larger extent indicates two lines.
MOST_EXTENT_PX = 4
# Largest difference between the rows of a line in the two skeletons, from the image and from its flipped copy.
MOST_DIFFERENCE_PX = 1
# Largest number of passes of the thinning, each of which removes one layer of pixels on each side.
MOST_PASSES = 200


def check_threshold(threshold: float | None, method: str, *, has_threshold: bool) -> None:
    """Reject an invalid binarisation threshold, or any threshold for a method without binarisation.

    Args:
        threshold: the threshold [8-bit grey levels]; None is always accepted.
        method: name of the method, for the message.
        has_threshold: True for a method with binarisation.

    Raises:
        InvalidInput: the threshold is rejected; the message says what is allowed.
    """
    if threshold is None:
        return
    if not has_threshold:
        raise InvalidInput(
            f"threshold is {threshold}, but method {method!r} does not use one; only the paper's method does"
        )
    if not 0 <= threshold <= 255:
        raise InvalidInput(f"threshold is {threshold}, allowed: 0 ... 255 grey levels")


def extract_paper(band: Band, threshold: float | None = None) -> StripeProfile:
    """Find one stripe with the method of the paper.

    Args:
        band: rows that can contain the stripe.
        threshold: fixed threshold of the binarisation [8-bit grey levels]; None = derive it by Otsu's method.

    Returns:
        Profile in rows of the whole image; a bad frame if the brightness beside the stripe changed too much.
    """
    rows, columns = band.on.shape[:2]
    grey = red_enhanced_grey(band.on)
    background = opening(grey) if band.off is None else red_enhanced_grey(band.off)
    change = upper_median(grey[::8, ::24].astype(np.int16) - background[::8, ::24])
    if abs(change) > MAX_AMBIENT_CHANGE * 255:
        return bad_frame(
            columns, f"brightness beside the stripe changed by {change:+.0f} of 255 between laser off and on"
        )
    light = remove_background(grey, background)
    mask = binarise(light, threshold)
    # In a line whose thickness is an even number of pixels, thinning always keeps the same one of the two middle rows:
    # an error of half a pixel. The skeleton is therefore averaged with that of the image flipped upside down.
    (above, extent_above), (below, extent_below) = mean_rows(skeleton(mask)), mean_rows(skeleton(mask[::-1])[::-1])
    row = (above + below) / 2
    peak = light.max(axis=0).astype(np.float32)
    found = np.isfinite(row)
    status = np.where(found, StripeStatus.OK, StripeStatus.DROPOUT).astype(np.uint8)
    with np.errstate(invalid="ignore"):
        is_split = np.abs(above - below) > MOST_DIFFERENCE_PX
        status[found & (is_split | (np.maximum(extent_above, extent_below) > MOST_EXTENT_PX))] = StripeStatus.AMBIGUOUS
        status[found & ((row < 2) | (row > rows - 3))] = StripeStatus.OUT_OF_BAND
    usable = status == StripeStatus.OK
    position = (band.first_row + row).astype(np.float32)
    return StripeProfile(
        position_px=np.where(usable, position, NAN),
        sigma_px=np.where(usable, np.float32(SIGMA_PX), NAN),
        status=status,
        peak=peak,
        doubtful_px=np.where(found & ~usable, position, NAN),
    )


def red_enhanced_grey(frame: Image) -> Grey:
    """Convert an image to 8-bit grey in which red has the largest weight; a mono image is only converted to 8 bits."""
    frame = eight_bits(frame)
    if not has_colour(frame):
        return channel_of(frame, 0)
    shares = np.array([[BLUE_SHARE, GREEN_SHARE, RED_SHARE]], dtype=np.float32)
    return np.asarray(cv2.transform(frame, shares), dtype=np.uint8).reshape(frame.shape[:2])


def remove_background(grey: Grey, background: Grey) -> Grey:
    """Subtract the background from an image, which leaves the laser light; negative differences become zero."""
    return np.asarray(cv2.subtract(grey, background), dtype=np.uint8)


def binarise(light: Grey, threshold: float | None = None) -> Mask:
    """Mask of the pixels whose light exceeds a threshold.

    Args:
        light: (rows, columns) laser light.
        threshold: fixed threshold; None = OTSU_SHARE of Otsu's threshold, at least THRESHOLD_SIGMAS of the noise.
    """
    if threshold is None:
        otsu, _ = cv2.threshold(light, 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
        # The lower half of the noise was clipped at zero, but its upper quartile is still at 0.674 sigma.
        noise = float(np.percentile(light[::3, ::16], 75)) / UPPER_QUARTILE
        threshold = max(OTSU_SHARE * otsu, THRESHOLD_SIGMAS * max(noise, 0.5))
    return np.asarray(light > threshold)


def mean_rows(thin: Mask) -> tuple[Float, Index]:
    """Mean row (columns,) of each column's pixels, NaN without pixels, and distance (columns,) from first to last."""
    count = thin.sum(axis=0)
    rows = np.arange(len(thin))[:, None]
    mean = np.where(count > 0, (thin * rows).sum(axis=0) / np.maximum(count, 1), np.nan)
    first = thin.argmax(axis=0)
    last = len(thin) - 1 - thin[::-1].argmax(axis=0)
    return mean, np.where(count > 0, last - first, 0)


def skeleton(mask: Mask) -> Mask:
    """Thin a mask (rows, columns) to lines one pixel wide that stay connected.

    South-east and north-west border pixels that do not end or connect lines are removed in turn (Zhang, Suen: A fast
    parallel algorithm for thinning digital patterns, CACM 27, 1984). Only pixels of the mask are visited.
    """
    rows, columns = mask.shape
    padded = np.zeros((rows + 2, columns + 2), dtype=np.uint8)
    padded[1:-1, 1:-1] = mask
    flat = padded.ravel()
    width = columns + 2
    # Neighbours P2 ... P9: north first, then clockwise.
    around = np.array([-width, -width + 1, 1, width + 1, width, width - 1, -1, -width - 1])
    pixels = np.flatnonzero(flat)
    for _ in range(MOST_PASSES):
        before = pixels.size
        for table in deletable():
            code = np.zeros(pixels.size, dtype=np.uint8)
            for bit, shift in enumerate(around):
                code |= flat[pixels + shift] << np.uint8(bit)
            goes = table[code]
            flat[pixels[goes]] = 0
            pixels = pixels[~goes]
        if pixels.size == before:
            break
    return padded[1:-1, 1:-1].astype(bool)


@lru_cache(maxsize=1)
def deletable() -> tuple[Mask, Mask]:
    """Tables (256,) of the neighbourhoods in which a pixel may be removed, one for each half of a pass."""
    codes = np.arange(256)
    p = [(codes >> bit) & 1 for bit in range(8)]
    neighbours = sum(p)
    starts = sum((p[i] == 0) & (p[(i + 1) % 8] == 1) for i in range(8))
    north, east, south, west = p[0], p[2], p[4], p[6]
    removable = (neighbours >= 2) & (neighbours <= 6) & (starts == 1)
    first = removable & (north * east * south == 0) & (east * south * west == 0)
    second = removable & (north * east * west == 0) & (north * south * west == 0)
    return first, second
