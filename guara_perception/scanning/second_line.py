"""Second line beside the stripe in one picture, or merged with it: another robot's, or a reflection of our own."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from guara_perception.arrays import Float, Float32, Image, Index
from guara_perception.stripes.band import FramePair, StripeProfile, is_clipped

SECOND_LINE = "two lines in one picture"
# Columns in which the neighbourhood of the stripe is compared, and the least number of them that must show it.
COLUMNS, LEAST_COLUMNS = 96, 12
# Largest distance of the second line, as a share of the picture's height: 16 px of 512, about three stripes.
REACH_OF_HEIGHT = 1 / 32
# Largest asymmetry of a single line, as a share of its top: a second line of this brightness shifts the measured row.
LEAST_SHARE = 0.45
# So does a fainter one if our line is hardly seen beside it; what all stripes show is a reflection, which moves none.
LEAST_ODD_SHARE, ODD = 0.2, 2.5
# Two lines that merge have a flat top. The width at a quarter of the height is 2.2 times that at three quarters for a
# Gaussian, 1.7 and more for single lines of simulated and rendered scenes, 1.25 to 1.6 for two lines of which one is
# 0.8 to 1.3 as bright as the other, half a stripe beside it; nearer ones move the row by less than 5 mm of height.
LEAST_WIDTHS = 1.62
# A line that is narrower than this at a quarter of the height is one: pixels flatten a thin line. In pictures of
# 320 x 256 single ones are 1.7 to 2.5 px wide there, two of which one moves the row by 5 mm of height 2.2 px or more.
LEAST_WIDE_PX = 2.0
LEVELS = 0.25, 0.5, 0.75
# Two lines that lie apart, but within the width of half the height: 3 times as wide there as at three quarters; 1.55
# for a Gaussian, 1.3 to 1.6 for single lines of simulated and rendered scenes.
MOST_WIDTHS = 2.2
# The flanks of the line itself lie nearer to its top.
LEAST_BINS = 4
BIN_PX = 0.5
# Above this share of clipped tops, a flat top is no sign of a second line.
MOST_CLIPPED = 0.1
# Least height of a top above its surroundings [grey levels of 255].
LEAST_TOP = 12.0
# From this share of its stripes on, and from this number on, the whole scan is refused.
REFUSED_SHARE, REFUSED_STRIPES = 0.2, 4


def second_line(
    pair: FramePair, profile: StripeProfile, align: Callable[[Image, Image], Image | None] | None = None
) -> float:
    """Brightness of a second line beside a stripe or merged with it, as a share of the stripe's; 1 where they merge.

    Most columns must show it. 0 without a laser-off picture, where a bright edge of the scene would look like a line.

    Args:
        pair: the pictures.
        profile: the stripe that was found in them.
        align: moves the laser-off picture to where the other was taken, None where the camera stood: texture that
            moved is no line.
    """
    share = _second_line(pair, profile)
    if align is not None and pair.off is not None and share > LEAST_ODD_SHARE:
        moved = align(pair.off, pair.on)
        return share if moved is None else _second_line(replace(pair, off=moved), profile)
    return share


def _second_line(pair: FramePair, profile: StripeProfile) -> float:
    columns = np.flatnonzero(np.isfinite(profile.position_px))
    if pair.off is None or columns.size < LEAST_COLUMNS:
        return 0.0
    columns = columns[:: max(columns.size // COLUMNS, 1)]
    reach = max(round(REACH_OF_HEIGHT * pair.on.shape[0]), 4)
    tops = np.rint(profile.position_px[columns]).astype(np.intp)
    inside = (tops >= reach) & (tops < pair.on.shape[0] - reach)
    tops, columns = tops[inside], columns[inside]
    if columns.size < LEAST_COLUMNS:
        return 0.0
    light = _around(pair.on, tops, columns, reach) - _around(pair.off, tops, columns, reach)
    scale = 255.0 / float(np.iinfo(pair.on.dtype).max)
    # The highest pixel, which may be one beside the rounded row.
    level = light[reach - 1 : reach + 2].max(axis=0)
    seen = level * scale > LEAST_TOP
    if np.count_nonzero(seen) < LEAST_COLUMNS:
        return 0.0
    below, above = light[reach + 2 :], light[: reach - 1][::-1]
    # Without the sign: some columns may have been found on the one line, some on the other.
    difference = (below - above)[:, seen] / level[seen]
    share = float(np.median(np.abs(difference), axis=1).max())
    if is_clipped(pair.on[tops[seen], columns[seen]]).mean() > MOST_CLIPPED:
        # Ragged edges of clipped tops differ without a sign in every stripe; one that others lack counts.
        return max(float(np.abs(np.median(difference, axis=1)).max()), min(share, LEAST_SHARE))
    distance = np.arange(-reach, reach + 1)[:, None] - (profile.position_px[columns] - tops)
    section = _section(distance[:, seen], light[:, seen] / level[seen])
    wide, middle, narrow = (_width(section, level) for level in LEVELS)
    if LEAST_WIDE_PX / BIN_PX < wide < LEAST_WIDTHS * narrow or MOST_WIDTHS * narrow < middle < np.inf:
        return 1.0
    # The row found may lie between the two lines: the sides of the highest place.
    top = int(section.argmax())
    sides = min(top, section.size - 1 - top)
    apart = np.arange(LEAST_BINS, sides + 1)
    return max(share, float(np.abs(section[top + apart] - section[top - apart]).max(initial=0.0)))


def doubled_stripes(shares: Mapping[int, float]) -> frozenset[int]:
    """Stripes that a second line may have moved: a bright one, or a fainter one that the scan's other stripes lack.

    Args:
        shares: brightness of the second line, by index of the stripe.
    """
    usual = float(np.median(list(shares.values()))) if shares else 0.0
    least = min(LEAST_SHARE, max(LEAST_ODD_SHARE, ODD * usual))
    return frozenset(index for index, share in shares.items() if share > least)


def _section(distance: Float, light: Float32) -> Float:
    """Mean cross-section in bins of BIN_PX, as shares of its height.

    Args:
        distance: (rows, n) from the centre of the stripe [px].
        light: (rows, n) share of the top.
    """
    half = int(np.abs(distance).min(axis=1).max() / BIN_PX) - 1
    bins = np.floor(distance / BIN_PX + half + 0.5).astype(np.intp).ravel()
    inside = (bins >= 0) & (bins <= 2 * half)
    total = np.bincount(bins[inside], light.ravel()[inside], 2 * half + 1)
    section = total / np.maximum(np.bincount(bins[inside], minlength=2 * half + 1), 1)
    return np.asarray(section / max(float(section.max()), 1e-6))


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
