"""`obstacles`: each connected thing that stands above the floor, or lies below it, as an object."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from guara_perception.plane_fit import fit_plane
from guara_perception.readonly import readonly
from guara_perception.terrain.floor_plane import FloorPlane, fit_floor
from guara_perception.terrain.layered_grid import LayeredGrid
from guara_perception.terrain.quantile import quantile

Float = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

# Lower things are relief of the floor; the paper's lowest object is 10 mm high.
LEAST_HEIGHT_M = 0.006
# And this many standard deviations of cell and floor.
LEAST_SIGMAS = 4.0
# Smaller things are noise: 2 cells by 2 on the default grid.
LEAST_AREA_M2 = 1e-4
# A thing may be as high as its highest cells; one cell in ten may be higher by noise.
TOP_QUANTILE = 0.9
# Cells this near to the top surface (and three sigmas) make up the top plane.
TOP_BAND_M = 0.004


@dataclass(frozen=True, slots=True, eq=False)
class Obstacle:
    """Something that stands on the floor or gapes in it, in base_footprint.

    Attributes:
        outline: (n, 2) corners of its outline on the cells' edges [m], counter-clockwise seen from above, not closed.
        height: of its top over the floor [m]; negative for a hole: its bottom.
        top_plane: (a, b, c) of its top (or bottom) z = a x + b y + c [-, -, m].
        position: (3,) centre of its top (or bottom) [m].
        sigma: standard deviation of the height [m].
        hazard: union of the flags of its cells.
        area: that it covers [m^2].
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
    elevation = terrain.elevation.astype(np.float64)
    known = np.isfinite(elevation)
    x, y = np.meshgrid(*terrain.geometry.centres())
    floor = fit_floor(x[known], y[known], elevation[known])
    if floor is None:
        return []
    over = np.where(known, elevation - floor.height_at(x, y), 0.0)
    sigma = np.sqrt(np.where(known, terrain.variance.astype(np.float64), 0.0) + floor.sigma**2)
    threshold = np.maximum(LEAST_HEIGHT_M, LEAST_SIGMAS * sigma)
    least = max(int(np.ceil(LEAST_AREA_M2 / terrain.resolution**2 - 1e-9)), 1)
    found = []
    for mask in (over > threshold, over < -threshold):
        count, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=8)
        for label in range(1, count):
            left, top, width, height, area = (int(value) for value in stats[label])
            if area >= least:
                window = slice(top, top + height), slice(left, left + width)
                found.append(_obstacle(terrain, floor, over, labels[window] == label, (top, left)))
    return sorted(found, key=lambda o: (float(o.position[0]), float(o.position[1])))


def _obstacle(terrain: LayeredGrid, floor: FloorPlane, over: Float, cells: Mask, corner: tuple[int, int]) -> Obstacle:
    """The obstacle of some cells of a window of the grid, whose first cell (iy, ix) is `corner`."""
    iy, ix = np.nonzero(cells)
    iy, ix = iy + corner[0], ix + corner[1]
    cx, cy = terrain.geometry.centres()
    x, y, rise = cx[ix], cy[iy], over[iy, ix]
    elevation = terrain.elevation[iy, ix].astype(np.float64)
    variance = terrain.variance[iy, ix].astype(np.float64)
    sign = 1.0 if rise[0] > 0 else -1.0
    peak = float(quantile(sign * rise, TOP_QUANTILE))
    top = sign * rise >= peak - TOP_BAND_M - 3 * float(np.sqrt(variance.mean()))
    plane = _plane(x[top], y[top], elevation[top])
    centre = np.array([x[top].mean(), y[top].mean()])
    z = float(plane[0] * centre[0] + plane[1] * centre[1] + plane[2])
    residual = elevation[top] - (plane[0] * x[top] + plane[1] * y[top] + plane[2])
    # The mean of the top: noise of neighbouring cells is shared, as if there were only one look per nine cells.
    looks = max(int(top.sum()) / 9, 1.0)
    spread = (float(variance[top].mean()) + float(np.mean(residual**2))) / looks + floor.sigma**2 / 9
    return Obstacle(
        outline=_outline(terrain, cells, corner),
        height=z - float(floor.height_at(centre[0], centre[1])),
        top_plane=plane,
        position=np.array([centre[0], centre[1], z]),
        sigma=float(np.sqrt(spread)),
        hazard=int(np.bitwise_or.reduce(terrain.hazard[iy, ix])),
        area=float(cells.sum()) * terrain.resolution**2,
    )


def _plane(x: Float, y: Float, z: Float) -> tuple[float, float, float]:
    """Least squares, level where the points are too few or on a line."""
    plane = fit_plane(x, y, z) if z.size >= 6 else None
    return plane or (0.0, 0.0, float(z.mean()))


def _outline(terrain: LayeredGrid, cells: Mask, corner: tuple[int, int]) -> Float:
    """Outer contour through the corners of the cells, straight runs as single edges."""
    ny, nx = cells.shape
    corners = np.zeros((ny + 1, nx + 1), dtype=np.uint8)
    for dy in (0, 1):
        for dx in (0, 1):
            corners[dy : dy + ny, dx : dx + nx] |= cells.astype(np.uint8)
    contours, _ = cv2.findContours(corners, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    contour = max(contours, key=cv2.contourArea).reshape(-1, 2).astype(np.float64)
    points = np.asarray(terrain.origin) + (contour + corner[::-1]) * terrain.resolution
    nxt = np.roll(points, -1, axis=0)
    turns = float(np.sum(points[:, 0] * nxt[:, 1] - nxt[:, 0] * points[:, 1]))
    return points if turns > 0 else points[::-1].copy()
