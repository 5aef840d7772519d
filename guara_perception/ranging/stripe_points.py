"""The points of one stripe in the robot's frame, those that cannot be trusted set apart with their reason."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from guara_perception.ranging.locate import Locator
from guara_perception.ranging.run_ends import run_ends
from guara_perception.readonly import readonly
from guara_perception.stripes.profile import StripeProfile, StripeStatus

Float = npt.NDArray[np.float64]
Stored = npt.NDArray[Any]
Mask = npt.NDArray[np.bool_]

MIXED_EDGE, OUT_OF_BAND = np.uint8(StripeStatus.MIXED_EDGE), np.uint8(StripeStatus.OUT_OF_BAND)


@dataclass(frozen=True, slots=True)
class ColumnPoints:
    """Points of some image columns of a stripe, at most one per column.

    Attributes:
        columns: (m,) int32, ascending.
        points: (m, 3) float32 in base_footprint [m].
    """

    columns: npt.NDArray[Any]
    points: Stored

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        object.__setattr__(self, "columns", _stored(self.columns, np.int32))
        object.__setattr__(self, "points", _stored(self.points, np.float32))


@dataclass(frozen=True, slots=True)
class StripePoints:
    """One stripe of an organised scan, one entry per image column; float32, because a scan keeps all its stripes.

    Attributes:
        points: (w, 3) in base_footprint [m], NaN where there is no trusted return within the height gates.
        variance: (w,) variance of the height from the stripe position [m^2], NaN likewise.
        strength: (w,) height of the return above background [grey levels]; of use only where there is a point.
        status: (w,) uint8 StripeStatus.
        out_of_range: points seen below or above the gates.
        doubtful: points of returns that may not be used.
    """

    points: Stored
    variance: Stored
    strength: Stored
    status: npt.NDArray[np.uint8]
    out_of_range: ColumnPoints
    doubtful: ColumnPoints

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        for name in ("points", "variance", "strength"):
            object.__setattr__(self, name, _stored(getattr(self, name), np.float32))
        object.__setattr__(self, "status", readonly(self.status))


def stripe_points(
    profile: StripeProfile,
    locator: Locator,
    plane_in_camera: Float,
    gates: tuple[float, float],
    on_robot: Callable[[Float], Mask] | None = None,
    added_variance: Callable[[Float], Float] | None = None,
) -> StripePoints:
    """Locate the points of a profile and sort them.

    Args:
        profile: stripe along the columns of the whole picture.
        locator: makes points of rows.
        plane_in_camera: (4,) calibrated sheet.
        gates: lowest and highest height that counts as terrain [m].
        on_robot: tells which points (n, 3) in base_footprint lie on the robot itself; None = none does.
        added_variance: of the heights of points (n, 3), to be added to what the stripe position gives; None = none.
    """
    points, sigma = locator.measure(plane_in_camera, profile.position_px, profile.sigma_px)
    if on_robot is not None:
        own = on_robot(points)
        if own.any():
            points[own] = np.nan
    height = points[:, 2]
    mixed = run_ends(height, profile.peak.astype(np.float64))
    with np.errstate(invalid="ignore"):
        outside = (height < gates[0]) | (height > gates[1])
    unusable = mixed | outside
    variance = sigma * sigma
    if added_variance is not None:
        variance += added_variance(points)
    kept = np.isfinite(height) & ~unusable
    return StripePoints(
        points=_without(points, unusable),
        variance=np.where(kept, variance, np.nan),
        strength=profile.peak,
        status=_status(profile.status, mixed, outside),
        out_of_range=_picked(points, np.flatnonzero(outside & ~mixed)),
        doubtful=_doubtful(profile, locator, plane_in_camera, gates, on_robot, points, mixed),
    )


def _status(found: npt.NDArray[np.uint8], mixed: Mask, outside: Mask) -> npt.NDArray[np.uint8]:
    if mixed.any():
        found = np.where(mixed, MIXED_EDGE, found)
    return np.where(outside, OUT_OF_BAND, found) if outside.any() else found


def _doubtful(
    profile: StripeProfile,
    locator: Locator,
    plane_in_camera: Float,
    gates: tuple[float, float],
    on_robot: Callable[[Float], Mask] | None,
    points: Float,
    mixed: Mask,
) -> ColumnPoints:
    """Returns within the gates that may not be used: those the extraction doubted, and those at the ends of runs."""
    columns = np.flatnonzero(np.isfinite(profile.doubtful_px) & ~mixed)
    at_ends = np.flatnonzero(mixed)
    found = points[at_ends]
    if columns.size:
        doubted = locator.points(plane_in_camera, profile.doubtful_px[columns], columns)
        if on_robot is not None:
            doubted[on_robot(doubted)] = np.nan
        columns, found = np.concatenate((columns, at_ends)), np.concatenate((doubted, found))
        order = np.argsort(columns)
        columns, found = columns[order], found[order]
    else:
        columns = at_ends
    with np.errstate(invalid="ignore"):
        usable = (found[:, 2] >= gates[0]) & (found[:, 2] <= gates[1])
    return ColumnPoints(columns[usable], found[usable])


def _picked(points: Float, columns: npt.NDArray[np.intp]) -> ColumnPoints:
    return ColumnPoints(columns, points[columns])


def _without(points: Float, columns: Mask) -> Stored:
    """The points with some columns unknown, single precision, each coordinate in one piece of memory."""
    stored = np.array(points.T, dtype=np.float32, order="C")
    if columns.any():
        stored[:, columns] = np.nan
    return stored.T


def _stored(values: npt.ArrayLike, kind: npt.DTypeLike) -> Stored:
    """A read-only array of this type; no copy when the values are one already."""
    array = np.asarray(values, dtype=kind)
    if array is not values and array.base is None:
        # Nobody else has this one.
        array.setflags(write=False)
    return readonly(array)
