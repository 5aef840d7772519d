"""The paper's steps after triangulation, with scipy: range image by griddata, eqs. 20 and 21, slope, step height."""

from __future__ import annotations

import numpy as np

from guara_perception.arrays import Float

Range = tuple[float, float]

# Picture of the paper: rows along x, columns along y.
ROWS, COLUMNS = 512, 640
# Window of slope and step height, as the grids of this project have it.
WINDOW_M = 0.030


def range_image(points: Float, optical_centre: Float, x: Range, y: Range) -> Float:
    """Perspective range image (512, 640) [m], filled by bilinear interpolation.

    Args:
        points: (n, 3) in base_footprint.
        optical_centre: (3,) in base_footprint.
        x, y: area of the picture [m].
    """
    from scipy.interpolate import griddata

    # Where the camera's ray through each point meets the floor.
    floor = optical_centre[:2] + (points[:, :2] - optical_centre[:2]) * (
        optical_centre[2] / (optical_centre[2] - points[:, 2:])
    )
    row = (floor[:, 0] - x[0]) / (x[1] - x[0]) * ROWS - 0.5
    column = (floor[:, 1] - y[0]) / (y[1] - y[0]) * COLUMNS - 0.5
    u, v = np.meshgrid(np.arange(COLUMNS), np.arange(ROWS))
    return np.asarray(griddata((column, row), points[:, 2], (u, v), method="linear"))


def orthorectified(height: Float, optical_centre: Float, x: Range, y: Range) -> Float:
    """Eqs. 20 and 21 about the nadir: every pixel is sent to its true position, where the highest one stays."""
    nadir_u, nadir_v = _nadir(optical_centre, x, y)
    u, v = np.meshgrid(np.arange(COLUMNS), np.arange(ROWS))
    shrink = (optical_centre[2] - height) / optical_centre[2]
    known = np.isfinite(height)
    true_u = np.rint((u - nadir_u) * shrink + nadir_u)[known].astype(int)
    true_v = np.rint((v - nadir_v) * shrink + nadir_v)[known].astype(int)
    inside = (true_u >= 0) & (true_u < COLUMNS) & (true_v >= 0) & (true_v < ROWS)
    ortho = np.full((ROWS, COLUMNS), -np.inf)
    np.maximum.at(ortho, (true_v[inside], true_u[inside]), height[known][inside])
    return ortho


def cells(ortho: Float, x: Range, y: Range, cell: float) -> Float:
    """Mean height of the picture's pixels in each cell, a[iy, ix], NaN where there is none."""
    nx, ny = round((x[1] - x[0]) / cell), round((y[1] - y[0]) / cell)
    rows, columns = np.nonzero(np.isfinite(ortho))
    cell_of_pixel = ((columns + 0.5) * ny / COLUMNS).astype(int) * nx + ((rows + 0.5) * nx / ROWS).astype(int)
    total = np.bincount(cell_of_pixel, weights=ortho[rows, columns], minlength=nx * ny)
    count = np.bincount(cell_of_pixel, minlength=nx * ny)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan).reshape(ny, nx)


def layers(elevation: Float, cell: float) -> tuple[Float, Float]:
    """Slope (tangent) and step height [m] in the window around every cell."""
    from scipy.ndimage import generic_filter

    size = window_cells(cell)
    a, b = (axis.ravel() * cell for axis in np.mgrid[-(size // 2) : size // 2 + 1, -(size // 2) : size // 2 + 1])
    gradients = np.linalg.pinv(np.column_stack((a, b, np.ones(a.size))))[:2]

    def slope(window: Float) -> float:
        return float(np.hypot(*(gradients @ window)))

    def step_height(window: Float) -> float:
        return float(window.max() - window.min())

    return generic_filter(elevation, slope, size=size), generic_filter(elevation, step_height, size=size)


def window_cells(cell: float) -> int:
    """Odd number of cells that spans the window."""
    return 2 * int(np.ceil(WINDOW_M / 2 / cell)) + 1


def _nadir(optical_centre: Float, x: Range, y: Range) -> tuple[float, float]:
    """Column and row of the spot below the camera."""
    return (optical_centre[1] - y[0]) / (y[1] - y[0]) * COLUMNS - 0.5, (optical_centre[0] - x[0]) / (
        x[1] - x[0]
    ) * ROWS - 0.5
