"""Detection of stairs as treads (planes) and risers (edges), from the level regions of a grid."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TypeAlias

import numpy as np

from guara_perception.arrays import Float, Mask
from guara_perception.exceptions import optional_library
from guara_perception.terrain.layers.geometry import disc_kernel
from guara_perception.terrain.layers.layered_grid import LayeredGrid, asked
from guara_perception.terrain.questions.obstacles import fit_plane
from kinematics.arrays import FrozenArrays

# Largest slope, smallest area and smallest number of cells of a tread.
STEEPEST_TREAD_RAD = 0.12
LEAST_TREAD_M2, LEAST_TREAD_CELLS = 0.0015, 20
# Level regions belong to one tread if their mean heights differ by at most SAME_OF_RISE of the rise. The first rise of
# a flight must be at least SAME_SIGMAS standard deviations of the height difference between its regions.
SAME_SIGMAS, SAME_OF_RISE = 3.0, 0.2
# On a noisy grid, the slope of a tread may be larger by SLOPE_SIGMAS standard deviations of the slope, and the step
# within it may reach STEP_SIGMAS standard deviations of the height.
SLOPE_SIGMAS, STEP_SIGMAS = 1.0, 4.0
# Least and largest rise from one tread to the next.
LEAST_RISE_M, MOST_RISE_M = 0.012, 0.30
# Largest difference of the rises of a flight from its first rise, as a fraction of that rise, and largest range of the
# directions of its edges.
RISES_ALIKE = 0.35
EDGES_ALIKE_RAD = 0.15
# A tread deeper than this multiple of the median depth is a landing; a flight that includes a landing is rejected.
LANDING = 2.0
# Each strip along the climb, at least one cell wide, gives one point of an edge. A cell belongs to a tread if their
# heights differ by less than OF_TREAD of the rise.
STRIP_M = 0.010
LEAST_STRIPS = 8
OF_TREAD = 0.35
# Widest gap between the known cells of two treads (2.2 cells if that is more) in whose middle the edge is placed.
# Across a wider gap, the edge is placed at the border of the upper tread.
WIDEST_GAP_M = 0.030
# Largest rms deviation of an edge from a straight line; one cell if that is more.
EDGE_STRAIGHT_M = 0.010
LEAST_RISERS = 2
# Largest number of flights whose edges are tested: the longest, and among equals those with the largest treads.
MOST_FLIGHTS = 20

# Cells and mean height [m] of each tread, lowest tread first.
Flight: TypeAlias = list[tuple[Mask, float]]


@dataclass(frozen=True, slots=True, eq=False)
class Tread(FrozenArrays):
    """Level part of stairs; the lowest and highest treads are the ground at the foot and at the top of the stairs.

    Attributes:
        plane: (3,) coefficients p of z = p[0] x + p[1] y + p[2] in base_footprint.
        centre: (3,) mean position of the tread's cells [m].
        sigma: standard deviation of these cells relative to the plane [m].
        area: visible area [m^2].
    """

    plane: Float
    centre: Float
    sigma: float
    area: float


@dataclass(frozen=True, slots=True, eq=False)
class Riser(FrozenArrays):
    """Rise from one tread to the next.

    Attributes:
        start, end: (3,) ends of the visible part of the upper edge [m]; `start` is the left end for a climbing robot.
        height: height of the rise [m].
    """

    start: Float
    end: Float
    height: float


@dataclass(frozen=True, slots=True, eq=False)
class Stairs(FrozenArrays):
    """Treads from the lowest to the highest, and the risers between them.

    Attributes:
        treads: treads including the ground at the foot and at the top of the stairs, one more than `risers`.
        risers: rises from each tread to the next.
        direction: (2,) horizontal unit vector up the stairs.
        rise: mean height of the risers [m].
        run: mean distance between neighbouring edges [m].
    """

    treads: tuple[Tread, ...]
    risers: tuple[Riser, ...]
    direction: Float
    rise: float
    run: float


def stairs(terrain: LayeredGrid, *, allow_stale: bool = False) -> Stairs | None:
    """Detect stairs with two or more risers; None if there are none.

    Treads are level regions of known ground; the rises between them are similar and from 12 mm to 0.3 m. There must be
    a straight edge between neighbouring treads, all edges must be nearly parallel, and no tread between two edges may
    be deeper than twice the median depth of these treads. An edge is in the middle of the gap between the known cells
    of both treads, or at the border of the upper tread if the gap is wider than 30 mm (or 2.2 cells, if that is more).
    `check_foothold` decides whether a foot may be placed on a tread.

    Raises:
        InvalidInput: the metadata of the grid lacks valid traversability limits.
        MissingExtra: OpenCV is not installed.
    """
    terrain = asked(terrain, allow_stale)
    height = np.asarray(terrain.elevation, np.float64)
    x, y = np.meshgrid(*terrain.geometry.centres())
    flights = _flights(_level_regions(terrain, height))
    return next(filter(None, (_as_stairs(x, y, height, terrain.resolution, flight) for flight in flights)), None)


@dataclass(frozen=True)
class _Region:
    """Level region of the ground: cells, mean height and standard deviation of the heights [m]."""

    mask: Mask
    mean: float
    sigma: float

    @cached_property
    def cells(self) -> int:
        return int(np.count_nonzero(self.mask))


def _as_stairs(x: Float, y: Float, height: Float, cell: float, flight: Flight) -> Stairs | None:
    """Stairs with the treads of a flight; None if they are rejected.

    They are rejected if an edge is missing or not straight, if the edges are not parallel or not in ascending order, or
    if a tread is a landing.
    """
    direction, heights = _climb(x, y, flight), list(pairwise(mean for _, mean in flight))
    for _ in range(2):
        found = []
        for lower, upper in heights:
            edge = _edge(x, y, height, cell, lower, upper, direction)
            if edge is None:
                return None
            found.append(edge)
        turns = [np.arctan(edge.slope) for edge in found]
        if np.ptp(turns) > EDGES_ALIKE_RAD:
            return None
        turn = float(np.mean(turns))
        cosine, sine = np.cos(-turn), np.sin(-turn)
        direction = np.array([[cosine, -sine], [sine, cosine]]) @ direction
    runs = np.diff([edge.at for edge in found])
    if (runs <= 0).any() or runs.max() > LANDING * np.median(runs):
        return None
    across = np.array([-direction[1], direction[0]])
    risers = []
    for edge, (lower, upper) in zip(found, heights, strict=True):
        ends = [np.append(edge.at * direction + v * across, upper) for v in (edge.last, edge.first)]
        risers.append(Riser(ends[0], ends[1], upper - lower))
    rises = [riser.height for riser in risers]
    treads = tuple(_tread(x, y, height, mask, cell) for mask, _ in flight)
    return Stairs(treads, tuple(risers), direction, float(np.mean(rises)), float(np.mean(runs)))


def _flights(regions: list[_Region]) -> list[Flight]:
    """Sequences of treads with similar rises, sorted by number of treads, then by total area, largest first.

    Each pair of regions gives a first rise. The next tread is the largest region one rise higher, merged with all
    regions at about its height, so that fragments of a tread and artefacts beside the stairs do not end a flight.
    """
    found: dict[tuple[tuple[int, ...], ...], int] = {}
    for first, low in enumerate(regions):
        for high in regions[first + 1 :]:
            rise = high.mean - low.mean
            if not max(LEAST_RISE_M, SAME_SIGMAS * math.hypot(low.sigma, high.sigma)) <= rise <= MOST_RISE_M:
                continue
            members, step = [_alike(regions, low.mean, rise)], rise
            top = _mean(regions, members[0])
            while above_it := [
                index
                for index, each in enumerate(regions)
                if LEAST_RISE_M <= each.mean - top <= MOST_RISE_M and abs(each.mean - top - step) <= RISES_ALIKE * step
            ]:
                seed = max(above_it, key=lambda index: regions[index].cells)
                members.append(
                    [index for index in _alike(regions, regions[seed].mean, rise) if regions[index].mean > top]
                )
                below, top = top, _mean(regions, members[-1])
                step = top - below if len(members) == 2 else step
            if len(members) > LEAST_RISERS:
                found.setdefault(tuple(map(tuple, members)), sum(regions[i].cells for each in members for i in each))
    best = sorted(found, key=lambda flight: (len(flight), found[flight]), reverse=True)
    return [
        [(np.logical_or.reduce([regions[i].mask for i in each]), _mean(regions, each)) for each in flight]
        for flight in best[:MOST_FLIGHTS]
    ]


def _alike(regions: list[_Region], height: float, rise: float) -> list[int]:
    """Indices of the regions that form one tread at this height."""
    return [index for index, each in enumerate(regions) if abs(each.mean - height) <= SAME_OF_RISE * rise]


def _mean(regions: list[_Region], members: Sequence[int]) -> float:
    """Mean height of the cells of several regions [m]."""
    return float(np.average([regions[i].mean for i in members], weights=[regions[i].cells for i in members]))


def _level_regions(terrain: LayeredGrid, height: Float) -> list[_Region]:
    """Level regions of known ground, lowest first."""
    radius = max(terrain.record.required_limits.disc_radius, terrain.resolution)
    cells = np.count_nonzero(disc_kernel(radius / terrain.resolution))
    sigma = np.sqrt(terrain.variance_local)
    with np.errstate(invalid="ignore"):
        steepest = STEEPEST_TREAD_RAD + SLOPE_SIGMAS * 2 * sigma / (radius * math.sqrt(cells))
        level = np.isfinite(height) & (terrain.slope < steepest)
        level &= terrain.step_height < np.maximum(LEAST_RISE_M, STEP_SIGMAS * sigma)
    cv2 = optional_library("cv2", None, "stairs")
    _, labels, sizes, _ = cv2.connectedComponentsWithStats(level.astype(np.uint8), connectivity=4)
    least = max(LEAST_TREAD_M2 / terrain.resolution**2, LEAST_TREAD_CELLS)
    parts = [labels == label for label in range(1, len(sizes)) if sizes[label, cv2.CC_STAT_AREA] >= least]
    regions = [_Region(part, float(height[part].mean()), float(height[part].std())) for part in parts]
    return sorted(regions, key=lambda region: region.mean)


def _tread(x: Float, y: Float, height: Float, mask: Mask, resolution: float) -> Tread:
    x, y, height = x[mask], y[mask], height[mask]
    a, b, c = fit_plane(x, y, height) or (0.0, 0.0, height.mean())
    centre = np.array([x.mean(), y.mean(), height.mean()])
    return Tread(np.array([a, b, c]), centre, float((height - a * x - b * y - c).std()), x.size * resolution**2)


def _climb(x: Float, y: Float, flight: Flight) -> Float:
    """Horizontal unit vector (2,) along which the treads rise."""
    centres = np.array([[x[mask].mean(), y[mask].mean()] for mask, _ in flight])
    rises = np.array([mean for _, mean in flight])
    direction = (rises - rises.mean()) @ (centres - centres.mean(axis=0))
    length = float(np.linalg.norm(direction))
    return direction / length if length > 0 else np.array([1.0, 0.0])


@dataclass(frozen=True, slots=True)
class _Edge:
    """Edge as a straight line.

    Attributes:
        at: position along the climb [m].
        slope: change of that position per distance across the climb.
        first, last: range across the climb [m].
    """

    at: float
    slope: float
    first: float
    last: float


def _edge(x: Float, y: Float, height: Float, cell: float, lower: float, upper: float, direction: Float) -> _Edge | None:
    """Edge between treads at two heights; None if there is no straight edge."""
    # 2.2 cells exceed the distance between neighbours along a diagonal climb, 1.4 cells, and the distance across one
    # unknown cell along a climb in the direction of an axis, 2 cells.
    width, straight, widest = max(STRIP_M, cell), max(EDGE_STRAIGHT_M, cell), max(WIDEST_GAP_M, 2.2 * cell)
    along = direction[0] * x + direction[1] * y
    strip = np.floor((direction[0] * y - direction[1] * x) / width).astype(int)
    near = OF_TREAD * (upper - lower)
    # Unknown heights are NaN, for which the comparison is False.
    of_lower, of_upper = (np.abs(height - tread) < near for tread in (lower, upper))
    points = []
    for number in np.intersect1d(strip[of_lower], strip[of_upper]).tolist():
        ends, begins = along[of_lower & (strip == number)], along[of_upper & (strip == number)]
        begin = float(begins.min())
        before = ends[ends < begin]
        if before.size:
            gap = begin - float(before.max())
            points.append((begin - gap / 2 if gap <= widest else begin, (number + 0.5) * width, gap <= widest))
    if len(points) < LEAST_STRIPS:
        return None
    at, across, is_narrow = np.array(points).T
    if np.count_nonzero(is_narrow) >= LEAST_STRIPS:
        at, across = at[is_narrow > 0], across[is_narrow > 0]
    # The sides of a flight may be hidden or smeared by the sensor, so a robust line is fitted, then a line to its
    # inliers.
    slope, offset = _robust_line(across, at)
    kept = np.abs(at - slope * across - offset) < 1.5 * straight
    at, across = at[kept], across[kept]
    if at.size < max(LEAST_STRIPS, 0.5 * kept.size):
        return None
    slope, offset = np.polyfit(across, at, 1)
    if np.sqrt(np.mean((at - slope * across - offset) ** 2)) > straight:
        return None
    mean = float(across.mean())
    return _Edge(float(offset + slope * mean), float(slope), float(across.min()), float(across.max()))


def _robust_line(x: Float, y: Float) -> tuple[float, float]:
    """Slope and offset of the Theil-Sen line, whose slope is the median of the slopes between all pairs of points."""
    one, other = np.nonzero(x[:, None] > x)
    slope = float(np.median((y[one] - y[other]) / (x[one] - x[other])))
    return slope, float(np.median(y) - slope * np.median(x))
