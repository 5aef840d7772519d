"""Stairs as treads (planes) and risers (edges), from the level regions of a grid."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from guara_perception.arrays import Float, Mask
from guara_perception.terrain.layers.layered_grid import LayeredGrid, asked
from guara_perception.terrain.questions.obstacles import fit_plane
from kinematics.arrays import FrozenArrays

# A tread is no steeper and no smaller than this. Level regions whose mean heights differ by less are one tread.
STEEPEST_TREAD_RAD = 0.12
LEAST_TREAD_M2 = 0.0015
SAME_HEIGHT_M = 0.006
# Least and largest rise from one tread to the next.
LEAST_RISE_M, MOST_RISE_M = 0.012, 0.30
# Largest relative difference between the rises of one flight, and largest range of the directions of its edges.
RISES_ALIKE = 0.35
EDGES_ALIKE_RAD = 0.15
# An edge has one point per strip across it. A cell belongs to a tread within this fraction of the rise from it.
STRIP_M = 0.010
LEAST_STRIPS = 8
OF_TREAD = 0.35
# With a wider gap between the known cells of two treads, the edge is that of the upper one.
WIDEST_GAP_M = 0.030
EDGE_STRAIGHT_M = 0.010
LEAST_RISERS = 2


@dataclass(frozen=True, slots=True, eq=False)
class Tread(FrozenArrays):
    """A level part of stairs; the lowest and highest treads are the ground before and behind the stairs.

    Attributes:
        plane: (3,) p of z = p[0] x + p[1] y + p[2] in base_footprint.
        centre: (3,) mean of its cells [m].
        sigma: standard deviation of its cells about the plane [m].
        area: visible area [m^2].
    """

    plane: Float
    centre: Float
    sigma: float
    area: float


@dataclass(frozen=True, slots=True, eq=False)
class Riser(FrozenArrays):
    """The rise from one tread to the next.

    Attributes:
        start, end: (3,) ends of the visible part of its upper edge [m]; `start` is the left one for a climbing robot.
        height: height of the rise [m].
    """

    start: Float
    end: Float
    height: float


@dataclass(frozen=True, slots=True, eq=False)
class Stairs(FrozenArrays):
    """Treads from the lowest to the highest, and the risers between them.

    Attributes:
        treads: the treads, one more than `risers`: the ground before and behind is included.
        risers: the rises from each tread to the next.
        direction: (2,) unit vector up the stairs.
        rise: mean height of the risers [m].
        run: mean distance of neighbouring edges [m].
    """

    treads: tuple[Tread, ...]
    risers: tuple[Riser, ...]
    direction: Float
    rise: float
    run: float


def stairs(terrain: LayeredGrid, *, allow_stale: bool = False) -> Stairs | None:
    """Detect stairs of two risers or more; None if there are none.

    Treads are level regions of known ground whose heights rise evenly, by up to 0.3 m each. Between neighbours there
    must be a straight edge, and all edges must be parallel. An edge is in the middle of the gap between the known cells
    of both treads, or at the upper tread if the gap is wider than 30 mm. `check_foothold` decides if a foot may be set
    on a tread.
    """
    terrain = asked(terrain, allow_stale)
    height = np.asarray(terrain.elevation, np.float64)
    x, y = np.meshgrid(*terrain.geometry.centres())
    regions = _level_regions(terrain, height)
    best: list[tuple[Mask, float]] = []
    for first in range(len(regions)):
        flight = [regions[first]]
        for region in regions[first + 1 :]:
            rise = region[1] - flight[-1][1]
            first_rise = flight[1][1] - flight[0][1] if len(flight) > 1 else rise
            if rise > MOST_RISE_M or abs(rise - first_rise) > RISES_ALIKE * max(rise, first_rise):
                break
            flight.append(region)
        if len(flight) > len(best):
            best = flight
    if len(best) <= LEAST_RISERS:
        return None
    treads = [_tread(x, y, height, mask, terrain.resolution) for mask, _ in best]
    direction = _climb(x, y, best)
    for _ in range(2):
        edges = [
            _edge(x, y, height, lower, upper, direction) for (_, lower), (_, upper) in zip(best, best[1:], strict=False)
        ]
        found = [edge for edge in edges if edge is not None]
        turns = [np.arctan(edge.slope) for edge in found]
        if len(found) < len(edges) or np.ptp(turns) > EDGES_ALIKE_RAD:
            return None
        turn = float(np.mean(turns))
        cosine, sine = np.cos(-turn), np.sin(-turn)
        direction = np.array([[cosine, -sine], [sine, cosine]]) @ direction
    along = [edge.at for edge in found]
    if (np.diff(along) <= 0).any():
        return None
    across = np.array([-direction[1], direction[0]])
    risers = []
    for edge, (_, lower), (_, upper) in zip(found, best, best[1:], strict=False):
        ends = [np.append(edge.at * direction + v * across, upper) for v in (edge.last, edge.first)]
        risers.append(Riser(ends[0], ends[1], upper - lower))
    rises = [riser.height for riser in risers]
    return Stairs(tuple(treads), tuple(risers), direction, float(np.mean(rises)), float(np.mean(np.diff(along))))


def _level_regions(terrain: LayeredGrid, height: Float) -> list[tuple[Mask, float]]:
    """Level regions, cells and mean height [m] of each, the lowest first."""
    with np.errstate(invalid="ignore"):
        level = np.isfinite(height) & (terrain.slope < STEEPEST_TREAD_RAD) & (terrain.step_height < LEAST_RISE_M)
    _, labels, sizes, _ = cv2.connectedComponentsWithStats(level.astype(np.uint8), connectivity=4)
    least = LEAST_TREAD_M2 / terrain.resolution**2
    parts = [labels == label for label in range(1, len(sizes)) if sizes[label, cv2.CC_STAT_AREA] >= least]
    parts.sort(key=lambda part: float(height[part].mean()))
    regions: list[tuple[Mask, float]] = []
    for part in parts:
        if regions and float(height[part].mean()) - regions[-1][1] < SAME_HEIGHT_M:
            part = regions.pop()[0] | part
        regions.append((part, float(height[part].mean())))
    return regions


def _tread(x: Float, y: Float, height: Float, mask: Mask, resolution: float) -> Tread:
    x, y, height = x[mask], y[mask], height[mask]
    a, b, c = fit_plane(x, y, height) or (0.0, 0.0, height.mean())
    centre = np.array([x.mean(), y.mean(), height.mean()])
    return Tread(np.array([a, b, c]), centre, float((height - a * x - b * y - c).std()), x.size * resolution**2)


def _climb(x: Float, y: Float, flight: list[tuple[Mask, float]]) -> Float:
    """Unit vector (2,) along which the heights of the treads rise."""
    centres = np.array([[x[mask].mean(), y[mask].mean()] for mask, _ in flight])
    rises = np.array([mean for _, mean in flight])
    direction = (rises - rises.mean()) @ (centres - centres.mean(axis=0))
    length = float(np.linalg.norm(direction))
    return direction / length if length > 0 else np.array([1.0, 0.0])


@dataclass(frozen=True, slots=True)
class _Edge:
    """Line at `at` along the climb, with a slope of `slope` across, from `first` to `last` across [m]."""

    at: float
    slope: float
    first: float
    last: float


def _edge(x: Float, y: Float, height: Float, lower: float, upper: float, direction: Float) -> _Edge | None:
    """Edge between two heights, None if there is no straight one."""
    along = direction[0] * x + direction[1] * y
    strip = np.floor((direction[0] * y - direction[1] * x) / STRIP_M).astype(int)
    near = OF_TREAD * (upper - lower)
    # Unknown heights are NaN, which is near to none.
    of_lower, of_upper = (np.abs(height - tread) < near for tread in (lower, upper))
    points = []
    for number in np.intersect1d(strip[of_lower], strip[of_upper]).tolist():
        ends, begins = along[of_lower & (strip == number)], along[of_upper & (strip == number)]
        begin = float(begins.min())
        before = ends[ends < begin]
        if before.size:
            gap = begin - float(before.max())
            points.append((begin - gap / 2 if gap <= WIDEST_GAP_M else begin, (number + 0.5) * STRIP_M))
    if len(points) < LEAST_STRIPS:
        return None
    at, across = np.array(points).T
    kept = np.abs(at - np.median(at)) < 3 * EDGE_STRAIGHT_M + 0.3 * np.abs(across - np.median(across))
    at, across = at[kept], across[kept]
    if at.size < LEAST_STRIPS:
        return None
    slope, offset = np.polyfit(across, at, 1)
    if np.sqrt(np.mean((at - slope * across - offset) ** 2)) > EDGE_STRAIGHT_M:
        return None
    mean = float(across.mean())
    return _Edge(float(offset + slope * mean), float(slope), float(across.min()), float(across.max()))
