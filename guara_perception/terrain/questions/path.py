"""Checks of paths and areas: swing of a foot, path of a part of the body, area to set something down."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from guara_perception.arrays import Flags, Float, Float32, Index, Mask
from guara_perception.exceptions import InvalidInput
from guara_perception.terrain.layers.geometry import GridGeometry, touched_cells
from guara_perception.terrain.layers.hazard import ALL_BUT_EDGE, UNKNOWN_MASK, Hazard, names
from guara_perception.terrain.layers.layered_grid import LayeredGrid, asked, coordinates, numbers
from guara_perception.terrain.layers.layers import CEILING_SIGMA_M
from guara_perception.terrain.questions.leg_reach import StandingSole, standing_soles
from guara_perception.terrain.questions.reason import Reason, Verdict
from kinematics import KinematicsError

# Largest distance between the start of a path and the centre of the standing sole from which the path starts.
SAME_PLACE_M = 0.010
# Depth by which the ends of a swing, which touch the ground, may be below the map.
TOUCH_M = 0.005
# Flags of known cells whose heights are not an upper bound of the ground. CONFLICT is not among them, because
# `elevation_max` is then the highest sample of all observations, and `variance` the larger variance.
UNRELIABLE = np.uint16(Hazard.STALE)
LONGEST_PATH_M = 20.0
ROUNDING_M = 1e-9
# Number larger than any cell index within the longest path.
FARTHEST = 2**32


@dataclass(frozen=True, slots=True, repr=False)
class PathVerdict(Verdict):
    """Result of a path or area check.

    Attributes:
        ok: True if the path or area is accepted.
        clearance: least distance from the ground over the part of the path that must keep the full clearance [m]; NaN
            if there is no such part, the path has no z, or ground within the required clearance is STALE, off the grid,
            or unknown without a bound.
        reasons: each failed test with value and limit; empty if ok.
    """

    ok: bool
    clearance: float
    reasons: tuple[Reason, ...]

    def _ok_text(self) -> str:
        return "ok" if math.isnan(self.clearance) else f"ok, clearance {1e3 * self.clearance:.0f} mm"


def check_path(
    terrain: LayeredGrid,
    points: npt.ArrayLike,
    clearance: float,
    *,
    allow_stale: bool = False,
) -> PathVerdict:
    """Check the path of a foot or a part of the body over this terrain.

    A path with z must stay `clearance` away from the ground. The height of the ground in a cell is the highest sample
    plus the confidence, a multiple of sigma; where observations disagree, the highest of all observations counts. Every
    cell within `clearance` of the path, seen from above, must be known and not STALE, or have a ceiling, which then
    bounds the ground. Near the ends of the path, where a foot stands, less is required: at a distance d from the nearer
    end at most d - 5 mm - confidence, which is the clearance of a vertical lift, and at most d - 5 mm from the highest
    samples without confidence, so that a path is never accepted because heights are uncertain. If the path starts at a
    sole that carried the body when the grid was made, cells wholly under that sole may be unknown, because they are no
    higher than the sole.

    A path without z is a track on the ground: every cell within `clearance` must be known and free of hazards other
    than EDGE.

    Args:
        points: (n, 3) or (n, 2) corners of the path in base_footprint [m].
        clearance: required distance from the ground [m].

    Raises:
        InvalidInput: the points have the wrong shape or are not finite numbers, the path is longer than 20 m or has a
            coordinate beyond 20 m, the clearance is not 0 ... 1 m, or the path has z and the metadata of the grid lacks
            limits.
    """
    terrain = asked(terrain, allow_stale)
    path = checked_points(points, (2, 3), 1, "points of a path")
    check_clearance(clearance)
    if path.shape[1] == 3:
        return check_over(swing_ground(terrain, path[0]), path, float(clearance))
    corridor = corridor_of(terrain.geometry, sampled(path, terrain.resolution / 2), float(clearance))
    return _ground_verdict(terrain, *corridor.unique())


def check_over(ground: SwingGround, path: Float, clearance: float) -> PathVerdict:
    """Check a path (n, 3) against the ground of a swing."""
    samples = sampled(path, ground.geometry.resolution / 2)
    cells = corridor_of(ground.geometry, samples, clearance)
    at = cells.unique()
    reasons = _flagged(ground, *at, "unknown", UNKNOWN_MASK) + _flagged(ground, *at, "hazard", UNRELIABLE)
    least = np.nan
    if not reasons:
        top, confidence = top_heights(ground, cells)
        from_ends = np.minimum(*(np.linalg.norm(samples - end, axis=1) for end in (path[0], path[-1])))
        vertical_lift = from_ends[:, None] - TOUCH_M
        # The clearance of a vertical lift is smaller over less certain ground, so a rounded variance is taken as the
        # least value that it may have had before rounding.
        least_confidence = confidence / np.sqrt(1 + ground.rounding)
        distance, wanted = _distance(samples, top, cells), np.minimum(clearance, vertical_lift - least_confidence)
        # Heights that are uncertain must not reduce the clearance beside a wall: as measured, they are tested too.
        as_measured, then_wanted = _distance(samples, top - confidence, cells), np.minimum(clearance, vertical_lift)
        is_nearer = then_wanted - as_measured > wanted - distance
        distance, wanted = np.where(is_nearer, as_measured, distance), np.where(is_nearer, then_wanted, wanted)
        lack = np.where(cells.used, wanted - distance, -np.inf)
        reasons = list(_too_near(samples, distance, wanted, lack))
        free = (~cells.used | (wanted >= clearance)).all(axis=1)
        if free.any():
            least = float(distance[free].min())
    return PathVerdict(not reasons, least, tuple(reasons))


def _distance(samples: Float, top: Float, cells: Corridor) -> Float:
    """Distances of samples (n, 3) of a path from its corridor's cells [m]: negative in the ground, inf if unused."""
    over = samples[:, 2:3] - top
    distance = np.where(over >= 0, np.hypot(cells.aside, over), np.where(cells.aside > 0, cells.aside, over))
    return np.where(cells.used, distance, np.inf)


def check_clearance(clearance: float) -> None:
    """Reject a clearance outside 0 ... 1 m.

    Raises:
        InvalidInput: the clearance is outside 0 ... 1 m.
    """
    if not (isinstance(clearance, int | float | np.number) and 0 <= clearance <= 1):
        raise InvalidInput(f"clearance is {clearance!r}; it must be 0 ... 1 m")


def check_polygon(terrain: LayeredGrid, corners: npt.ArrayLike, *, allow_stale: bool = False) -> PathVerdict:
    """Check that all cells touched by a polygon (n, 2) [m] are known and free of hazards other than EDGE.

    Raises:
        InvalidInput: the corners are fewer than three, of the wrong shape or not finite numbers, or the open outline
            (from the first to the last corner) is longer than 20 m or has a coordinate beyond 20 m.
    """
    terrain = asked(terrain, allow_stale)
    outline = checked_points(corners, (2,), 3, "corners of a polygon")
    return _ground_verdict(terrain, *touched_cells(outline, terrain.geometry))


def _too_near(samples: Float, distance: Float, wanted: Float, lack: Float) -> Iterator[Reason]:
    """Yield the reasons against a path that is too close to the ground: depth at its ends, clearance elsewhere."""
    for test, detail, of_this_kind in (
        ("depth", "into the ground", wanted < 0),
        ("clearance", "too close", wanted >= 0),
    ):
        of_kind = np.where(of_this_kind, lack, -np.inf)
        sample, cell = np.unravel_index(of_kind.argmax(), of_kind.shape)
        if of_kind[sample, cell] > ROUNDING_M:
            sign = -1.0 if test == "depth" else 1.0
            value, limit = (sign * float(values[sample, cell]) for values in (distance, wanted))
            x, y, z = samples[sample]
            yield Reason(test, value, limit, "m", f"{detail}, at x={x:.3f} y={y:.3f} z={z:.3f} m")


def _flagged(terrain: LayeredGrid | SwingGround, iy: Index, ix: Index, test: str, mask: np.uint16) -> list[Reason]:
    """List with one Reason if cells carry a flag of the mask, else empty; test "unknown" also fails off the grid."""
    inside = terrain.geometry.contains(iy, ix)
    flags = terrain.hazard[iy[inside], ix[inside]] & mask
    off = int((~inside).sum()) if test == "unknown" else 0
    if not (count := off + int((flags != 0).sum())):
        return []
    found = names(int(np.bitwise_or.reduce(flags))) + (["off the grid"] if off else [])
    return [Reason(test, count, 0.0, "cells", ", ".join(found))]


def _ground_verdict(terrain: LayeredGrid, iy: Index, ix: Index) -> PathVerdict:
    """Verdict on cells that must be known and free of hazards other than EDGE."""
    reasons = _flagged(terrain, iy, ix, "unknown", UNKNOWN_MASK)
    reasons += _flagged(terrain, iy, ix, "hazard", ALL_BUT_EDGE & ~UNKNOWN_MASK)
    return PathVerdict(not reasons, np.nan, tuple(reasons))


def checked_points(points: npt.ArrayLike, columns: tuple[int, ...], least: int, name: str) -> Float:
    """Convert the points of a path to an array (n, columns), and check shape, number, length and coordinates.

    Raises:
        InvalidInput: the points are too few, not finite numbers or of the wrong shape, the path is longer than
            LONGEST_PATH_M, or a coordinate is beyond it.
    """
    wanted = " or ".join(f"(n, {c})" for c in columns)
    array = numbers(points, name)
    if array.ndim != 2 or array.shape[1] not in columns or len(array) < least:
        raise InvalidInput(f"{name} have shape {array.shape}; {least} or more finite points {wanted} are needed")
    if not np.isfinite(array).all():
        raise InvalidInput(f"{name} contain NaN or infinity; allowed: finite points {wanted}")
    length = float(np.linalg.norm(np.diff(array, axis=0), axis=1).sum())
    if length > LONGEST_PATH_M or np.abs(array).max() > LONGEST_PATH_M:
        raise InvalidInput(f"{name} reach {max(length, np.abs(array).max()):.4g} m, allowed: {LONGEST_PATH_M:g} m")
    return array


@dataclass(frozen=True, slots=True)
class Corridor:
    """Cells around each sample of a path, in arrays (samples, cells of a window).

    Attributes:
        iy, ix: indices of the cells, which may be off the grid.
        aside: horizontal distance of the sample from the cell, 0 inside [m].
        used: mask of the cells within the clearance plus half the spacing of the samples.
    """

    iy: Index
    ix: Index
    aside: Float
    used: Mask

    def unique(self) -> tuple[Index, Index]:
        """Indices of all cells of the corridor without duplicates."""
        # Encoded as one number per cell, because sorting pairs is ten times slower.
        both = np.unique(self.iy[self.used] * FARTHEST + self.ix[self.used] + FARTHEST // 2)
        iy = both // FARTHEST
        return iy, both - iy * FARTHEST - FARTHEST // 2


def corridor_of(geometry: GridGeometry, samples: Float, clearance: float) -> Corridor:
    """Cells within `clearance` of samples (n, 3) or (n, 2) of a path, seen from above; cells may be off the grid."""
    resolution = geometry.resolution
    iy, ix = geometry.indices(samples[:, 0], samples[:, 1])
    # Distances are computed from positions, because the indices of far points are clipped.
    reach = int(np.ceil(clearance / resolution)) + 1
    dy, dx = (a.ravel() for a in np.mgrid[-reach : reach + 1, -reach : reach + 1])
    jy, jx = iy[:, None] + dy, ix[:, None] + dx
    x = geometry.origin[0] + (jx + 0.5) * resolution
    y = geometry.origin[1] + (jy + 0.5) * resolution
    aside = np.hypot(
        np.maximum(np.abs(x - samples[:, :1]) - resolution / 2, 0),
        np.maximum(np.abs(y - samples[:, 1:2]) - resolution / 2, 0),
    )
    own = (dy == 0) & (dx == 0)
    aside[:, own] = 0.0
    # Half the spacing of the samples is added, to cover the cells between two samples.
    return Corridor(jy, jx, aside, (aside <= clearance + resolution / 4) | own)


def top_heights(ground: SwingGround, cells: Corridor) -> tuple[Float, Float]:
    """Upper bounds of the ground in the cells of a corridor [m], and the confidence that they include, 0 if unused."""
    at = np.where(cells.used, cells.iy, 0), np.where(cells.used, cells.ix, 0)
    confidence = np.where(cells.used, ground.confidence * np.sqrt(ground.variance[at].astype(np.float64)), 0.0)
    return ground.top[at].astype(np.float64) + confidence, confidence


def sampled(path: Float, spacing: float) -> Float:
    """Points along a path at most `spacing` apart, including its corners."""
    parts = [path[:1]]
    for start, stop in zip(path[:-1], path[1:], strict=True):
        count = max(int(np.ceil(np.linalg.norm(stop - start) / spacing)), 1)
        parts.append(start + (np.arange(1, count + 1) / count)[:, None] * (stop - start))
    return np.concatenate(parts)


@dataclass(frozen=True, slots=True)
class SwingGround:
    """Layers of a grid that are needed to check a swing.

    Attributes:
        geometry: geometry of the grid.
        hazard: (ny, nx) flags.
        top: (ny, nx) highest sample of each cell, or bound of unknown ground [m].
        variance: (ny, nx) variance of the heights [m^2].
        confidence: number of sigmas that are added to `top`.
        rounding: largest relative error of `variance`, which was at least variance / (1 + rounding) before rounding.
    """

    geometry: GridGeometry
    hazard: Flags
    top: Float32
    variance: Float32
    confidence: float
    rounding: float


def bounded_ground(terrain: LayeredGrid) -> SwingGround:
    """Ground of a grid; unknown cells with a ceiling count as being as high as the ceiling."""
    hazard, top, variance = terrain.hazard.copy(), terrain.elevation_max.copy(), terrain.variance.copy()
    limits = terrain.record.required_limits
    rounding = terrain.record.checked_rounding.variance
    bounded = ((hazard & UNKNOWN_MASK) != 0) & np.isfinite(terrain.ceiling)
    # The variance of a ceiling was not rounded, so it is raised by the factor that `check_over` removes again.
    hazard[bounded], top[bounded], variance[bounded] = 0, terrain.ceiling[bounded], CEILING_SIGMA_M**2 * (1 + rounding)
    return SwingGround(terrain.geometry, hazard, top, variance, limits.confidence, rounding)


def swing_ground(terrain: LayeredGrid, start: Float) -> SwingGround:
    """Bounded ground under a path that begins at `start` (3,).

    A sole that stands at `start` rests on the ground, so nothing below it is higher than the sole. Unknown cells wholly
    under the sole, even if it is displaced by the error of its position, therefore count as being as high as the sole.
    They do not become footholds, and cells beside the sole stay unknown.
    """
    ground, limits = bounded_ground(terrain), terrain.record.required_limits
    unknown = (terrain.hazard & UNKNOWN_MASK) != 0
    half = np.array([limits.sole_length, limits.sole_width]) / 2 - terrain.resolution / 2 + 1e-9
    # The model of the robot takes time to load, so it is loaded only if there are unknown cells at the start.
    sole = _sole_at(terrain, start) if (unknown & _within(terrain, start, half + SAME_PLACE_M)).any() else None
    if sole is not None:
        covered = half - limits.confidence * np.sqrt(np.diag(sole.covariance)[:2])
        borne = unknown & _within(terrain, sole.centre, covered)
        ground.hazard[borne], ground.top[borne], ground.variance[borne] = 0, sole.centre[2], sole.covariance[2, 2]
    return ground


def highest_ground(ground: SwingGround, x: Float, y: Float) -> Float:
    """Upper bound of the ground at positions [m]; NaN where it is unknown without a ceiling, STALE or off the grid."""
    iy, ix = ground.geometry.indices(x, y)
    inside = ground.geometry.contains(iy, ix)
    cells = np.where(inside, iy, 0), np.where(inside, ix, 0)
    bound = ground.top[cells].astype(np.float64) + ground.confidence * np.sqrt(ground.variance[cells], dtype=np.float64)
    return np.where(inside & ((ground.hazard[cells] & (UNKNOWN_MASK | UNRELIABLE)) == 0), bound, np.nan)


def highest_at(terrain: LayeredGrid, x: npt.ArrayLike, y: npt.ArrayLike, *, allow_stale: bool = False) -> Float:
    """Upper bound of the ground at positions in base_footprint [m], for planners that compare many swing paths.

    The bound is the highest sample, or the ceiling of unknown ground, plus `confidence` standard deviations. It is NaN
    where the ground is unknown without a ceiling, STALE or off the grid. `check_path` and `swing` use the same heights,
    except under the sole at the start.

    Raises:
        InvalidInput: x and y are not numbers, their shapes cannot be broadcast together, or the metadata of the grid
            lacks limits.
    """
    return highest_ground(bounded_ground(asked(terrain, allow_stale)), *coordinates(x, y))


def _within(terrain: LayeredGrid, centre: Float, half: Float) -> Mask:
    """Mask of the cells whose centres are in a rectangle around a centre; `half` is half its size along x and y [m]."""
    x, y = terrain.geometry.centres()
    return np.asarray((np.abs(y - centre[1]) <= half[1])[:, None] & (np.abs(x - centre[0]) <= half[0]))


def _sole_at(terrain: LayeredGrid, start: Float) -> StandingSole | None:
    """Standing sole at the start of a path; None if there is none, or if the soles are not known."""
    try:
        soles = standing_soles(terrain)
    except (InvalidInput, KinematicsError):
        return None
    return next((sole for sole in soles if np.linalg.norm(sole.centre - start) <= SAME_PLACE_M), None)
