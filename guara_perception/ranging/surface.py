"""Joins neighbouring stripes into surface: only what two stripes see together counts as seen.

A return stands when a neighbouring stripe of the pattern confirms it in the same image column (heights differ by less
than `join_height`). Another stripe can only support a return, never create one: losing stripes leaves less surface.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from guara_perception.ranging.stripe_points import ColumnPoints, StripePoints

Float = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

# Samples along a joining line are at most a third of a cell apart, so no crossed cell is missed.
SAMPLES_PER_CELL = 3
# Returns less alike than this in strength may be cut by an edge or a shadow ...
WEAK_RATIO = 0.4
# ... and are joined only where their heights nearly agree.
WEAK_JOIN_HEIGHT_M = 0.0015
# Where a surface ends, the last stripe on it may hang over the edge by a part of its own width on the ground.
OPEN_END_M = 0.0005


@dataclass(frozen=True, slots=True)
class Surface:
    """Samples of surface.

    Attributes:
        points: (n, 3) in the frame of the stripes [m].
        variance: (n,) variances of the heights [m^2].
    """

    points: Float
    variance: Float


def linked_columns(first: StripePoints, second: StripePoints, join_height: float) -> Mask:
    """Columns in which two neighbouring stripes lie on one surface.

    A stripe that is cut off by an edge or a shadow is weak and lies in the wrong place: where one of the two returns
    is much weaker than the other, they must agree in height.

    Args:
        first, second: neighbouring stripes.
        join_height: largest height difference of one surface [m].

    Returns:
        (w,) bool, True where both have a point and the heights differ by less than the difference allowed.
    """
    with np.errstate(invalid="ignore"):
        weaker, stronger = np.minimum(first.strength, second.strength), np.maximum(first.strength, second.strength)
        allowed = np.where(weaker < WEAK_RATIO * stronger, min(WEAK_JOIN_HEIGHT_M, join_height), join_height)
        return np.asarray(np.abs(second.points[:, 2] - first.points[:, 2]) < allowed)


def confirmed_points(points: Float, variance: Float, before: Mask, after: Mask) -> Surface:
    """Points of a stripe that lie within a surface: linked to the stripe before and to the stripe after.

    Args:
        points: (w, 3) of the stripe.
        variance: (w,) variance of the heights.
        before, after: (w,) links to the neighbouring stripes.
    """
    inside = np.flatnonzero(before & after & np.isfinite(points[:, 2]))
    return Surface(points.T.take(inside, axis=1).T, variance.take(inside))


def joined_surface(
    points: tuple[Float, Float],
    variances: tuple[Float, Float],
    links: tuple[Mask, Mask, Mask],
    resolution: float,
    wanted: Mask | None = None,
) -> Surface:
    """Sample the lines between two neighbouring stripes in the columns in which they are linked.

    Where the surface does not go on beyond one of the two, the line is cut short by OPEN_END_M at that end.

    Args:
        points: two (w, 3) arrays.
        variances: two (w,) arrays, variance of the heights [m^2].
        links: (w,) links of the first stripe to the one before it, of the two stripes, and of the second stripe to
            the one after it.
        resolution: edge of the cells that will be filled [m].
        wanted: (w,) columns that are asked for; None = all.
    """
    before, between, after = links
    columns = np.flatnonzero(between if wanted is None else between & wanted)
    if not columns.size:
        return Surface(np.empty((0, 3)), np.empty(0))
    # Coordinates in rows, each in one piece of memory: several times faster than points in rows.
    step = points[1].T - points[0].T
    # How many samples there are does not depend on which are wanted.
    n = sample_count(step.T, between, resolution)
    first = points[0].T.take(columns, axis=1).astype(np.float64)
    step = step.take(columns, axis=1).astype(np.float64)
    # The places of the samples never depend on other stripes: what is cut is left out, what is left does not move.
    share = ((np.arange(n) + 0.5) / n)[:, None]
    samples = share * step[:, None]
    samples += first[:, None]
    variance = (1 - share) ** 2 * variances[0].take(columns).astype(np.float64)
    variance += share**2 * variances[1].take(columns).astype(np.float64)
    samples, variance = samples.reshape(3, -1), variance.reshape(-1)
    opens, closes = ~before.take(columns), ~after.take(columns)
    at_ends = np.flatnonzero(opens | closes)
    cut = np.minimum(OPEN_END_M / np.maximum(np.hypot(*step[:2].take(at_ends, axis=1)), 1e-9), 0.5)
    # Most often the cut is shorter than the way to the nearest sample.
    if cut.max(initial=0.0) > min(share[0], 1 - share[-1]):
        kept = np.ones((n, columns.size), dtype=bool)
        start, end = np.where(opens[at_ends], cut, 0.0), 1 - np.where(closes[at_ends], cut, 0.0)
        kept[:, at_ends] = (share >= start) & (share <= end)
        samples, variance = samples.compress(kept.ravel(), axis=1), variance[kept.ravel()]
    return Surface(samples.T, variance)


def line_samples(ends: tuple[ColumnPoints, ColumnPoints], resolution: float) -> Float:
    """Points (n, 3) along the lines between two stripes, in all columns in which both have a point."""
    if not (ends[0].columns.size and ends[1].columns.size):
        return np.empty((0, 3))
    _, in_first, in_second = np.intersect1d(ends[0].columns, ends[1].columns, assume_unique=True, return_indices=True)
    if not in_first.size:
        return np.empty((0, 3))
    first = ends[0].points[in_first]
    step = ends[1].points[in_second] - first
    n = sample_count(step, np.ones(len(step), dtype=bool), resolution)
    share = (np.arange(n) + 0.5)[:, None, None] / n
    return np.asarray((first + share * step).reshape(-1, 3))


def sample_count(step: Float, is_line: Mask, resolution: float) -> int:
    """Samples per line that leave no crossed cell out, for those lines (n, 3) that `is_line` (n,) names."""
    squares = step[:, 0] ** 2 + step[:, 1] ** 2
    longest = float(np.sqrt(squares.compress(is_line).max()))
    return min(max(math.ceil(SAMPLES_PER_CELL * longest / resolution), 2), 64)
