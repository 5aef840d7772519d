"""Points of stripes in `base_footprint`; unreliable returns, such as those at the ends of runs, are kept apart."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from guara_perception.arrays import Array, Codes, Float, Index, Mask
from guara_perception.ranging.locate import Locator
from guara_perception.stripes.band import StripeProfile, StripeStatus
from guara_perception.stripes.kernel.library import addresses, kernel
from kinematics.arrays import FrozenArrays

MIXED_EDGE, OUT_OF_BAND = int(StripeStatus.MIXED_EDGE), int(StripeStatus.OUT_OF_BAND)


@dataclass(frozen=True, slots=True)
class ColumnPoints(FrozenArrays):
    """Points of some image columns of a stripe, at most one per column.

    Attributes:
        columns: (m,) int32, ascending.
        points: (m, 3) float32 in base_footprint [m].
    """

    columns: Array
    points: Array


@dataclass(frozen=True, slots=True)
class StripePoints(FrozenArrays):
    """Points of one stripe, one entry per image column; float32, because a scan keeps all its stripes.

    Attributes:
        points: (w, 3) in base_footprint [m], NaN where there is no trusted return within the height limits, or where
            it comes from the robot itself.
        variance: (w,) variance of the height [m^2], due to the stripe position and, with a track, to the pose of the
            camera; NaN where there is no point.
        strength: (w,) height of the return above background [grey levels]; meaningful only where there is a point.
        status: (w,) uint8 StripeStatus.
        out_of_range: points below or above the height limits.
        doubtful: points of unusable returns within the height limits.
    """

    points: Array
    variance: Array
    strength: Array
    status: Codes
    out_of_range: ColumnPoints
    doubtful: ColumnPoints


# Shared by the stripes without out-of-range or doubtful points, which are the majority.
NO_POINTS = ColumnPoints(np.empty(0, np.int32), np.empty((0, 3), np.float32))


def stripe_points(
    profiles: Sequence[StripeProfile],
    locator: Locator,
    planes_in_camera: Float,
    height_limits: tuple[float, float],
    on_robot: Callable[[Float], Mask] | None = None,
    added_variance: Callable[[Float], Float] | None = None,
) -> list[StripePoints]:
    """Convert profiles to points and set unreliable returns apart.

    Stripes do not influence each other; one call with several stripes is faster than a call for each stripe.

    Args:
        profiles: profiles of s >= 1 stripes over all columns of the image.
        locator: converts image rows to points.
        planes_in_camera: (s, 4) calibrated laser planes.
        height_limits: lowest and highest height that counts as terrain [m].
        on_robot: returns the mask of points (n, 3) in base_footprint that lie on the robot itself; None = no such test.
        added_variance: returns variances (s, w) of the heights of points (3, s, w), which are added to those due to the
            stripe position; None = nothing is added.
    """
    position, sigma = _rows(profiles, "position_px"), _rows(profiles, "sigma_px")
    points, sigma = locator.measure(planes_in_camera, position, sigma)
    if on_robot is not None:
        _drop(points, on_robot)
    variance = sigma * sigma
    if added_variance is not None:
        variance += added_variance(points)
    points, (_, count, width) = np.ascontiguousarray(points), points.shape
    kept, single = np.empty(points.shape, np.float32), np.empty((count, width), np.float32)
    status = np.array([profile.status for profile in profiles])
    strength, work = _rows(profiles, "peak"), np.empty(4 * width + 4)
    mixed, outside = np.empty((2, count, width), np.bool_)
    given = *addresses(points, variance, strength), count, width, *height_limits, MIXED_EDGE, OUT_OF_BAND
    kernel().settle_points(*given, *addresses(work, kept, single, status, mixed, outside))
    out_of_range = _by_stripe(points, np.flatnonzero(outside & ~mixed))
    doubtful = _doubtful(profiles, locator, planes_in_camera, height_limits, on_robot, points, mixed)
    for array in (kept, single, status):
        # There are no other references to these arrays, so StripePoints need not copy their parts.
        array.setflags(write=False)
    return [
        StripePoints(kept[:, k].T, single[k], profile.peak, status[k], out_of_range[k], doubtful[k])
        for k, profile in enumerate(profiles)
    ]


def _rows(profiles: Sequence[StripeProfile], name: str) -> Float:
    """Array (s, w) of an attribute of all profiles."""
    return np.array([getattr(profile, name) for profile in profiles], dtype=np.float64)


def _drop(points: Float, on_robot: Callable[[Float], Mask]) -> None:
    """Set points (3, ..., n) on the robot to NaN."""
    own = on_robot(points.reshape(3, -1).T)
    if own.any():
        # Indexed in the original array, because the reshaped one may be a copy.
        points[:, own.reshape(points.shape[1:])] = np.nan


def _doubtful(
    profiles: Sequence[StripeProfile],
    locator: Locator,
    planes_in_camera: Float,
    height_limits: tuple[float, float],
    on_robot: Callable[[Float], Mask] | None,
    points: Float,
    mixed: Mask,
) -> list[ColumnPoints]:
    """Unusable returns within the height limits: marked doubtful by the extraction, or at the ends of runs."""
    rows = _rows(profiles, "doubtful_px")
    indices = np.flatnonzero(mixed | np.isfinite(rows))
    if not indices.size:
        return [NO_POINTS] * len(profiles)
    found = points.reshape(3, -1).take(indices, axis=1)
    doubted = np.flatnonzero(~mixed.take(indices))
    if doubted.size:
        located, _ = locator.measure(planes_in_camera, rows, np.zeros_like(rows))
        located = located.reshape(3, -1).take(indices[doubted], axis=1)
        if on_robot is not None:
            _drop(located, on_robot)
        found[:, doubted] = located
    with np.errstate(invalid="ignore"):
        usable = (found[2] >= height_limits[0]) & (found[2] <= height_limits[1])
    return _by_stripe(points, indices[usable], found[:, usable])


def _by_stripe(points: Float, indices: Index, found: Float | None = None) -> list[ColumnPoints]:
    """Points by stripe, taken from `points` (3, s, w) at ascending flat indices (n,), or given as `found` (3, n)."""
    _, count, width = points.shape
    if not indices.size:
        return [NO_POINTS] * count
    if found is None:
        found = points.reshape(3, -1).take(indices, axis=1)
    bounds = np.searchsorted(indices, width * np.arange(count + 1)).tolist()
    return [
        ColumnPoints((indices[first:end] - k * width).astype(np.int32), found[:, first:end].T.astype(np.float32))
        if end > first
        else NO_POINTS
        for k, (first, end) in enumerate(itertools.pairwise(bounds))
    ]
