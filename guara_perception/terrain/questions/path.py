"""`check_path` and `check_polygon`: may a foot swing, a body pass or something be set down here."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from guara_perception.arrays import Float, Index, Mask
from guara_perception.exceptions import InvalidInput
from guara_perception.terrain.layers.hazard import ALL_BUT_EDGE, UNKNOWN_MASK, Hazard, names
from guara_perception.terrain.layers.layered_grid import LayeredGrid
from guara_perception.terrain.layers.limits_of import limits_of
from guara_perception.terrain.layers.reason import Reason
from guara_perception.terrain.questions.polygon import touched_cells

# Near its ends a swing touches the ground: there it may lie so much lower than the map.
TOUCH_M = 0.005
# Heights of these cells are known, but not to be relied on from above either.
UNRELIABLE = np.uint16(Hazard.STALE | Hazard.CONFLICT)
LONGEST_PATH_M = 20.0


@dataclass(frozen=True, slots=True)
class PathVerdict:
    """The answer for a path or an area.

    Attributes:
        ok: whether it is accepted.
        clearance: least distance from the ground over the whole path but its ends [m]; NaN where it has no height, or
            lies over unknown ground.
        reasons: each failed test with value and limit; empty where ok.
    """

    ok: bool
    clearance: float
    reasons: tuple[Reason, ...]

    def __bool__(self) -> bool:
        """The same as `ok`."""
        return self.ok


def check_path(terrain: LayeredGrid, points: npt.ArrayLike, clearance: float) -> PathVerdict:
    """See `TerrainGrid.check_path`."""
    path = _checked_points(points, (2, 3), 1, "points of a path")
    if not (np.isfinite(clearance) and 0 <= clearance <= 1):
        raise InvalidInput(f"clearance is {clearance}, it must be 0 ... 1 m")
    samples = _sampled(path, terrain.resolution / 2)
    cells = _corridor(terrain, samples, float(clearance))
    reasons = _unknown(terrain, *cells.unique())
    if path.shape[1] == 2:
        return _verdict(reasons + _hazardous(terrain, *cells.unique()), np.nan)
    reasons += _unreliable(terrain, *cells.unique())
    least = np.nan
    if not reasons:
        distance = _distances(terrain, samples, cells)
        from_ends = np.minimum(*(np.linalg.norm(samples - end, axis=1) for end in (path[0], path[-1])))
        free = from_ends > clearance
        under = np.where(cells.aside == 0, distance, np.inf).min(axis=1)
        if (~free & (under < -TOUCH_M)).any():
            reasons.append(_at("depth", -under.min(), TOUCH_M, samples[under.argmin()], "into the ground"))
        nearest = distance.min(axis=1)
        if free.any():
            least = float(nearest[free].min())
            if least < clearance:
                reasons.append(_at("clearance", least, clearance, samples[free][nearest[free].argmin()], "least"))
    return _verdict(reasons, least)


def check_polygon(terrain: LayeredGrid, corners: npt.ArrayLike) -> PathVerdict:
    """See `TerrainGrid.check_polygon`."""
    outline = _checked_points(corners, (2,), 3, "corners of a polygon")
    iy, ix = touched_cells(outline, terrain.geometry)
    return _verdict(_unknown(terrain, iy, ix) + _hazardous(terrain, iy, ix), np.nan)


@dataclass(frozen=True, slots=True)
class _Corridor:
    """Cells within the clearance of each sample, (samples, cells of the window); `used` says which of them count."""

    iy: Index
    ix: Index
    aside: Float
    used: Mask

    def unique(self) -> tuple[Index, Index]:
        """Every cell of the corridor once."""
        pairs = np.unique(np.column_stack((self.iy[self.used], self.ix[self.used])), axis=0)
        return pairs[:, 0], pairs[:, 1]


def _corridor(terrain: LayeredGrid, samples: Float, clearance: float) -> _Corridor:
    geometry = terrain.geometry
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
    return _Corridor(jy, jx, aside, (aside <= clearance + resolution / 4) | own)


def _distances(terrain: LayeredGrid, samples: Float, cells: _Corridor) -> Float:
    """Distance of each sample from the ground of each cell [m], negative in it; infinite for cells that do not count.

    Ground is taken at its highest sample plus the confidence in sigmas.
    """
    at = np.where(cells.used, cells.iy, 0), np.where(cells.used, cells.ix, 0)
    top = terrain.elevation_max[at].astype(np.float64)
    top += limits_of(terrain).confidence * np.sqrt(terrain.variance[at].astype(np.float64))
    over = samples[:, 2:3] - top
    distance = np.where(over >= 0, np.hypot(cells.aside, over), np.where(cells.aside > 0, cells.aside, over))
    return np.where(cells.used, distance, np.inf)


def _unknown(terrain: LayeredGrid, iy: Index, ix: Index) -> list[Reason]:
    inside = terrain.geometry.contains(iy, ix)
    flags = terrain.hazard[iy[inside], ix[inside]] & UNKNOWN_MASK
    off, unknown = int((~inside).sum()), int((flags != 0).sum())
    if not off + unknown:
        return []
    causes = names(int(np.bitwise_or.reduce(flags))) if flags.size else []
    words = ", ".join(causes + (["off the grid"] if off else []))
    return [Reason("unknown", off + unknown, 0.0, "cells", words)]


def _hazardous(terrain: LayeredGrid, iy: Index, ix: Index) -> list[Reason]:
    inside = terrain.geometry.contains(iy, ix)
    flags = terrain.hazard[iy[inside], ix[inside]] & ALL_BUT_EDGE & ~UNKNOWN_MASK
    bad = int((flags != 0).sum())
    return [Reason("hazard", bad, 0.0, "cells", ", ".join(names(int(np.bitwise_or.reduce(flags)))))] if bad else []


def _unreliable(terrain: LayeredGrid, iy: Index, ix: Index) -> list[Reason]:
    inside = terrain.geometry.contains(iy, ix)
    flags = terrain.hazard[iy[inside], ix[inside]] & UNRELIABLE
    bad = int((flags != 0).sum())
    return [Reason("hazard", bad, 0.0, "cells", ", ".join(names(int(np.bitwise_or.reduce(flags)))))] if bad else []


def _at(test: str, value: float, limit: float, point: Float, words: str) -> Reason:
    return Reason(test, float(value), limit, "m", f"{words}, at x={point[0]:.3f} y={point[1]:.3f} z={point[2]:.3f} m")


def _verdict(reasons: list[Reason], clearance: float) -> PathVerdict:
    return PathVerdict(not reasons, clearance, tuple(reasons))


def _sampled(path: Float, spacing: float) -> Float:
    """Points on the path at most `spacing` apart in the plane, its corners among them."""
    parts = [path[:1]]
    for start, stop in zip(path[:-1], path[1:], strict=True):
        count = max(int(np.ceil(np.linalg.norm(stop - start) / spacing)), 1)
        parts.append(start + (np.arange(1, count + 1) / count)[:, None] * (stop - start))
    return np.concatenate(parts)


def _checked_points(points: npt.ArrayLike, columns: tuple[int, ...], least: int, name: str) -> Float:
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
