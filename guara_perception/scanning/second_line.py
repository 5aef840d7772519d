"""Second line beside the stripe in one picture, or merged with it: another robot's, or a reflection of our own."""

from __future__ import annotations

import numpy as np

from guara_perception.arrays import Float, Float32, Image, Index
from guara_perception.stripes.band import FramePair, StripeProfile
from guara_perception.stripes.laser_light import is_clipped

SECOND_LINE = "two lines in one picture"
# Columns in which the neighbourhood of the stripe is compared, and the least number of them that must show it.
COLUMNS, LEAST_COLUMNS = 96, 12
# Largest distance of the second line, as a share of the picture's height: 16 px of 512, about three stripes.
REACH_OF_HEIGHT = 1 / 32
# Largest asymmetry of a single line, as a share of its top: a second line of this brightness shifts the measured row.
LEAST_SHARE = 0.45
# Two lines that merge have a flat top. The width at a quarter of the height is 2.2 times that at three quarters for a
# Gaussian, 1.7 and more for single lines of simulated and rendered scenes, 1.25 to 1.6 for two lines of which one is
# 0.8 to 1.3 as bright as the other, half a stripe beside it; nearer ones move the row by less than 5 mm of height.
LEAST_WIDTHS = 1.62
LEVELS = 0.25, 0.75
BIN_PX = 0.5
# Above this share of clipped tops, a flat top is no sign of a second line.
MOST_CLIPPED = 0.1
# Least height of a top above its surroundings [grey levels of 255].
LEAST_TOP = 12.0
# From this share of its stripes on, and from this number on, the whole scan is refused.
REFUSED_SHARE, REFUSED_STRIPES = 0.2, 4


def has_second_line(pair: FramePair, profile: StripeProfile) -> bool:
    """Test that most of a stripe has a line of comparable brightness beside it, by the asymmetry of its cross-section.

    False without a laser-off picture, where a bright edge of the scene would look like a line.

    Args:
        pair: the pictures.
        profile: the stripe that was found in them.
    """
    columns = np.flatnonzero(np.isfinite(profile.position_px))
    if pair.off is None or columns.size < LEAST_COLUMNS:
        return False
    columns = columns[:: max(columns.size // COLUMNS, 1)]
    reach = max(round(REACH_OF_HEIGHT * pair.on.shape[0]), 4)
    tops = np.rint(profile.position_px[columns]).astype(np.intp)
    inside = (tops >= reach) & (tops < pair.on.shape[0] - reach)
    tops, columns = tops[inside], columns[inside]
    if columns.size < LEAST_COLUMNS:
        return False
    light = _around(pair.on, tops, columns, reach) - _around(pair.off, tops, columns, reach)
    scale = 255.0 / float(np.iinfo(pair.on.dtype).max)
    # The highest pixel, which may be one beside the rounded row.
    level = light[reach - 1 : reach + 2].max(axis=0)
    seen = level * scale > LEAST_TOP
    if np.count_nonzero(seen) < LEAST_COLUMNS:
        return False
    below, above = light[reach + 2 :], light[: reach - 1][::-1]
    difference = np.median((below - above)[:, seen] / level[seen], axis=1)
    if np.abs(difference).max() > LEAST_SHARE:
        return True
    if is_clipped(pair.on[tops[seen], columns[seen]]).mean() > MOST_CLIPPED:
        return False
    distance = np.arange(-reach, reach + 1)[:, None] - (profile.position_px[columns] - tops)
    return _ratio_of_widths(distance[:, seen], light[:, seen] / level[seen]) < LEAST_WIDTHS


def _ratio_of_widths(distance: Float, light: Float32) -> float:
    """Width of the mean cross-section at a quarter of its height over that at three quarters; infinite where unknown.

    Args:
        distance: (rows, n) from the centre of the stripe [px].
        light: (rows, n) share of the top.
    """
    half = int(np.abs(distance).min(axis=1).max() / BIN_PX) - 1
    bins = np.floor(distance / BIN_PX + half + 0.5).astype(np.intp).ravel()
    inside = (bins >= 0) & (bins <= 2 * half)
    total = np.bincount(bins[inside], light.ravel()[inside], 2 * half + 1)
    section = total / np.maximum(np.bincount(bins[inside], minlength=2 * half + 1), 1)
    section /= max(float(section.max()), 1e-6)
    wide, narrow = (_width(section, level) for level in LEVELS)
    return wide / narrow if narrow > 0 else np.inf


def _width(section: Float, level: float) -> float:
    """Distance between the outermost crossings of a level [bins]; infinite where one lies beyond the ends."""
    above = np.flatnonzero(section >= level)
    first, last = int(above[0]), int(above[-1])
    if first == 0 or last == section.size - 1:
        return np.inf
    before = (section[first] - level) / max(float(section[first] - section[first - 1]), 1e-6)
    after = (section[last] - level) / max(float(section[last] - section[last + 1]), 1e-6)
    return float(last - first + before + after)


def _around(picture: Image, tops: Index, columns: Index, reach: int) -> Float32:
    """(2 reach + 1, n) brightest channel of the pixels around some rows."""
    rows = tops + np.arange(-reach, reach + 1)[:, None]
    pixels = picture[rows, columns].astype(np.float32)
    return np.asarray(pixels.max(axis=2) if pixels.ndim == 3 else pixels)
