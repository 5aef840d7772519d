"""`stairs`: treads and risers as planes and edges, from the level regions of a grid."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from guara_perception.arrays import Float, Mask
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK
from guara_perception.terrain.layers.layered_grid import LayeredGrid, asked
from kinematics.arrays import FrozenArrays

# A tread is level to this, and no smaller than this; level cells beside each other of one height are one tread.
STEEPEST_TREAD_RAD = 0.12
LEAST_TREAD_M2 = 0.0015
SAME_HEIGHT_M = 0.006
# Least and largest rise from one tread to the next.
LEAST_RISE_M, MOST_RISE_M = 0.012, 0.30
# The rises of stairs, and the directions of their edges, are alike.
RISES_ALIKE = 0.35
EDGES_ALIKE_RAD = 0.15
# Along an edge one point per strip, of cells whose heights say which tread they belong to.
STRIP_M = 0.010
LEAST_STRIPS = 8
OF_TREAD = 0.35
# A wider gap between what was seen of two treads: the edge is then that of the upper one.
WIDEST_GAP_M = 0.030
EDGE_STRAIGHT_M = 0.010
LEAST_RISERS = 2


@dataclass(frozen=True, slots=True, eq=False)
class Tread(FrozenArrays):
    """A level part of stairs; the lowest and the highest are the ground before and behind.

    Attributes:
        plane: (3,) p of z = p[0] x + p[1] y + p[2] in base_footprint.
        centre: (3,) mean of its cells [m].
        sigma: standard deviation of its cells about the plane [m].
        area: area that was seen of it [m^2].
    """

    plane: Float
    centre: Float
    sigma: float
    area: float


@dataclass(frozen=True, slots=True, eq=False)
class Riser(FrozenArrays):
    """The rise from one tread to the next.

    Attributes:
        start, end: (3,) ends of its upper edge, as far as it was seen; `start` is the left one for a robot that climbs
            [m].
        height: height of the rise [m].
    """

    start: Float
    end: Float
    height: float


@dataclass(frozen=True, slots=True, eq=False)
class Stairs(FrozenArrays):
    """Treads from the lowest to the highest, and the risers between them.

    Attributes:
        treads: the treads, one more than `risers`, as the ground before and behind is among them.
        risers: the rises from each tread to the next.
        direction: (2,) direction up the stairs, of length 1.
        rise: mean height of the risers [m].
        run: mean distance of neighbouring edges [m].
    """

    treads: tuple[Tread, ...]
    risers: tuple[Riser, ...]
    direction: Float
    rise: float
    run: float


def stairs(terrain: LayeredGrid, *, allow_stale: bool = False) -> Stairs | None:
    """Stairs of two risers or more, as treads (planes) and risers (edges); None where there are none.

    Treads are level regions of known ground whose heights rise evenly, by 12 mm to 0.3 m each; between each two
    there must be a straight edge, and all edges must be parallel. An edge is where the ground was seen to change,
    to half the gap between what was seen of both treads; where that is over 30 mm wide, it is the upper tread's.
    `check_foothold` decides whether a foot may be set on a tread.
    """
    terrain = asked(terrain, allow_stale)
    height = np.asarray(terrain.elevation, np.float64)
    known = (np.asarray(terrain.hazard) & UNKNOWN_MASK) == 0
    x, y = np.meshgrid(*terrain.geometry.centres())
    regions = _level_regions(terrain, height)
    best: list[tuple[Mask, float]] = []
    for first in range(len(regions)):
        flight = [regions[first]]
        for region in regions[first + 1 :]:
            rise = region[1] - flight[-1][1]
            if rise > MOST_RISE_M or (len(flight) > 1 and not _alike(rise, flight[1][1] - flight[0][1])):
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
            _edge(x, y, height, known, lower, upper, direction)
            for (_, lower), (_, upper) in zip(best, best[1:], strict=False)
        ]
        if any(edge is None for edge in edges):
            return None
        turns = [np.arctan(edge.slope) for edge in edges if edge is not None]
        if np.ptp(turns) > EDGES_ALIKE_RAD:
            return None
        turn = float(np.mean(turns))
        cosine, sine = np.cos(-turn), np.sin(-turn)
        direction = np.array([[cosine, -sine], [sine, cosine]]) @ direction
    found = [edge for edge in edges if edge is not None]
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


def _alike(one: float, other: float) -> bool:
    return abs(one - other) <= RISES_ALIKE * max(one, other)


def _level_regions(terrain: LayeredGrid, height: Float) -> list[tuple[Mask, float]]:
    """Level ground by its height: cells and mean height [m] of each, the lowest first."""
    with np.errstate(invalid="ignore"):
        level = np.isfinite(height) & (terrain.slope < STEEPEST_TREAD_RAD) & (terrain.step_height < LEAST_RISE_M)
    _, labels, sizes, _ = cv2.connectedComponentsWithStats(level.astype(np.uint8), connectivity=4)
    least = LEAST_TREAD_M2 / terrain.resolution**2
    parts = [labels == label for label in range(1, len(sizes)) if sizes[label, cv2.CC_STAT_AREA] >= least]
    parts.sort(key=lambda part: float(height[part].mean()))
    regions: list[tuple[Mask, float]] = []
    for part in parts:
        mean = float(height[part].mean())
        if regions and mean - regions[-1][1] < SAME_HEIGHT_M:
            joined = regions[-1][0] | part
            regions[-1] = joined, float(height[joined].mean())
        else:
            regions.append((part, mean))
    return regions


def _tread(x: Float, y: Float, height: Float, mask: Mask, resolution: float) -> Tread:
    centre = np.array([x[mask].mean(), y[mask].mean(), height[mask].mean()])
    design = np.column_stack((x[mask] - centre[0], y[mask] - centre[1], np.ones(int(mask.sum()))))
    (a, b, c), *_ = np.linalg.lstsq(design, height[mask], rcond=None)
    off = height[mask] - design @ (a, b, c)
    plane = np.array([a, b, c - a * centre[0] - b * centre[1]])
    return Tread(plane, centre, float(off.std()), float(mask.sum()) * resolution**2)


def _climb(x: Float, y: Float, flight: list[tuple[Mask, float]]) -> Float:
    """Direction (2,) from the lowest tread to the highest: that in which the heights of treads rise."""
    centres = np.array([[x[mask].mean(), y[mask].mean()] for mask, _ in flight])
    rises = np.array([mean for _, mean in flight])
    direction = (rises - rises.mean()) @ (centres - centres.mean(axis=0))
    length = float(np.linalg.norm(direction))
    return direction / length if length > 0 else np.array([1.0, 0.0])


@dataclass(frozen=True, slots=True)
class _Edge:
    """A line at `at` along the climb, turned by `slope` per metre across, from `first` to `last` across [m]."""

    at: float
    slope: float
    first: float
    last: float


def _edge(x: Float, y: Float, height: Float, known: Mask, lower: float, upper: float, direction: Float) -> _Edge | None:
    """The edge between two heights, None where there is no straight one."""
    along = direction[0] * x + direction[1] * y
    strip = np.floor((direction[0] * y - direction[1] * x) / STRIP_M).astype(int)
    near = OF_TREAD * (upper - lower)
    of_lower, of_upper = (known & (np.abs(height - tread) < near) for tread in (lower, upper))
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
