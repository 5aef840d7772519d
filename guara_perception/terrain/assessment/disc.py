"""Tests of a cell's neighbourhood: plane fit of its disc, EDGE, clearance."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from guara_perception.arrays import Array, Codes, Flags, Float, Index, Mask
from guara_perception.settings import TraversabilityLimits
from guara_perception.terrain.layers.geometry import (
    EXTRA_RING_CELLS,
    KNOWN_SHARE,
    LEAST_MARGIN_CELLS,
    TOUCHED,
    Kernel,
    disc_kernel,
    half_cells,
)
from guara_perception.terrain.layers.hazard import ALL_BUT_EDGE, UNKNOWN_MASK

# Largest number of weights for which cv2.filter2D uses no Fourier transform, whose rounding would make each cell depend
# on all others.
MOST_WEIGHTS = 49


@dataclass(frozen=True, slots=True)
class DiscFit:
    """Plane fit z = a x + b y + c of the disc around each known cell, in the order of the grid.

    All arrays are (n,) float64, NaN if too little of the disc, or nothing on one side of its centre, is known.

    Attributes:
        slope: angle between the plane and the horizontal [rad].
        roughness: sqrt(sum of squared distances to the plane / (n - 1)) [m].
        slope_sigma: standard deviation of the slope due to the variance of the heights [rad].
        roughness_sigma: standard deviation of the roughness due to the variance of the heights [m].
    """

    slope: Float
    roughness: Float
    slope_sigma: Float
    roughness_sigma: Float


def fit_disc(elevation: Float, variance: Float, kernel: Kernel, resolution: float) -> DiscFit:
    """Fit a plane to the known cells of the disc around each known cell.

    Slope and roughness are defined as in the filters of grid_map, but with least squares instead of principal
    components; on planes, both give the same result. Heights are summed in float64, because in float32 the roughness
    would be lost to cancellation. No mean height of the grid is subtracted, because the result of a cell must depend
    only on its disc, to the last bit.

    Args:
        elevation: (ny, nx) [m], NaN where unknown.
        variance: (ny, nx) [m^2], NaN where unknown.
        kernel: disc from `disc_kernel`.
        resolution: cell edge [m].
    """
    known = np.isfinite(elevation)
    index = np.flatnonzero(known)
    # float32 sums these integers exactly, in half the time.
    mask = known.astype(np.float32)
    height = np.where(known, elevation, 0.0)
    half = kernel.shape[0] // 2
    offset = np.arange(-half, half + 1, dtype=np.float64)
    disc = kernel.astype(np.float64)
    x, y = disc * offset[None, :], disc * offset[:, None]

    def sums(layer: Array, weights: Float) -> Float:
        return disc_sums(layer, weights).take(index).astype(np.float64, copy=False)

    # Computed in place and freed early, because these arrays take most of the memory of an assessment.
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
        # Residuals along z, converted to distances from the plane by the cosine of its slope.
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
    # There must be known cells on all four sides; otherwise the plane would extrapolate.
    enough = (n >= KNOWN_SHARE * disc.sum()) & (determinant > 1e-6 * cxx * cyy)
    present = known.astype(np.uint8)
    for side in (offset[None, :] < 0, offset[None, :] > 0, offset[:, None] < 0, offset[:, None] > 0):
        beside = cv2.dilate(present, kernel * side.astype(np.uint8), borderType=cv2.BORDER_CONSTANT, borderValue=(0,))
        enough &= beside.take(index) > 0

    # Assigned instead of added: adding NaN would keep the sign of a NaN from 0 / 0, which is not deterministic.
    for values in (slope, roughness, slope_sigma, roughness_sigma):
        values[~enough] = np.nan
    return DiscFit(slope, roughness, slope_sigma, roughness_sigma)


def disc_sums(layer: Array, weights: Float) -> Array:
    """Weighted sum over the window around each cell, with zeros outside the grid; it depends on that window only.

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


def edge_cells(
    flags: Flags, kernel: Kernel, resolution: float, limits: TraversabilityLimits, drift: Index | None = None
) -> Mask:
    """Mask of the cells on which a sole would cover a hazard, or depend on something unknown or off the grid.

    Every cell under the sole must be free of hazards and known, and every cell that touches the discs of these cells
    must be known, so that no test under the sole depends on an unknown cell. One more ring of cells must be known,
    because heights may change with a neighbouring stripe, and an edge within a cell may show only in the next cell.

    Unknown cells, rises and falls are therefore at least one disc radius away from the sole, and do not get under it
    while the map drifts by no more than this radius. In the map, the ring is part of a sole that is wider on each side,
    also around hazards. The widening is one cell, so that nothing unsafe reaches the sole's rim, or the excess of the
    drift over the radius if that is more.

    Args:
        flags: (ny, nx) hazard flags.
        kernel: disc of the tests.
        resolution: cell edge [m].
        limits: limits of the robot, including the size of its sole.
        drift: (ny, nx, 2) number of cells along y and x by which each cell of the map may have drifted, independently
            of other cells. None for a single scan, which does not drift.
    """
    half = [half_cells(length, resolution) for length in (limits.sole_width, limits.sole_length)]
    bad = ((flags & ALL_BUT_EDGE) != 0).astype(np.uint8)
    unknown = ((flags & UNKNOWN_MASK) != 0).astype(np.uint8)

    def reaches(cells: Codes, area: Codes) -> Codes:
        return np.asarray(cv2.dilate(cells, area, borderType=cv2.BORDER_CONSTANT, borderValue=(1,)))

    def under_sole(cells: Codes, beside: tuple[int, ...]) -> Mask:
        area = np.ones([2 * (n + more) + 1 for n, more in zip(half, beside, strict=True)], np.uint8)
        return np.asarray(reaches(cells, area), dtype=bool)

    read = reaches(unknown, disc_kernel(limits.disc_radius / resolution, TOUCHED))
    if drift is None:
        side = 2 * EXTRA_RING_CELLS + 1
        return under_sole(bad | reaches(read, np.ones((side, side), np.uint8)), (0, 0))
    result = np.zeros(flags.shape, dtype=bool)
    beside = np.maximum(drift - kernel.shape[0] // 2, LEAST_MARGIN_CELLS)
    wide = int(beside.max(initial=0)) + 1
    pairs = beside[..., 0] * wide + beside[..., 1]
    for pair in np.flatnonzero(np.bincount(pairs.ravel())).tolist():
        result |= (pairs == pair) & under_sole(bad | read, divmod(pair, wide))
    return result


def clearance(flags: Flags, resolution: float) -> Float:
    """Signed distance to the nearest cell with a flag other than EDGE, or to the border [m].

    The distance to another cell is that of the centres minus half a cell. In a cell with such a flag, the distance is
    negative and measured to the nearest cell without one, or to the border if there is none.
    """
    ny, nx = flags.shape
    bad = (flags & ALL_BUT_EDGE) != 0
    iy, ix = np.arange(ny)[:, None], np.arange(nx)[None, :]
    to_border = np.minimum(np.minimum(iy, ny - 1 - iy), np.minimum(ix, nx - 1 - ix)) + 0.5
    if not bad.any():
        return np.asarray(to_border * resolution)
    if bad.all():
        return np.asarray(-to_border * resolution)
    within = bad.astype(np.uint8)
    inside, outside = (cv2.distanceTransform(m, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) for m in (within, 1 - within))
    # In each cell, one of the two is 0. The last bit of OpenCV's result depends on memory alignment; since the squares
    # are integers, rounding removes this dependence.
    distance = inside + outside
    to_other = np.sqrt(np.rint(distance * distance), dtype=np.float64) - 0.5
    return np.where(bad, -to_other, np.minimum(to_other, to_border)) * resolution
