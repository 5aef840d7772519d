"""`obstacles`: each connected thing that stands above the floor, or lies below it, as an object."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from guara_perception.arrays import Flags, Float, Index, Mask
from guara_perception.plane_fit import fit_plane
from guara_perception.readonly import readonly
from guara_perception.terrain.assessment.quantile import quantile
from guara_perception.terrain.layers.layered_grid import LayeredGrid
from guara_perception.terrain.questions.floor_plane import FloorPlane, fit_floor

# Lower things are relief of the floor; the paper's lowest object is 10 mm high.
LEAST_HEIGHT_M = 0.006
# And this many standard deviations of cell and floor.
LEAST_SIGMAS = 4.0
# Smaller things are noise: 2 cells by 2 on the default grid.
LEAST_AREA_M2 = 1e-4
# A thing may be as high as its highest cells; one cell in ten may be higher by noise.
TOP_QUANTILE = 0.9
# Cells this near to the top surface (and three sigmas) make up the top plane.
TOP_DEPTH_M = 0.004


@dataclass(frozen=True, slots=True, eq=False)
class Obstacle:
    """Something that stands on the floor, or a hole in it, in base_footprint.

    Attributes:
        outline: (n, 2) corners of its outline on the cells' edges [m], counter-clockwise seen from above, not closed.
        height: height of its top over the floor [m]; negative for a hole: its bottom.
        top_plane: (a, b, c) of its top (or bottom) z = a x + b y + c [-, -, m].
        position: (3,) centre of its top (or bottom) [m].
        sigma: standard deviation of the height [m].
        hazard: union of the flags of its cells.
        area: area that it covers [m^2].
    """

    outline: Float
    height: float
    top_plane: tuple[float, float, float]
    position: Float
    sigma: float
    hazard: int
    area: float

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        object.__setattr__(self, "outline", readonly(np.asarray(self.outline, dtype=np.float64)))
        object.__setattr__(self, "position", readonly(np.asarray(self.position, dtype=np.float64)))


def obstacles(terrain: LayeredGrid) -> list[Obstacle]:
    """See `TerrainGrid.obstacles`."""
    cells, floor = _known_cells(terrain)
    if floor is None:
        return []
    threshold = np.maximum(LEAST_HEIGHT_M, LEAST_SIGMAS * np.sqrt(cells.variance + floor.sigma**2))
    least = max(int(np.ceil(LEAST_AREA_M2 / terrain.resolution**2 - 1e-9)), 1)
    found = [
        _obstacle(things.some(which), terrain, floor)
        for things in (cells.some(cells.rise > threshold), cells.some(cells.rise < -threshold))
        for which in _connected(things.iy, things.ix)
        if which.size >= least
    ]
    return sorted(found, key=lambda o: (float(o.position[0]), float(o.position[1])))


@dataclass(frozen=True, slots=True)
class _Cells:
    """Some cells of a grid, arrays (n,): their indices, centres, heights, variances, heights over the floor, flags."""

    iy: Index
    ix: Index
    x: Float
    y: Float
    elevation: Float
    variance: Float
    rise: Float
    hazard: Flags

    def some(self, which: Mask | Index) -> _Cells:
        """The cells of a mask, or of indices into the arrays."""
        at = np.flatnonzero(which) if which.dtype == np.bool_ else which
        return _Cells(
            self.iy.take(at),
            self.ix.take(at),
            self.x.take(at),
            self.y.take(at),
            self.elevation.take(at),
            self.variance.take(at),
            self.rise.take(at),
            self.hazard.take(at),
        )


def _known_cells(terrain: LayeredGrid) -> tuple[_Cells, FloorPlane | None]:
    """The known cells and the floor among them; where there is no floor None, and heights over z = 0."""
    known = np.flatnonzero(np.isfinite(terrain.elevation))
    iy, ix = np.divmod(known, terrain.shape[1])
    x, y = (centres.take(index) for centres, index in zip(terrain.geometry.centres(), (ix, iy), strict=True))
    elevation, variance = (layer.take(known).astype(np.float64) for layer in (terrain.elevation, terrain.variance))
    floor = fit_floor(x, y, elevation)
    rise = elevation - (0.0 if floor is None else floor.height_at(x, y))
    return _Cells(iy, ix, x, y, elevation, variance, rise, terrain.hazard.take(known)), floor


def _connected(iy: Index, ix: Index) -> list[Index]:
    """Indices of the cells of each connected thing in the arrays (iy, ix) (n,); cells may touch at a corner only."""
    if not iy.size:
        return []
    rows, columns = iy - iy.min(), ix - ix.min()
    image = np.zeros((rows.max() + 1, columns.max() + 1), dtype=np.uint8)
    image[rows, columns] = 1
    label = cv2.connectedComponents(image, connectivity=8)[1][rows, columns]
    order = np.argsort(label, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(label[order])) + 1)


def _obstacle(cells: _Cells, terrain: LayeredGrid, floor: FloorPlane) -> Obstacle:
    """The obstacle of some connected cells, all above the floor or all below."""
    sign = 1.0 if cells.rise[0] > 0 else -1.0
    height = sign * cells.rise
    lowest = (
        float(quantile(height, TOP_QUANTILE)) - TOP_DEPTH_M - 3 * math.sqrt(float(cells.variance.sum()) / height.size)
    )
    top = np.flatnonzero(height >= lowest)
    top_x, top_y, top_z = (values.take(top) for values in (cells.x, cells.y, cells.elevation))
    a, b, c = plane = _plane(top_x, top_y, top_z)
    x, y = float(top_x.sum()) / top.size, float(top_y.sum()) / top.size
    z = a * x + b * y + c
    residual = top_z - (a * top_x + b * top_y + c)
    # Neighbouring cells share noise: the mean of the top is as uncertain as that of one cell in nine.
    independent = max(top.size / 9, 1.0)
    mean_square = (float(cells.variance.take(top).sum()) + float(residual @ residual)) / top.size
    variance = mean_square / independent + floor.sigma**2 / 9
    return Obstacle(
        outline=_outline(cells, terrain),
        height=z - (floor.a * x + floor.b * y + floor.c),
        top_plane=plane,
        position=np.array([x, y, z]),
        sigma=math.sqrt(variance),
        hazard=int(np.bitwise_or.reduce(cells.hazard)),
        area=float(cells.ix.size) * terrain.resolution**2,
    )


def _plane(x: Float, y: Float, z: Float) -> tuple[float, float, float]:
    """Plane by least squares; a level one where the points are too few or on a line."""
    plane = fit_plane(x, y, z) if z.size >= 6 else None
    return plane or (0.0, 0.0, float(z.mean()))


def _outline(cells: _Cells, terrain: LayeredGrid) -> Float:
    """Outer contour through the corners of the cells, straight runs as single edges."""
    first = np.array([cells.ix.min(), cells.iy.min()])
    columns, rows = cells.ix - first[0], cells.iy - first[1]
    corners = np.zeros((rows.max() + 2, columns.max() + 2), dtype=np.uint8)
    corners[rows, columns] = 1
    corners = cv2.dilate(corners, np.ones((2, 2), np.uint8), anchor=(1, 1))
    contours, _ = cv2.findContours(corners, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    contour = max(contours, key=cv2.contourArea)
    is_counter_clockwise = cv2.contourArea(contour, oriented=True) > 0
    points = np.asarray(terrain.origin) + (contour[:, 0] + first) * terrain.resolution
    return points if is_counter_clockwise else points[::-1]
