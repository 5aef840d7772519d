"""Geometry of grids: positions and order of cells, and cells inside a polygon, a disc or a sole."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from guara_perception.arrays import Codes, Float, Index, Mask
from guara_perception.exceptions import InvalidInput
from guara_perception.settings import TraversabilityLimits

# Largest number of cells, as in a Terrain message (docs/messages.md); all layers of a grid of this size take 192 MB.
MOST_CELLS = 4_000_000
Kernel = Codes
# Minimum known fraction of a disc for a plane fit. A fit to a partly known disc makes no cell safe, because a cell gets
# EDGE unless its disc is wholly known.
KNOWN_SHARE = 0.6
# Largest radius of the disc [cells]. Smaller cells would show no more detail, because the spacing of stripes limits it.
MOST_RADIUS_CELLS = 24
# Number of rings of cells around the disc that must also be known, because a lost stripe may change heights beside it.
# In the fused map, the widening of the sole includes this ring.
EXTRA_RING_CELLS = 1
# Half edge of a cell [cells].
TOUCHED = 0.5
# Minimum widening of the sole in the fused map [cells].
LEAST_MARGIN_CELLS = 1
# Largest drift of the fused map that the tests allow for [cells]; cells with a larger drift are STALE. With a slip of
# 4 % of the path, ground seen 0.5 m earlier has this drift (2 sigma). Even with this drift allowed for, a stair tread
# 240 mm deep has room for a sole.
LARGEST_DRIFT_CELLS = 8


@dataclass(frozen=True, slots=True)
class GridGeometry:
    """Geometry of a grid a[iy, ix]: cell (0, 0) at minimum x and y, x fastest (docs/conventions.md).

    Attributes:
        origin: x and y of the corner of cell (0, 0) [m].
        resolution: edge of a cell [m].
        shape: (ny, nx).
    """

    origin: tuple[float, float]
    resolution: float
    shape: tuple[int, int]

    def __post_init__(self) -> None:
        if not (np.isfinite(self.resolution) and self.resolution > 0):
            raise InvalidInput(f"resolution is {self.resolution}; it must be a positive number of metres")
        if not np.isfinite(self.origin).all() or len(self.origin) != 2:
            raise InvalidInput(f"origin is {self.origin}; it must be two finite numbers (x, y)")
        if len(self.shape) != 2 or min(self.shape) < 1:
            raise InvalidInput(f"grid shape is {self.shape}; it must be (ny, nx) with one cell or more")
        if self.shape[0] * self.shape[1] > MOST_CELLS:
            raise InvalidInput(f"grid shape is {self.shape[0]} x {self.shape[1]}, allowed: at most {MOST_CELLS} cells")

    @staticmethod
    def over(x: tuple[float, float], y: tuple[float, float], resolution: float) -> GridGeometry:
        """Grid over an area that the resolution divides.

        Raises:
            InvalidInput: the resolution is not positive and finite or does not divide the area, or the grid has more
                than MOST_CELLS cells.
        """
        if not (np.isfinite(resolution) and resolution > 0):
            raise InvalidInput(f"resolution is {resolution}; it must be a positive number of metres")
        counts = []
        for low, high in (y, x):
            cells = (high - low) / resolution
            if abs(cells - round(cells)) > 1e-6 * max(cells, 1) or round(cells) < 1:
                raise InvalidInput(
                    f"resolution {resolution} m does not divide the area; it must divide "
                    f"{x[1] - x[0]:.3g} and {y[1] - y[0]:.3g} m"
                )
            counts.append(round(cells))
        return GridGeometry((x[0], y[0]), float(resolution), (counts[0], counts[1]))

    @property
    def size(self) -> int:
        """Number of cells."""
        return self.shape[0] * self.shape[1]

    def indices(self, x: npt.ArrayLike, y: npt.ArrayLike) -> tuple[Index, Index]:
        """Cell indices (iy, ix) of points, also off the grid; -1 for NaN or infinity. Cells are half open: [low, high).

        Indices are clipped to -1 ... 2**31; both ends are off any grid.
        """
        fx = (np.asarray(x, np.float64) - self.origin[0]) / self.resolution
        fy = (np.asarray(y, np.float64) - self.origin[1]) / self.resolution
        # The tolerance for rounding errors keeps a point at 0.50 + 3 * 0.005 out of the cell below.
        ix = np.floor(np.where(np.isfinite(fx), fx, -1.0) + 1e-6)
        iy = np.floor(np.where(np.isfinite(fy), fy, -1.0) + 1e-6)
        limit = 2**31
        return np.clip(iy, -1, limit).astype(np.int64), np.clip(ix, -1, limit).astype(np.int64)

    def contains(self, iy: Index, ix: Index) -> Mask:
        """Mask of the indices on the grid."""
        return (iy >= 0) & (iy < self.shape[0]) & (ix >= 0) & (ix < self.shape[1])

    def centres(self) -> tuple[Float, Float]:
        """Coordinates x (nx,) and y (ny,) of the cell centres [m]."""
        ny, nx = self.shape
        x = self.origin[0] + (np.arange(nx, dtype=np.float64) + 0.5) * self.resolution
        y = self.origin[1] + (np.arange(ny, dtype=np.float64) + 0.5) * self.resolution
        return x, y

    def widened(self, cells: int) -> GridGeometry:
        """Grid with `cells` more rows and columns on each side."""
        (x, y), (ny, nx) = self.origin, self.shape
        aside = cells * self.resolution
        return GridGeometry((x - aside, y - aside), self.resolution, (ny + 2 * cells, nx + 2 * cells))

    def refined(self, factor: int) -> GridGeometry:
        """Grid over the same area with cells `factor` times smaller."""
        ny, nx = self.shape
        return GridGeometry(self.origin, self.resolution / factor, (ny * factor, nx * factor))


def inside_polygon(corners: Float, x: Float, y: Float) -> Mask:
    """Mask of the points inside a simple polygon, from the number of edges crossed by a ray along x.

    Args:
        corners: (n, 2) corners in either direction; the first one is not repeated.
        x, y: coordinates of the points, in arrays of one shape.
    """
    inside = np.zeros(np.shape(x), dtype=bool)
    for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        crosses = (y0 > y) != (y1 > y)
        if crosses.any():
            with np.errstate(divide="ignore", invalid="ignore"):
                at = x0 + (y - y0) * (x1 - x0) / (y1 - y0)
            inside ^= crosses & (x < at)
    return inside


def touched_cells(corners: Float, geometry: GridGeometry) -> tuple[Index, Index]:
    """Cells (iy, ix) touched by a polygon, conservatively; they may be outside the grid.

    A cell counts as touched if its centre is inside the polygon, or within half a cell diagonal of an edge.
    """
    resolution = geometry.resolution
    low, high = corners.min(axis=0) - resolution, corners.max(axis=0) + resolution
    first = np.floor((low - np.array(geometry.origin)) / resolution).astype(np.int64)
    end = np.ceil((high - np.array(geometry.origin)) / resolution).astype(np.int64) + 1
    ix, iy = np.meshgrid(np.arange(first[0], end[0]), np.arange(first[1], end[1]))
    x = geometry.origin[0] + (ix + 0.5) * resolution
    y = geometry.origin[1] + (iy + 0.5) * resolution
    touched = inside_polygon(corners, x, y)
    for start, stop in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        touched |= distance_to_segment(start, stop, x, y) <= resolution * np.sqrt(0.5) + 1e-9
    return iy[touched], ix[touched]


def distance_to_segment(start: Float, stop: Float, x: Float, y: Float) -> Float:
    """Distance of points in the plane from a line segment [m]."""
    along = stop - start
    length = float(along @ along)
    share = np.zeros(np.shape(x)) if length == 0 else ((x - start[0]) * along[0] + (y - start[1]) * along[1]) / length
    share = np.clip(share, 0.0, 1.0)
    return np.asarray(np.hypot(x - start[0] - share * along[0], y - start[1] - share * along[1]))


def disc_kernel(radius_cells: float, half_cell: float = 0.0) -> Kernel:
    """Disc of cells within a radius, as an array (2 r + 1, 2 r + 1) of uint8 with the central cell in its middle.

    It contains at least the four neighbours of the central cell, because a slope cannot be tested with one cell.

    Args:
        radius_cells: radius [cells].
        half_cell: half edge of a square around each centre [cells]; a cell of the array belongs to the disc if any
            part of its square is within the radius. 0 = the centre only, TOUCHED = the whole cell.

    Raises:
        InvalidInput: the radius is MOST_RADIUS_CELLS + 1 cells or more, or NaN.
    """
    if not radius_cells < MOST_RADIUS_CELLS + 1:
        raise InvalidInput(
            f"the radius of the disc is {radius_cells:.0f} cells, allowed: at most {MOST_RADIUS_CELLS}; use larger "
            "cells (resolution) or a smaller disc_radius"
        )
    radius = max(radius_cells, 1.0)
    half = int(np.floor(radius + half_cell + 1e-9))
    nearest = np.maximum(np.abs(np.arange(-half, half + 1)) - half_cell, 0.0)
    # A centre on the circle is within the radius; a square that meets the circle in one point only is not.
    rounding = -1e-9 if half_cell else 1e-9
    return (nearest[:, None] ** 2 + nearest**2 <= radius**2 + rounding).astype(np.uint8)


def beyond_border(disc_radius_cells: float) -> int:
    """Number of rows or columns beyond each border of the fused map that affect the safety of a sole inside it."""
    return disc_kernel(disc_radius_cells, TOUCHED).shape[0] // 2 + _most_beside(disc_kernel(disc_radius_cells))


def _most_beside(kernel: Kernel) -> int:
    """Largest widening of the sole in the map on each side [cells]."""
    return max(LARGEST_DRIFT_CELLS - kernel.shape[0] // 2, LEAST_MARGIN_CELLS)


def widest_window(kernel: Kernel, resolution: float, limits: TraversabilityLimits, *, is_map: bool) -> float:
    """Distance from the centre of a cell to the farthest corner of the window that `edge_cells` reads [m]."""
    half_y, half_x = (half_cells(length, resolution) for length in (limits.sole_width, limits.sole_length))
    touched = disc_kernel(limits.disc_radius / resolution, TOUCHED)
    iy, ix = np.nonzero(touched)
    radius = touched.shape[0] // 2
    more = _most_beside(kernel) if is_map else EXTRA_RING_CELLS
    reach_y, reach_x = np.abs(iy - radius) + more, np.abs(ix - radius) + more
    return float(np.hypot(half_y + reach_y + 0.5, half_x + reach_x + 0.5).max()) * resolution


def half_cells(length: float, resolution: float) -> int:
    """Number of cells touched by a sole of this length on each side of its centre cell."""
    return int(np.ceil((length / 2 - resolution / 2) / resolution - 1e-9)) if length > resolution else 0


def cell_edge(resolution: float | None, default: float) -> float:
    """Edge of a cell as a float [m]; `default` for None.

    Raises:
        InvalidInput: the resolution is not a number.
    """
    if resolution is None:
        return default
    try:
        return float(resolution)
    except (TypeError, ValueError):
        raise InvalidInput(f"resolution is {resolution!r}; it must be a positive number of metres") from None
