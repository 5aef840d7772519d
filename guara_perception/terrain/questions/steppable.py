"""Convex regions of safe footholds for optimisation-based planners."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from guara_perception.arrays import Float, Mask
from guara_perception.exceptions import InvalidInput
from guara_perception.settings import RobotLike
from guara_perception.terrain.layers.geometry import half_cells
from guara_perception.terrain.layers.hazard import ALL_BUT_EDGE, with_neighbours
from guara_perception.terrain.layers.layered_grid import LayeredGrid, asked
from guara_perception.terrain.questions.areas import Depth, connected_to
from guara_perception.terrain.questions.best_foothold import checked_disc
from guara_perception.terrain.questions.convex import ConvexPolygon, grow_polygon
from guara_perception.terrain.questions.leg_reach import beyond_reach_of_ground
from guara_perception.terrain.questions.obstacles import fit_plane
from kinematics.arrays import FrozenArrays

# Largest distance of the ground of a region from the region's plane.
PLANE_TOLERANCE_M = 0.006
# Radius of the ground around the seed to which the initial plane is fitted.
SEED_RADIUS_M = 0.03
# Least relative gain in area that replaces the region around the previous choice; it keeps the choice from alternating.
HYSTERESIS = 1 / 3
# A leg must reach points this far outside the corners of a cell.
CORNER_OUTSIDE_M = 1e-4
# Largest extent of a region from its seed along each axis, and least area, in a search over a whole grid.
REGION_REACH_M = 0.4
LEAST_AREA_M2 = 4e-4


@dataclass(frozen=True, slots=True, eq=False)
class SteppableRegion(FrozenArrays):
    """Convex region for the centre of a sole; every point inside passes `check_foothold`.

    Attributes:
        halfspaces: (n, 3) a, b, c of a x + b y <= c, with (a, b) of length 1, in base_footprint [m].
        vertices: (m, 3) corners on the plane, counter-clockwise [m].
        plane: (3,) coefficients p of z = p[0] x + p[1] y + p[2].
        sigma: standard deviation of the ground relative to the plane, including measurement errors [m].
        area: area seen from above [m^2].
        leg: leg that reaches the whole region with the body at its pose in the scan, or None.
    """

    halfspaces: Float
    vertices: Float
    plane: Float
    sigma: float
    area: float
    leg: str | None

    def __repr__(self) -> str:
        """Short text with rounded numbers."""
        x, y = self.centre
        slope = math.degrees(math.atan(math.hypot(self.plane[0], self.plane[1])))
        return (
            f"SteppableRegion(centre ({x:.3f}, {y:.3f}) m, {1e4 * self.area:.1f} cm2, {len(self.vertices)} corners, "
            f"slope {slope:.1f} deg, sigma {1e3 * self.sigma:.2f} mm, leg={self.leg!r})"
        )

    @property
    def centre(self) -> Float:
        """Mean (2,) of the vertices, which is inside the region [m]."""
        return np.asarray(self.vertices[:, :2].mean(axis=0))

    def contains(self, x: float, y: float) -> bool:
        """Test whether a point is inside the region or on its border."""
        return bool((self.halfspaces[:, :2] @ (x, y) <= self.halfspaces[:, 2] + 1e-12).all())


def steppable_region(
    terrain: LayeredGrid,
    x: float,
    y: float,
    radius: float,
    leg: str | None = None,
    previous: SteppableRegion | None = None,
    robot: RobotLike | None = None,
    *,
    allow_stale: bool = False,
) -> SteppableRegion | None:
    """Find a convex region of safe footholds near a nominal position; None if there is none.

    The region grows from the safe cell nearest to the nominal position, over ground within 6 mm of one plane. Every
    point inside passes `check_foothold`.

    Args:
        x, y: nominal position in base_footprint [m].
        radius: largest distance of the region from the nominal position along x and along y [m].
        leg, robot: as in `check_foothold`; the leg reaches every point.
        previous: previous choice, in base_footprint of this grid. The region around its centre is kept while the centre
            is safe and within the radius, unless the new region is at least a third larger.

    Raises:
        InvalidInput: x or y is not a finite number, the radius is not above 0 and at most 1 m, or `previous` is of
            another type. Also as in `check_foothold`.
        kinematics.KinematicsError: no such leg, or the robot cannot be loaded or does not fit the stance.
    """
    terrain = asked(terrain, allow_stale)
    x, y, radius = checked_disc(x, y, radius)
    if radius == 0:
        raise InvalidInput(f"radius is {radius}; it must be above 0 and at most 1 m")
    if previous is not None and not isinstance(previous, SteppableRegion):
        raise InvalidInput(f"previous is {type(previous).__name__}; it must be a SteppableRegion or None")
    window = _Window.about(terrain, x, y, radius, leg, robot)
    seeds = window.free & (np.abs(window.x - x) < radius) & (np.abs(window.y[:, None] - y) < radius)
    if not seeds.any():
        return None
    distance = np.where(seeds, np.hypot(window.x - x, window.y[:, None] - y), np.inf)
    iy, ix = divmod(int(distance.argmin()), distance.shape[1])
    found = _grow(window, iy, ix, leg)
    if previous is not None:
        px, py = previous.centre
        iy, ix = int(np.abs(window.y - py).argmin()), int(np.abs(window.x - px).argmin())
        is_here = max(abs(window.x[ix] - px), abs(window.y[iy] - py)) <= terrain.resolution / 2 + 1e-9
        if is_here and seeds[iy, ix]:
            kept = _grow(window, iy, ix, leg)
            if found.area < kept.area * (1 + HYSTERESIS):
                return kept
    return found


def steppable_regions(
    terrain: LayeredGrid, leg: str | None = None, robot: RobotLike | None = None, *, allow_stale: bool = False
) -> list[SteppableRegion]:
    """Find convex regions of safe footholds over the whole grid, largest first; they may overlap.

    Regions have the properties of a `steppable_region` and extend at most about 0.4 m from their seeds. Safe ground
    that is narrower than about 15 mm, and regions of less than 4 cm^2, are omitted.

    Raises:
        InvalidInput, kinematics.KinematicsError: as in `check_foothold`.
    """
    terrain = asked(terrain, allow_stale)
    (x0, y0), (ny, nx) = terrain.origin, terrain.shape
    centre = x0 + nx * terrain.resolution / 2, y0 + ny * terrain.resolution / 2
    whole = _Window.about(terrain, *centre, max(ny, nx) * terrain.resolution, leg, robot)
    depth = Depth(whole.free)
    found: list[SteppableRegion] = []
    while (2 * (deepest := depth.deepest())[2] * terrain.resolution) ** 2 >= LEAST_AREA_M2:
        iy, ix, _ = deepest
        rows, columns = whole.around(iy, ix, REGION_REACH_M)
        region = _grow(whole.cut(rows, columns), iy - rows.start, ix - columns.start, leg)
        rows, columns = whole.around_points(region.vertices)
        taken = np.ones(whole.free[rows, columns].shape, dtype=bool)
        for a, b, c in region.halfspaces.tolist():
            taken &= a * whole.x[columns] + b * whole.y[rows, None] <= c + 1e-9
        depth.remove(rows, columns, taken)
        depth.remove(slice(iy, iy + 1), slice(ix, ix + 1), np.ones((1, 1), dtype=bool))
        if region.area >= LEAST_AREA_M2:
            found.append(region)
    return sorted(found, key=lambda region: -region.area)


@dataclass(frozen=True, slots=True)
class _Window:
    """Part of a grid.

    Attributes:
        x, y: (nx,) and (ny,) coordinates of the cell centres [m].
        free: (ny, nx) mask of the cells in which a sole may be centred anywhere.
        height, variance: (ny, nx) heights [m] and their local variances [m^2].
        bounds: (n, 3) half-planes of the searched rectangle; none after `cut`.
        resolution: cell edge [m].
        tolerance: largest distance of the ground of a region from its plane [m].
    """

    x: Float
    y: Float
    free: Mask
    height: Float
    variance: Float
    bounds: Float
    resolution: float
    tolerance: float

    @staticmethod
    def about(
        terrain: LayeredGrid, x: float, y: float, radius: float, leg: str | None, robot: RobotLike | None
    ) -> _Window:
        cx, cy = terrain.geometry.centres()
        reach = radius + terrain.resolution / 2
        columns, rows = (np.flatnonzero(np.abs(axis - at) < reach) for axis, at in ((cx, x), (cy, y)))
        part = np.ix_(rows, columns)
        free = (np.asarray(terrain.traversability)[part] > 0) & _off_hazards(terrain)[part]
        height = np.asarray(terrain.elevation, np.float64)[part]
        if leg is not None:
            free &= _reached(terrain, cx[columns], cy[rows], free, height, leg, robot)
        bounds = np.array([[1, 0, x + radius], [-1, 0, radius - x], [0, 1, y + radius], [0, -1, radius - y]])
        variance = np.asarray(terrain.variance_local, np.float64)[part]
        tolerance = PLANE_TOLERANCE_M - terrain.record.checked_rounding.elevation
        return _Window(cx[columns], cy[rows], free, height, variance, bounds, terrain.resolution, tolerance)

    def around_points(self, points: Float) -> tuple[slice, slice]:
        """Rows and columns of the cells whose centres are in the bounding rectangle of points (n, 2) or (n, 3)."""
        low, high = points[:, :2].min(axis=0) - 1e-6, points[:, :2].max(axis=0) + 1e-6
        columns, rows = (
            slice(*np.searchsorted(axis, ends).tolist())
            for axis, ends in ((self.x, (low[0], high[0])), (self.y, (low[1], high[1])))
        )
        return rows, columns

    def around(self, iy: int, ix: int, reach: float) -> tuple[slice, slice]:
        """Rows and columns within a distance of a cell [m]."""
        n = int(reach / self.resolution)
        return slice(max(iy - n, 0), iy + n + 1), slice(max(ix - n, 0), ix + n + 1)

    def cut(self, rows: slice, columns: slice) -> _Window:
        """Some rows and columns of this part, without bounds."""
        layers = {name: getattr(self, name)[rows, columns] for name in ("free", "height", "variance")}
        return replace(self, x=self.x[columns], y=self.y[rows], bounds=np.empty((0, 3)), **layers)


def _off_hazards(terrain: LayeredGrid) -> Mask:
    """Mask of the cells in which a sole may be centred anywhere without covering a hazard.

    EDGE is about soles in the middle of their cells; off the middle, a sole may reach one cell more.
    """
    limits, resolution, (ny, nx) = terrain.record.required_limits, terrain.resolution, terrain.shape
    soles = limits.sole_width, limits.sole_length
    reach = [math.ceil(length / 2 / resolution - 1e-9) for length in soles]
    if reach == [half_cells(length, resolution) for length in soles]:
        return np.ones(terrain.shape, dtype=bool)
    bad = np.pad((terrain.hazard & ALL_BUT_EDGE) != 0, [(n, n) for n in reach], constant_values=True)
    for axis, cells in enumerate((ny, nx)):
        bad = np.logical_or.reduce([bad.take(range(n, n + cells), axis) for n in range(2 * reach[axis] + 1)])
    return ~bad


def _reached(
    terrain: LayeredGrid, cx: Float, cy: Float, free: Mask, height: Float, leg: str, robot: RobotLike | None
) -> Mask:
    """Mask of the free cells whose corners are reached by a leg."""
    iy, ix = np.nonzero(free)
    half = terrain.resolution / 2 + CORNER_OUTSIDE_M
    centres = np.column_stack((cx[ix], cy[iy], height[iy, ix]))
    result = free.copy()
    for sx, sy in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
        corners = centres + (sx * half, sy * half, 0.0)
        result[iy, ix] &= beyond_reach_of_ground(terrain, leg, corners, robot) == 0
    return result


def _grow(window: _Window, iy: int, ix: int, leg: str | None) -> SteppableRegion:
    """Grow the region around a free cell of a window."""
    plane, ground = _plane_of(window, iy, ix)
    # The rim of the window and the cells next to the ground bound the region; all other cells are behind these.
    padded = np.pad(ground, 1)
    by, bx = np.nonzero(with_neighbours(padded) & ~padded)
    resolution = window.resolution
    squares = np.column_stack((window.x[0] + (bx - 1) * resolution, window.y[0] + (by - 1) * resolution))
    at = np.array([window.x[ix], window.y[iy]])
    far = np.array([[1, 0, at[0] + 2], [-1, 0, 2 - at[0]], [0, 1, at[1] + 2], [0, -1, 2 - at[1]]])
    polygon = grow_polygon(at, np.vstack((far, window.bounds)), squares, resolution / 2)
    return _region(window, polygon, plane, ground, leg)


def _plane_of(window: _Window, iy: int, ix: int) -> tuple[Float, Mask]:
    """Plane of the ground around a free cell, and mask of the free cells near the plane and connected to the cell."""
    radius = max(SEED_RADIUS_M, 2 * window.resolution)
    rows, columns = window.around(iy, ix, radius + window.resolution)
    aside = np.hypot(window.x[columns] - window.x[ix], window.y[rows, None] - window.y[iy])
    near = np.zeros(window.free.shape, dtype=bool)
    near[rows, columns] = window.free[rows, columns] & (aside < radius)
    plane = _fitted(window, near)
    within, ground = np.zeros_like(near), near
    for _ in range(2):
        off = np.abs(window.height - (plane[0] * window.x + (plane[1] * window.y + plane[2])[:, None]))
        before, within = within, window.free & (off <= window.tolerance)
        within[iy, ix] = True
        if np.array_equal(within, before):
            break
        ground = connected_to(within, iy, ix)
        plane = _fitted(window, ground)
    return plane, ground


def _fitted(window: _Window, cells: Mask) -> Float:
    """Least-squares plane (3,) through the heights of cells; level if the cells are too few or collinear."""
    iy, ix = np.nonzero(cells)
    height = window.height[cells]
    return np.array(fit_plane(window.x[ix], window.y[iy], height) or (0.0, 0.0, height.mean()))


def _region(window: _Window, polygon: ConvexPolygon, plane: Float, ground: Mask, leg: str | None) -> SteppableRegion:
    rows, columns = window.around_points(polygon.vertices)
    x, y = window.x[columns], window.y[rows, None]
    inside = ground[rows, columns].copy()
    for a, b, c in polygon.halfspaces.tolist():
        inside &= a * x + b * y <= c
    # A small polygon may lie between the cell centres; then all of the ground is used.
    part, cells = ((rows, columns), inside) if inside.any() else ((slice(None), slice(None)), ground)
    iy, ix = np.nonzero(cells)
    height, variance = window.height[part][cells], window.variance[part][cells]
    off = height - (plane[0] * window.x[part[1]][ix] + plane[1] * window.y[part[0]][iy] + plane[2])
    vertices = np.column_stack((polygon.vertices, polygon.vertices @ plane[:2] + plane[2]))
    return SteppableRegion(
        halfspaces=polygon.halfspaces,
        vertices=vertices,
        plane=plane,
        sigma=math.sqrt(float(off @ off) / off.size + float(variance.sum()) / off.size),
        area=polygon.area,
        leg=leg,
    )
