"""Swing path of a foot over the terrain between two footholds."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from guara_perception.arrays import Float
from guara_perception.settings import RobotLike
from guara_perception.terrain.layers.layered_grid import LayeredGrid, asked
from guara_perception.terrain.questions.leg_reach import beyond_reach
from guara_perception.terrain.questions.path import (
    LONGEST_PATH_M,
    SwingGround,
    check_clearance,
    check_over,
    checked_points,
    corridor_of,
    sampled,
    swing_ground,
    top_heights,
)
from guara_perception.terrain.questions.reason import Reason, Verdict
from kinematics.arrays import FrozenArrays

# Waypoints of detours: fractions of the length of the straight track, and distances beside it [m].
CORNER_SHARES = (0.25, 0.5, 0.75)
ASIDE_M = (0.03, -0.03, 0.06, -0.06, 0.09, -0.09, 0.12, -0.12)
# Margins above the lowest possible height, tried in this order; the first one covers what samples half a cell apart may
# miss.
RISES_M = (0.001, 0.005, 0.010, 0.020)
# Spacing of the samples at which the reach of a leg is tested.
REACH_SPACING_M = 0.010


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Swing(Verdict, FrozenArrays):
    """Swing path of a foot, or the reasons against one.

    Attributes:
        ok: True if a path was found.
        points: (n, 3) corners of the path of the sole's centre in base_footprint [m], from start to end; (0, 3) if not
            ok.
        clearance: least distance from the ground over the part of the path that must keep the full clearance [m]; NaN
            if not ok, or if there is no such part.
        reasons: each failed test of the first attempt with value and limit; empty if ok.
    """

    ok: bool
    points: Float
    clearance: float
    reasons: tuple[Reason, ...]

    def _ok_text(self) -> str:
        clearance = "" if np.isnan(self.clearance) else f", clearance {1e3 * self.clearance:.0f} mm"
        return f"ok, {len(self.points)} corners{clearance}"


def swing(
    terrain: LayeredGrid,
    start: npt.ArrayLike,
    end: npt.ArrayLike,
    clearance: float,
    leg: str | None = None,
    robot: RobotLike | None = None,
    *,
    allow_stale: bool = False,
) -> Swing:
    """Plan a path, accepted by `check_path`, for a foot from one foothold to another.

    The path goes straight up, along the upper hull of the ground between start and end (highest samples plus
    confidence plus clearance), and straight down. If this is refused, a horizontal path at the height of the hull's
    highest point is tried, and then both up to 20 mm higher. If no path over the straight track is accepted,
    tracks over a waypoint up to 0.12 m beside it are tried.

    Args:
        start, end: (3,) positions of the sole's centre on the ground, in base_footprint [m].
        clearance: required distance from the ground between the ends [m].
        leg: also require that this leg can follow the whole path, with the body at its pose in the scan.
        robot: model, name or folder, used with `leg`; None = the robot of the grid.

    Raises:
        InvalidInput: as in `check_path`, and as in `check_foothold` if a leg is given.
        kinematics.KinematicsError: no such leg, or the robot cannot be loaded or does not fit the stance.
    """
    terrain = asked(terrain, allow_stale)
    ends = checked_points([start, end], (3,), 2, "start and end of a swing")  # type: ignore[arg-type]
    refused: tuple[Reason, ...] = ()
    check_clearance(clearance)
    ground = swing_ground(terrain, ends[0])
    for track in _tracks(ends):
        found = _over(terrain, ground, ends, track, float(clearance), leg, robot)
        if found.ok:
            return found
        refused = refused or found.reasons
    return _none(refused)


def _none(reasons: tuple[Reason, ...]) -> Swing:
    return Swing(False, np.empty((0, 3)), np.nan, reasons)


def _tracks(ends: Float) -> Iterator[Float]:
    """Yield tracks (n, 3) at z = 0 from start to end: straight, then over one waypoint, shortest first."""
    start, end = ends * (1, 1, 0)
    yield np.array([start, end])
    along = end - start
    length = float(np.linalg.norm(along))
    if length == 0:
        return
    left = np.array([-along[1], along[0], 0.0]) / length
    corners = [start + share * along + aside * left for share in CORNER_SHARES for aside in ASIDE_M]
    for corner in sorted(corners, key=lambda c: round(float(np.linalg.norm(c - start) + np.linalg.norm(end - c)), 9)):
        yield np.array([start, corner, end])


def _over(
    terrain: LayeredGrid,
    ground: SwingGround,
    ends: Float,
    track: Float,
    clearance: float,
    leg: str | None,
    robot: RobotLike | None,
) -> Swing:
    """Plan the swing over a track on the ground."""
    line = sampled(track, terrain.resolution / 2)
    # Unknown or stale cells block a path at any height, so one check far above the ground finds them.
    blocked = check_over(ground, line + (0.0, 0.0, LONGEST_PATH_M), clearance).reasons
    blocked = tuple(reason for reason in blocked if reason.test in ("unknown", "hazard"))
    if blocked:
        return _none(blocked)
    cells = corridor_of(ground.geometry, line, clearance)
    # Least heights of the path above the samples of the track.
    heights = np.where(cells.used, top_heights(ground, cells)[0], -np.inf).max(axis=1) + clearance
    if (highest := float(heights.max())) > LONGEST_PATH_M:
        return _none(
            (Reason("clearance", highest, LONGEST_PATH_M, "m", "height of a swing over such uncertain ground"),)
        )
    refused: tuple[Reason, ...] = ()
    for rise in RISES_M:
        for course in (_hull(line, heights), np.full(len(line), heights.max())):
            path = np.concatenate((ends[:1], _bends(line + (0.0, 0.0, 1.0) * (course + rise)[:, None]), ends[1:]))
            verdict = check_over(ground, path, clearance)
            reasons = verdict.reasons or _out_of_reach(terrain, path, leg, robot)
            if not reasons:
                return Swing(True, path, verdict.clearance, ())
            refused = refused or reasons
    return _none(refused)


def _hull(line: Float, heights: Float) -> Float:
    """Heights (n,) of the upper convex hull along the path."""
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1)))
    kept: list[int] = []
    for i in range(len(along)):
        while len(kept) > 1 and _is_below(along, heights, kept[-2], kept[-1], i):
            kept.pop()
        kept.append(i)
    return np.interp(along, along[kept], heights[kept])


def _is_below(along: Float, heights: Float, a: int, b: int, c: int) -> bool:
    """Test whether point b is on or below the line from a to c."""
    return bool((along[b] - along[a]) * (heights[c] - heights[a]) >= (heights[b] - heights[a]) * (along[c] - along[a]))


def _bends(path: Float) -> Float:
    """Ends of a path, and the points at which it changes direction."""
    directions = np.diff(path, axis=0)
    directions = directions / np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-12)
    turns = np.linalg.norm(np.diff(directions, axis=0), axis=1) > 1e-6
    return np.asarray(path[np.concatenate(([True], turns, [True]))])


def _out_of_reach(terrain: LayeredGrid, path: Float, leg: str | None, robot: RobotLike | None) -> tuple[Reason, ...]:
    """Reason why the leg cannot follow a path with the body at its pose in the scan; empty if there is none."""
    if leg is None:
        return ()
    samples = sampled(path, REACH_SPACING_M)
    beyond = beyond_reach(terrain, leg, samples, robot)
    if (beyond == 0).all():
        return ()
    worst = int(np.where(np.isnan(beyond), np.inf, beyond).argmax())
    x, y, z = samples[worst]
    detail = f"joints of {leg} beyond their limits, at x={x:.3f} y={y:.3f} z={z:.3f} m"
    return (Reason("reach", float(beyond[worst]), 0.0, "rad", detail),)
