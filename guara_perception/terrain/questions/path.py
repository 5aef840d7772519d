"""`check_path` and `check_polygon`: whether a foot may swing, a body pass or something be set down here."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from guara_perception.arrays import Float, Index, Mask
from guara_perception.exceptions import InvalidInput
from guara_perception.terrain.layers.geometry import GridGeometry, touched_cells
from guara_perception.terrain.layers.hazard import ALL_BUT_EDGE, UNKNOWN_MASK, Hazard, Reason, names
from guara_perception.terrain.layers.layered_grid import Ceiling, LayeredGrid, asked
from guara_perception.terrain.questions.swing_ground import SwingGround, swing_ground

# At its ends a swing touches the ground: there it may lie this much lower than the map.
TOUCH_M = 0.005
# Heights of these cells are known, but not to be relied on from above either. Where looks disagree (CONFLICT), the
# highest sample of all of them is in `elevation_max` and the larger variance in `variance`: that bounds the ground.
UNRELIABLE = np.uint16(Hazard.STALE)
LONGEST_PATH_M = 20.0
ROUNDING_M = 1e-9
# More than any index of a cell within the longest path.
FARTHEST = 2**32


@dataclass(frozen=True, slots=True)
class PathVerdict:
    """The answer for a path or an area.

    Attributes:
        ok: whether it is accepted.
        clearance: least distance from the ground over all of the path that must keep the whole clearance [m]; NaN
            where none of it must, it has no height, or lies over unknown ground.
        reasons: each failed test with value and limit; empty where ok.
    """

    ok: bool
    clearance: float
    reasons: tuple[Reason, ...]

    def __bool__(self) -> bool:
        return self.ok

    def __repr__(self) -> str:
        """The same text as `str` with the name of the class."""
        return f"PathVerdict({self})"

    def __str__(self) -> str:
        """Text for people, in millimetres and degrees."""
        if not self.ok:
            return f"refused: {'; '.join(map(str, self.reasons))}"
        return "ok" if math.isnan(self.clearance) else f"ok, clearance {1e3 * self.clearance:.0f} mm"


def check_path(
    terrain: LayeredGrid,
    points: npt.ArrayLike,
    clearance: float,
    *,
    ceiling: Ceiling | None = None,
    allow_stale: bool = False,
) -> PathVerdict:
    """Whether a foot may swing, or a part of the body pass, along a path over this terrain.

    Every cell within `clearance` of the path, seen from above, must be known and not STALE. Points with z: the
    path must stay `clearance` away from the ground (highest samples plus confidence; where looks disagree, the
    highest of all looks). Near its ends, where a foot stands, less is required: at a distance d from the nearer end
    at most d - 5 mm - confidence, the clearance that a vertical lift has there. A path that begins at a sole
    that carried the body when the grid was made may begin on unknown ground: what lies wholly under that sole is
    no higher than it. Points without z: a track on the ground, where no cell may be hazardous.

    Args:
        points: (n, 3) or (n, 2) corners of the path in base_footprint [m].
        clearance: distance to keep from the ground [m].
        ceiling: how high unknown ground can be at most (`LinesOfSight`); None refuses a path over unknown ground.
            Not used for tracks on the ground.

    Raises:
        InvalidInput: points of another shape, not finite or over more than 20 m; a clearance outside 0 ... 1 m; a
            ceiling of another grid.
    """
    terrain = asked(terrain, allow_stale)
    path = checked_points(points, (2, 3), 1, "points of a path")
    check_clearance(clearance)
    if path.shape[1] == 3:
        return check_over(swing_ground(terrain, path[0], ceiling), path, float(clearance))
    at = corridor_of(terrain.geometry, sampled(path, terrain.resolution / 2), float(clearance)).unique()
    return _verdict(_unknown(terrain, *at) + _hazardous(terrain, *at), np.nan)


def check_over(ground: SwingGround, path: Float, clearance: float) -> PathVerdict:
    """Check a path (n, 3) against the ground of a swing."""
    samples = sampled(path, ground.geometry.resolution / 2)
    cells = corridor_of(ground.geometry, samples, clearance)
    at = cells.unique()
    reasons = _unknown(ground, *at) + _unreliable(ground, *at)
    least = np.nan
    if not reasons:
        confidence = confidences(ground, cells)
        distance = distances(ground, samples, cells, confidence)
        from_ends = np.minimum(*(np.linalg.norm(samples - end, axis=1) for end in (path[0], path[-1])))
        # Near its ends a path needs the clearance that a vertical lift has: that is less over less certain ground, so a
        # variance that was rounded up counts as the least that it may have been.
        least_confidence = confidence / np.sqrt(1 + ground.rounding)
        wanted = np.minimum(clearance, from_ends[:, None] - TOUCH_M - least_confidence)
        lack = np.where(cells.used, wanted - distance, -np.inf)
        reasons = list(_too_near(samples, distance, wanted, lack))
        free = (~cells.used | (wanted >= clearance)).all(axis=1)
        if free.any():
            least = float(distance[free].min())
    return _verdict(reasons, least)


def check_clearance(clearance: float) -> None:
    """Refuse a clearance that is not possible.

    Raises:
        InvalidInput: not in 0 ... 1 m.
    """
    if not (np.isfinite(clearance) and 0 <= clearance <= 1):
        raise InvalidInput(f"clearance is {clearance}, it must be 0 ... 1 m")


def check_polygon(terrain: LayeredGrid, corners: npt.ArrayLike, *, allow_stale: bool = False) -> PathVerdict:
    """Whether every cell that a polygon (n, 2) [m] touches is known and free of hazards (EDGE does not count).

    Raises:
        InvalidInput: fewer than three corners, values that are not finite, or an area beyond 20 m.
    """
    terrain = asked(terrain, allow_stale)
    outline = checked_points(corners, (2,), 3, "corners of a polygon")
    iy, ix = touched_cells(outline, terrain.geometry)
    return _verdict(_unknown(terrain, iy, ix) + _hazardous(terrain, iy, ix), np.nan)


def _too_near(samples: Float, distance: Float, wanted: Float, lack: Float) -> Iterator[Reason]:
    """Where the path is nearer to the ground than it must be: at its ends by depth, elsewhere by clearance."""
    for test, detail, of_this_kind in (
        ("depth", "into the ground", wanted < 0),
        ("clearance", "too near", wanted >= 0),
    ):
        of_kind = np.where(of_this_kind, lack, -np.inf)
        sample, cell = np.unravel_index(of_kind.argmax(), of_kind.shape)
        if of_kind[sample, cell] > ROUNDING_M:
            sign = -1.0 if test == "depth" else 1.0
            yield _at(test, sign * distance[sample, cell], sign * wanted[sample, cell], samples[sample], detail)


def _unknown(terrain: LayeredGrid | SwingGround, iy: Index, ix: Index) -> list[Reason]:
    inside = terrain.geometry.contains(iy, ix)
    flags = terrain.hazard[iy[inside], ix[inside]] & UNKNOWN_MASK
    off, unknown = int((~inside).sum()), int((flags != 0).sum())
    if not off + unknown:
        return []
    causes = names(int(np.bitwise_or.reduce(flags))) if flags.size else []
    detail = ", ".join(causes + (["off the grid"] if off else []))
    return [Reason("unknown", off + unknown, 0.0, "cells", detail)]


def _hazardous(terrain: LayeredGrid, iy: Index, ix: Index) -> list[Reason]:
    inside = terrain.geometry.contains(iy, ix)
    flags = terrain.hazard[iy[inside], ix[inside]] & ALL_BUT_EDGE & ~UNKNOWN_MASK
    bad = int((flags != 0).sum())
    return [Reason("hazard", bad, 0.0, "cells", ", ".join(names(int(np.bitwise_or.reduce(flags)))))] if bad else []


def _unreliable(terrain: SwingGround, iy: Index, ix: Index) -> list[Reason]:
    inside = terrain.geometry.contains(iy, ix)
    flags = terrain.hazard[iy[inside], ix[inside]] & UNRELIABLE
    bad = int((flags != 0).sum())
    return [Reason("hazard", bad, 0.0, "cells", ", ".join(names(int(np.bitwise_or.reduce(flags)))))] if bad else []


def _at(test: str, value: float, limit: float, point: Float, detail: str) -> Reason:
    return Reason(
        test, float(value), float(limit), "m", f"{detail}, at x={point[0]:.3f} y={point[1]:.3f} z={point[2]:.3f} m"
    )


def _verdict(reasons: list[Reason], clearance: float) -> PathVerdict:
    return PathVerdict(not reasons, clearance, tuple(reasons))


def checked_points(points: npt.ArrayLike, columns: tuple[int, ...], least: int, name: str) -> Float:
    """Points as an array (n, columns), finite and within LONGEST_PATH_M.

    Raises:
        InvalidInput: naming what was given and what is needed.
    """
    wanted = " or ".join(f"(n, {c})" for c in columns)
    try:
        array = np.array(points, dtype=np.float64)
    except (ValueError, TypeError):
        raise InvalidInput(f"{name} are no array of numbers, {wanted} is needed") from None
    if array.ndim != 2 or array.shape[1] not in columns or len(array) < least or not np.isfinite(array).all():
        raise InvalidInput(f"{name} have shape {array.shape}, {least} or more finite points {wanted} are needed")
    length = float(np.linalg.norm(np.diff(array, axis=0), axis=1).sum())
    if length > LONGEST_PATH_M or np.abs(array).max() > LONGEST_PATH_M:
        raise InvalidInput(f"{name} reach {max(length, np.abs(array).max()):.4g} m, allowed: {LONGEST_PATH_M:g} m")
    return array


@dataclass(frozen=True, slots=True)
class Corridor:
    """Cells within the clearance of each sample, (samples, cells of the window); `used` says which of them count."""

    iy: Index
    ix: Index
    aside: Float
    used: Mask

    def unique(self) -> tuple[Index, Index]:
        """Every cell of the corridor once."""
        # One number per cell: sorting pairs is ten times slower.
        both = np.unique(self.iy[self.used] * FARTHEST + self.ix[self.used] + FARTHEST // 2)
        iy = both // FARTHEST
        return iy, both - iy * FARTHEST - FARTHEST // 2


def corridor_of(geometry: GridGeometry, samples: Float, clearance: float) -> Corridor:
    """The cells within `clearance` of samples (n, 3) or (n, 2) of a path, seen from above; also those off the grid."""
    resolution = geometry.resolution
    iy, ix = geometry.indices(samples[:, 0], samples[:, 1])
    # The geometry clips far indices; positions give the distance, so that nothing far off counts as near.
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
    # Half a sample's spacing more, so that what lies between two samples counts too.
    return Corridor(jy, jx, aside, (aside <= clearance + resolution / 4) | own)


def confidences(ground: SwingGround, cells: Corridor) -> Float:
    """How uncertain the ground of each cell of the corridor is: the confidence in sigmas [m]; 0 where none counts."""
    at = np.where(cells.used, cells.iy, 0), np.where(cells.used, cells.ix, 0)
    margin = ground.confidence * np.sqrt(ground.variance[at].astype(np.float64))
    return np.where(cells.used, margin, 0.0)


def distances(ground: SwingGround, samples: Float, cells: Corridor, confidence: Float) -> Float:
    """Distance of each sample from the ground of each cell [m], negative in it; infinite for cells that do not count.

    Ground is taken at its highest sample plus the confidence in sigmas.
    """
    at = np.where(cells.used, cells.iy, 0), np.where(cells.used, cells.ix, 0)
    over = samples[:, 2:3] - (ground.top[at].astype(np.float64) + confidence)
    distance = np.where(over >= 0, np.hypot(cells.aside, over), np.where(cells.aside > 0, cells.aside, over))
    return np.where(cells.used, distance, np.inf)


def sampled(path: Float, spacing: float) -> Float:
    """Points on the path at most `spacing` apart in the plane, its corners among them."""
    parts = [path[:1]]
    for start, stop in zip(path[:-1], path[1:], strict=True):
        count = max(int(np.ceil(np.linalg.norm(stop - start) / spacing)), 1)
        parts.append(start + (np.arange(1, count + 1) / count)[:, None] * (stop - start))
    return np.concatenate(parts)
