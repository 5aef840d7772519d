"""The best path of a stripe through all columns of a band, "no stripe here" included; pieces that are the laser's."""

from __future__ import annotations

import cv2
import numpy as np

from guara_perception.arrays import Float, Float32, Index, Mask
from guara_perception.stripes.any_light.laser_colour import CLIPPED
from guara_perception.stripes.kernel.library import address, kernel
from guara_perception.stripes.peaks import robust_sigma

# Instead of a row: there is no stripe. Rows beside a column that no path takes. As in follow.c.
NONE, PADDING_ROWS = -1, 6
# A piece of the path ends where it moves by more rows than this from one column to the next.
PIECE_JUMP_PX = 4
# Shorter pieces are no stripe: least number of columns, and least number times relative strength.
LEAST_COLUMNS, LEAST_STRONG_COLUMNS = 12, 6
STRONG_PERCENTILE = 75
# A laser keeps the ratio of its channels on any surface; other light deviates by more.
MOST_COLOUR_DEVIATION = 0.9
# Laser light is coherent, so it looks grainy on every rough surface; ambient light does not. The grain is measured in
# pieces of at least GRAINED_COLUMNS, as what a running mean over GRAIN_COLUMNS leaves of the light across the stripe.
# It shows where it is CLEAR_GRAIN times the noise beside it; a piece with less than LEAST_GRAIN of the brightest
# piece's grain is not lit by the laser.
GRAINED_COLUMNS, GRAIN_COLUMNS, CLEAR_GRAIN, LEAST_GRAIN = 24, 9, 2.0, 1 / 3
# From this share of clipped columns on a piece is too bright to show its grain.
MOST_CLIPPED = 0.25


def follow_stripe(evidence: Float32) -> tuple[Index, Mask, float]:
    """Follow the stripe through a picture of its evidence: the best path, "no stripe here" included.

    Args:
        evidence: (rows, columns) evidence of the stripe at each pixel, negative where none is likely.

    Returns:
        Row per column (columns,), that of the nearest column with a stripe where there is none; whether there is one
        (columns,); and the evidence of the whole path minus its costs.
    """
    rows, columns = evidence.shape
    path = np.empty(columns, np.int32)
    work = np.empty((2 * columns + 4) * (rows + PADDING_ROWS) + 3 * columns + 3, np.float32)
    score = kernel().follow(address(evidence), rows, columns, address(work), address(path))
    return _filled(path.astype(np.intp)), path != NONE, float(score)


def _filled(path: Index) -> Index:
    """A path (columns,) with the row of the nearest stripe where there is none."""
    known = np.flatnonzero(path != NONE)
    if not known.size:
        return np.zeros_like(path)
    nearest = np.rint(np.interp(np.arange(path.size), known, np.arange(known.size))).astype(np.intp)
    return np.asarray(path[known[nearest]])


def pieces(rows: Index, is_stripe: Mask) -> list[slice]:
    """The unbroken pieces of a path."""
    cut = is_stripe[1:] != is_stripe[:-1]
    cut |= (np.abs(np.diff(rows)) > PIECE_JUMP_PX) & is_stripe[1:] & is_stripe[:-1]
    edges = np.flatnonzero(np.concatenate(([True], cut, [True])))
    return [slice(a, b) for a, b in zip(edges[:-1], edges[1:], strict=True) if is_stripe[a]]


def strong_pieces(height: Float32, rows: Index, is_stripe: Mask, is_core: Mask, least_share: float) -> Mask:
    """Columns of the pieces that are long enough and have this share of the height of the strong ones."""
    good = np.zeros_like(is_stripe)
    if not is_stripe.any():
        return good
    strong = np.percentile(height[is_stripe], STRONG_PERCENTILE)
    height = np.where(is_core, np.maximum(height, strong), height)
    for piece in pieces(rows, is_stripe):
        length, strength = piece.stop - piece.start, float(np.median(height[piece]) / strong)
        is_long = length >= LEAST_COLUMNS and length * strength >= LEAST_STRONG_COLUMNS
        good[piece] = is_long and strength > least_share
    return good


def of_laser_colour(frame: Float32, detail: Float32, rows: Index, is_stripe: Mask, colour: Float, channel: int) -> Mask:
    """Columns of the pieces that have the laser's colour, as far as they are not clipped."""
    good = is_stripe.copy()
    columns = np.arange(rows.size)
    is_clear = frame[rows, columns].max(axis=1) < CLIPPED
    added = detail[rows, columns]
    for piece in pieces(rows, is_stripe):
        clear = is_clear[piece]
        if clear.sum() < max(LEAST_COLUMNS // 2, 0.5 * clear.size):
            continue
        mean = added[piece][clear].mean(axis=0)
        deviation = np.abs(mean / max(float(mean[channel]), 1e-6) - colour).max()
        good[piece] = mean[channel] > 0 and deviation < MOST_COLOUR_DEVIATION
    return good


def of_laser_speckle(light: Float32, rows: Index, is_stripe: Mask, is_core: Mask, sigma: Float32) -> Mask:
    """Columns of the pieces that are as grainy as laser light, or whose grain cannot be judged.

    Speckle (Goodman: Some fundamental properties of speckle, JOSA 66, 1976) depends on camera and laser more than on
    the surface: the pieces are compared with the brightest. None is judged where that one shows no grain, nor a piece
    whose grain is lost in clipped light or in noise.

    Args:
        light: (rows, columns) float32.
        rows, is_stripe, is_core: (columns,) row of the path, whether there is a stripe, and whether it is clipped.
        sigma: (columns,) width of its ridge [px].
    """
    good = is_stripe.copy()
    long = [
        piece
        for piece in pieces(rows, is_stripe)
        if piece.stop - piece.start >= GRAINED_COLUMNS and is_core[piece].mean() < MOST_CLIPPED
    ]
    if not long:
        return good
    brightest = max(long, key=lambda piece: float(np.median(light[rows[piece], np.arange(piece.start, piece.stop)])))
    shown, noise = _grain(light, rows, brightest, sigma)
    if shown < CLEAR_GRAIN * noise:
        return good
    least = LEAST_GRAIN * shown
    for piece in long:
        grain, noise = _grain(light, rows, piece, sigma)
        good[piece] = noise > least or grain**2 - noise**2 > least**2
    return good


def _grain(light: Float32, rows: Index, piece: slice, sigma: Float32) -> tuple[float, float]:
    """Relative variation of the light of a piece from column to column, and the part of it that is noise."""
    size = 2 * int(np.ceil(2 * np.median(sigma[piece]))) + 1
    across = rows[piece] + np.arange(3 * size)[:, None] - 3 * size // 2
    seen = light[np.clip(across, 0, len(light) - 1), np.arange(piece.start, piece.stop)]
    above, here, below = seen.reshape(3, size, -1).sum(axis=1)
    added = here - np.float32(0.5) * (above + below)
    level = max(float(added.mean()), 1e-6)
    return _unevenness(added) / level, float(np.sqrt(0.75)) * _unevenness(above - below) / level


def _unevenness(values: Float32) -> float:
    """Standard deviation of values (n,) from their running mean."""
    smooth = cv2.blur(values[None], (GRAIN_COLUMNS, 1), borderType=cv2.BORDER_REFLECT_101)[0]
    return robust_sigma(values - smooth)
