"""Checks with an ordinary scan, with no target, whether a calibration still holds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from guara_perception.arrays import Float, Index
from guara_perception.plane_fit import solve_plane

HOLDS, DRIFTING, UNKNOWN = "holds", "drifting", "unknown"
# Points within this of the floor plane are floor; the floor is looked for within this of z = 0.
FLOOR_BAND_M = 0.003
FLOOR_SEARCH_M = 0.030
# A scan shows a floor when this share of its points lies on one plane, on at least this many stripes.
MIN_FLOOR_SHARE = 0.25
MIN_STRIPES = 8
MIN_COLUMNS = 20
# Median of one stripe over the floor against the plane through all stripes: 0.03 to 0.08 mm rms when all is well,
# 0.4 with the laser rotated by 0.2 degrees.
MAX_STRIPE_RMS_M = 0.00025
MAX_STRIPE_M = 0.0012
# Height and tilt of the floor against where the soles say it is, beyond what the stance itself does not know.
MAX_FLOOR_HEIGHT_M = 0.003
MAX_FLOOR_TILT = float(np.deg2rad(0.6))
STANCE_SIGMAS = 3.0


@dataclass(frozen=True, slots=True)
class Drift:
    """Outcome of a drift check.

    Attributes:
        verdict: "holds", "drifting", or "unknown" when the scan shows no floor to compare with.
        reasons: why not "holds", with numbers.
        floor_share: share of the points that lie on the floor plane.
        floor_height: of the plane below the middle of its points [m].
        floor_tilt: of the plane against the horizontal [rad].
        stripe_rms: rms over the stripes of each stripe's median distance from the plane [m].
        worst_stripe: index of the stripe that strays most, -1 when unknown.
        worst_distance: its median distance from the plane [m].
    """

    verdict: str
    reasons: tuple[str, ...]
    floor_share: float
    floor_height: float
    floor_tilt: float
    stripe_rms: float
    worst_stripe: int
    worst_distance: float

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON values; None for what is unknown."""
        numbers = ("floor_share", "floor_height", "floor_tilt", "stripe_rms", "worst_distance")
        return {
            "verdict": self.verdict,
            "reasons": list(self.reasons),
            "worst_stripe": None if self.worst_stripe < 0 else self.worst_stripe,
            **{name: None if np.isnan(getattr(self, name)) else float(getattr(self, name)) for name in numbers},
        }


def check_drift(points: Mapping[int, Float], pose_covariance: npt.ArrayLike | None = None) -> Drift:
    """Compare the floor that a scan shows with where it must be.

    Each stripe is measured through its own plane of light. On a flat floor all of them must agree: one plane through
    all stripes (what a tilted body or floor does), and no stripe off it (what only a moved mount or mirror does). A
    missed step puts all later stripes off the plane of the earlier ones.

    Args:
        points: (w, 3) points in base_footprint of each stripe, by index, NaN where there are none
            (`StripePoints.points` of a processed scan).
        pose_covariance: (6, 6) of the stance (x y z [m], rotations [rad]); widens the limits of the floor's height
            and tilt. None = the stance is exact.
    """
    seen = _Seen.of(points)
    if len(seen.indices) < MIN_STRIPES:
        return _unknown(f"{len(seen.indices)} stripes have points, {MIN_STRIPES} are needed")
    plane = _floor(seen.x, seen.y, seen.z)
    distance = seen.z - (plane[0] * seen.x + plane[1] * seen.y + plane[2])
    near = np.flatnonzero(np.abs(distance) < FLOOR_BAND_M)
    share = near.size / distance.size
    on_floor = np.bincount(seen.stripe[near], minlength=len(seen.indices))
    medians = _medians(distance[near], seen.stripe[near], on_floor)
    if share < MIN_FLOOR_SHARE or len(medians) < MIN_STRIPES:
        return _unknown(f"no flat floor in view: {100 * share:.0f} % of the points lie on one plane", share)
    centre = float(seen.x[near].mean()), float(seen.y[near].mean())
    height = float(plane[0] * centre[0] + plane[1] * centre[1] + plane[2])
    tilt = float(np.arctan(np.hypot(plane[0], plane[1])))
    largest = max(medians, key=lambda stripe: abs(medians[stripe]))
    worst, off = seen.indices[largest], medians[largest]
    rms = float(np.sqrt(np.mean(np.square(list(medians.values())))))
    reasons = _reasons(height, tilt, rms, worst, off, _allowed(pose_covariance, centre))
    jump = _jump(seen, distance, on_floor)
    if jump is not None:
        reasons.append(
            f"from stripe index {jump[0]} on all points lie {1e3 * jump[1]:+.1f} mm off the floor before: the mirror "
            "missed a step, or the ground itself steps there across the whole width"
        )
    return Drift(DRIFTING if reasons else HOLDS, tuple(reasons), share, height, tilt, rms, worst, off)


@dataclass(frozen=True, slots=True)
class _Seen:
    """All points of a scan that are known.

    Attributes:
        indices: of the stripes that have any, ascending.
        stripe: (n,) ascending, position in `indices` of each point's stripe.
        x, y, z: (n,) in base_footprint [m].
    """

    indices: list[int]
    stripe: Index
    x: Float
    y: Float
    z: Float

    @classmethod
    def of(cls, points: Mapping[int, Float]) -> _Seen:
        """From points (w, 3) of stripes by index."""
        indices = sorted(points)
        x, y, z = np.concatenate([np.empty((0, 3)), *(points[index] for index in indices)]).T
        known = np.flatnonzero(np.isfinite(z))
        lengths = [len(points[index]) for index in indices]
        counts = np.bincount(np.repeat(np.arange(len(indices)), lengths)[known])
        used = np.flatnonzero(counts)
        stripe = np.repeat(np.arange(used.size), counts[used])
        return cls([indices[i] for i in used], stripe, x[known], y[known], z[known])


def _medians(distance: Float, stripe: Index, counts: Index) -> dict[int, float]:
    """Upper median of the distances (n,) [m] of each stripe that has enough of them, as `counts` says."""
    # Distances are far below a metre: sorted together with the stripes' numbers, each stripe's stand in one run.
    ordered = np.sort(stripe + distance)
    middle = np.cumsum(counts) - counts + counts // 2
    return {k: float(ordered[middle[k]] - k) for k in np.flatnonzero(counts >= MIN_COLUMNS).tolist()}


def _allowed(pose_covariance: npt.ArrayLike | None, centre: tuple[float, float]) -> tuple[float, float]:
    """Limits of height [m] and tilt [rad] with the stance's own uncertainty."""
    if pose_covariance is None:
        return MAX_FLOOR_HEIGHT_M, MAX_FLOOR_TILT
    covariance = np.asarray(pose_covariance, dtype=np.float64)
    # Height at the middle of the floor: z, roll times y, pitch times x.
    lever = np.array([0.0, 0.0, 1.0, centre[1], -centre[0], 0.0])
    height = STANCE_SIGMAS * float(np.sqrt(lever @ covariance @ lever))
    tilt = STANCE_SIGMAS * float(np.sqrt(max(covariance[3, 3], covariance[4, 4])))
    return float(np.hypot(MAX_FLOOR_HEIGHT_M, height)), float(np.hypot(MAX_FLOOR_TILT, tilt))


def _reasons(
    height: float, tilt: float, rms: float, worst: int, distance: float, allowed: tuple[float, float]
) -> list[str]:
    reasons = []
    if abs(height) > allowed[0]:
        reasons.append(
            f"the floor lies {1e3 * height:+.1f} mm off the soles, {1e3 * allowed[0]:.1f} mm are allowed: camera "
            "or laser mount moved, or the feet stand on something"
        )
    if tilt > allowed[1]:
        reasons.append(
            f"the floor is tilted by {np.rad2deg(tilt):.2f} degrees, {np.rad2deg(allowed[1]):.2f} are allowed: the "
            "camera mount rotated, or the ground slopes"
        )
    if rms > MAX_STRIPE_RMS_M:
        reasons.append(
            f"the stripes disagree by {1e3 * rms:.2f} mm rms about one floor, {1e3 * MAX_STRIPE_RMS_M:.2f} mm are "
            "allowed: the laser or its mirror moved"
        )
    elif abs(distance) > MAX_STRIPE_M:
        reasons.append(
            f"stripe index {worst} lies {1e3 * distance:+.2f} mm off the floor of the others, "
            f"{1e3 * MAX_STRIPE_M:.2f} mm are allowed: the mirror did not reach its position"
        )
    return reasons


def _floor(x: Float, y: Float, z: Float) -> Float:
    """(a, b, c) of the plane z = a x + b y + c that most points (n,) near z = 0 lie on; found robustly."""
    near = z[np.abs(z) < FLOOR_SEARCH_M]
    if near.size < 3:
        return np.zeros(3)
    levels, edges = np.histogram(near, bins=int(2 * FLOOR_SEARCH_M / FLOOR_BAND_M))
    middle_x, middle_y = float(x.mean()), float(y.mean())
    terms = np.stack((x - middle_x, y - middle_y, np.ones(z.size)))
    plane = np.array([0.0, 0.0, float(edges[int(np.argmax(levels))] + (edges[1] - edges[0]) / 2)])
    for reach in (4.0, 2.0, 1.0, 1.0, 1.0):
        kept = np.flatnonzero(np.abs(z - plane @ terms) < reach * FLOOR_BAND_M)
        fitted = solve_plane(terms.take(kept, axis=1), z.take(kept))
        if fitted is None:
            break
        plane = fitted
    return plane - (0.0, 0.0, plane[0] * middle_x + plane[1] * middle_y)


def _jump(seen: _Seen, distance: Float, on_floor: Index) -> tuple[int, float] | None:
    """First stripe from which on nothing lies on the floor any more, and how far off; None when there is none.

    Before it the floor is seen on most stripes; of the last three at least none shows it.
    """
    shows = on_floor / np.bincount(seen.stripe)
    last = int(np.flatnonzero(shows > 0.1).max(initial=-1))
    if last < MIN_STRIPES or shows.size - last - 1 < 3 or np.median(shows[: last + 1]) < 0.5:
        return None
    return seen.indices[last + 1], float(np.median(distance[seen.stripe > last]))


def _unknown(reason: str, share: float = float("nan")) -> Drift:
    nan = float("nan")
    return Drift(UNKNOWN, (reason,), share, nan, nan, nan, -1, nan)
