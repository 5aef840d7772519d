"""Plane fit over the disc around every cell at once: slope, roughness and how much of the disc is known."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from guara_perception.arrays import Array, Codes, Float
from guara_perception.exceptions import InvalidInput

Kernel = Codes

# A value may come from a partly known disc, from this share on; whether the cell is safe is decided elsewhere.
KNOWN_SHARE = 0.6
# From 50 weights on cv2.filter2D goes through a Fourier transform: every cell would depend on every other by rounding.
MOST_WEIGHTS = 49
# Bounds the cells in one row of the disc; a finer grid gains nothing over the stripe pitch anyway.
MOST_RADIUS_CELLS = 24


@dataclass(frozen=True, slots=True)
class DiscFit:
    """Plane z = a x + b y + c fitted to the disc around each known cell, (n,) float64 each, in the order of the grid.

    Attributes:
        slope: angle of the plane to the horizontal [rad], NaN where too little of the disc is known.
        roughness: sqrt(sum of squared distances to the plane / (n - 1)) [m], NaN likewise.
        slope_sigma: standard deviation of the slope from the variance of the heights [rad].
        roughness_sigma: standard deviation of the roughness, likewise [m].
    """

    slope: Float
    roughness: Float
    slope_sigma: Float
    roughness_sigma: Float


def disc_kernel(radius_cells: float) -> Kernel:
    """Disc of cells whose centres lie within the radius, (2 r + 1, 2 r + 1) uint8; at least the four neighbours.

    A plane needs neighbours: with a smaller disc than one cell a slope would pass untested.

    Raises:
        InvalidInput: the disc is larger than MOST_RADIUS_CELLS cells.
    """
    return _cells_within(radius_cells, 0.0)


def touched_kernel(radius_cells: float) -> Kernel:
    """In the square of `disc_kernel` the cells of which any part lies within the radius, not only their centres.

    Raises:
        InvalidInput: as `disc_kernel`.
    """
    return _cells_within(radius_cells, 0.5)


def _cells_within(radius_cells: float, half_cell: float) -> Kernel:
    """Cells (2 r + 1, 2 r + 1) whose centres, or squares of that half edge about them, come within the radius."""
    if not radius_cells < MOST_RADIUS_CELLS + 1:
        raise InvalidInput(
            f"the disc's radius is {radius_cells:.0f} cells, at most {MOST_RADIUS_CELLS} are allowed: "
            "take a larger resolution or a smaller disc_radius"
        )
    radius = max(radius_cells, 1.0)
    half = int(np.floor(radius + 1e-9))
    nearest = np.maximum(np.abs(np.arange(-half, half + 1)) - half_cell, 0.0)
    return (nearest[:, None] ** 2 + nearest**2 <= radius**2 + 1e-9).astype(np.uint8)


def fit_disc(elevation: Float, variance: Float, kernel: Kernel, resolution: float) -> DiscFit:
    """Fit a plane to the known cells of the disc around each known cell.

    The definition of slope and roughness is that of the well-known grid-map filters (least squares instead of
    principal components, the same on planes). All sums are float64: in float32 the roughness cancels. The result of a
    cell depends on its disc only, to the last bit: no mean height is subtracted, since it would depend on other cells.

    Args:
        elevation: (ny, nx) [m], NaN where unknown.
        variance: (ny, nx) [m^2], NaN where unknown.
        kernel: disc from `disc_kernel`.
        resolution: cell edge [m].
    """
    known = np.isfinite(elevation)
    index = np.flatnonzero(known)
    # Whole numbers, which float32 adds up without loss, and in half the time.
    mask = known.astype(np.float32)
    height = np.where(known, elevation, 0.0)
    half = kernel.shape[0] // 2
    offset = np.arange(-half, half + 1, dtype=np.float64)
    disc = kernel.astype(np.float64)
    x, y = disc * offset[None, :], disc * offset[:, None]

    def sums(layer: Array, weights: Float) -> Float:
        return disc_sums(layer, weights).take(index).astype(np.float64, copy=False)

    # Sums of products become those about the means in their own memory, and arrays that are not needed any more are
    # freed: they take most of the memory of a judgement.
    n, sx, sy = sums(mask, disc), sums(mask, x), sums(mask, y)
    cxx, cxy, cyy = sums(mask, x * offset[None, :]), sums(mask, x * offset[:, None]), sums(mask, y * offset[:, None])
    del mask
    with np.errstate(divide="ignore", invalid="ignore"):
        for product, first, second in ((cxx, sx, sx), (cxy, sx, sy), (cyy, sy, sy)):
            product -= first * second / n
        sz, cxz, cyz = sums(height, disc), sums(height, x), sums(height, y)
        cxz -= sx * sz / n
        cyz -= sy * sz / n
        del sx, sy, first, second, product
        residual = sums(height**2, disc)
        residual -= sz * sz / n
        del sz, height
        determinant = cxx * cyy - cxy**2
        a = (cyy * cxz - cxy * cyz) / determinant
        b = (cxx * cyz - cxy * cxz) / determinant
        del cxy
        # Residuals along z, brought to distances from the plane by the cosine of its slope.
        residual -= a * cxz
        residual -= b * cyz
        del cxz, cyz
        steepness = np.sqrt(a * a + b * b) / resolution
        del a, b
        residual = np.maximum(residual, 0.0) / (1 + steepness**2)
        freedom = np.maximum(n - 1, 1)
        roughness = np.sqrt(residual / freedom)
        del residual
        mean_variance = sums(np.where(known, variance, 0.0), disc) / n
        slope_sigma = np.sqrt(mean_variance * (cxx + cyy) / (2 * determinant)) / resolution / (1 + steepness**2)
        roughness_sigma = np.sqrt(mean_variance / (2 * freedom))
        slope = np.arctan(steepness)
        del mean_variance, freedom, steepness
    # Known on all four sides, or the plane would lean on nothing.
    enough = (n >= KNOWN_SHARE * disc.sum()) & (determinant > 1e-6 * cxx * cyy)
    present = known.astype(np.uint8)
    for side in (offset[None, :] < 0, offset[None, :] > 0, offset[:, None] < 0, offset[:, None] > 0):
        beside = cv2.dilate(present, kernel * side.astype(np.uint8), borderType=cv2.BORDER_CONSTANT, borderValue=(0,))
        enough &= beside.take(index) > 0

    # Not by adding NaN: that would keep the sign of a NaN that came out of 0 / 0, which is one or the other by chance.
    for values in (slope, roughness, slope_sigma, roughness_sigma):
        values[~enough] = np.nan
    return DiscFit(slope, roughness, slope_sigma, roughness_sigma)


def disc_sums(layer: Array, weights: Float) -> Array:
    """Weighted sum over the window around each cell, zeros outside; each cell exactly from its window alone.

    Args:
        layer: (ny, nx) float32 or float64, the type of the sums.
        weights: (2 r + 1, 2 r + 1).
    """
    side = weights.shape[0]
    if weights.size <= MOST_WEIGHTS:
        return np.asarray(cv2.filter2D(layer, -1, weights, borderType=cv2.BORDER_CONSTANT))
    half = side // 2
    ny, nx = layer.shape
    padded = np.zeros((ny + 2 * half, nx), layer.dtype)
    padded[half : half + ny] = layer
    sums = np.zeros((ny, nx), layer.dtype)
    for row in range(side):
        part = weights[row : row + 1]
        sums += cv2.filter2D(padded[row : row + ny], -1, part, borderType=cv2.BORDER_ISOLATED)
    return sums
