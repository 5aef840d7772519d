"""The surroundings of a cell: the plane through its disc, edges under a sole on it, distance to the next edge."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from guara_perception.arrays import Array, Codes, Flags, Float, Index, Mask
from guara_perception.exceptions import InvalidInput
from guara_perception.settings import TraversabilityLimits
from guara_perception.terrain.layers.hazard import ALL_BUT_EDGE, UNKNOWN_MASK

Kernel = Codes
# A value may come from a partly known disc, from this share on; whether the cell is safe is decided elsewhere.
KNOWN_SHARE = 0.6
# From 50 weights on cv2.filter2D goes through a Fourier transform: every cell would depend on every other by rounding.
MOST_WEIGHTS = 49
# Bounds the cells in one row of the disc; a finer grid gains nothing over the stripe pitch anyway.
MOST_RADIUS_CELLS = 24
# A height of a single scan may change when a stripe beside it is lost, so one more ring must be known.
EXTRA_RING_CELLS = 1
# The sole in the fused map is wider by at least this [cells].
LEAST_MARGIN_CELLS = 1
# Largest drift of the fused map that is considered [cells]; more makes no difference.
LARGEST_DRIFT_CELLS = 6


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


def edge_cells(
    flags: Flags, kernel: Kernel, resolution: float, limits: TraversabilityLimits, drift: Index | None = None
) -> Mask:
    """Cells where the sole would cover, or a test would read, something unknown, hazardous or off the grid.

    Every cell under the sole must be free of hazards, and all that its tests read (its disc) be known: then no test
    under the sole depends on anything that is not known. The window is exactly that, corners rounded as the disc is.

    So whatever is unknown, rises or falls is at least a disc's radius away from the sole, and the map may have drifted
    by that much before it comes under the sole. In the map the sole is also widened by one cell, so that nothing unsafe
    comes under its rim while the drift is no larger; where a cell may have drifted by more than the disc's radius, the
    sole is widened by the rest if that is more than one cell. Unknown cells and hazards are kept away alike: what is
    unknown might turn out to be a hazard.

    Args:
        flags: (ny, nx).
        kernel: the disc of the tests.
        resolution: cell edge [m].
        limits: limits of the robot, with the sole's size.
        drift: (ny, nx, 2) number of cells along y and x by which each cell may have drifted, a property of that cell
            alone (the fused map). None: a single scan, where nothing has drifted, but heights may change
            with the stripe beside them and an edge that runs through a cell may show in the next one: all cells that
            the discs touch must be known, and one ring more around them.
    """
    half = [half_cells(length, resolution) for length in (limits.sole_width, limits.sole_length)]
    bad = ((flags & ALL_BUT_EDGE) != 0).astype(np.uint8)
    unknown = ((flags & UNKNOWN_MASK) != 0).astype(np.uint8)

    def reaches(cells: Codes, area: Codes) -> Codes:
        return np.asarray(cv2.dilate(cells, area, borderType=cv2.BORDER_CONSTANT, borderValue=(1,)))

    def under_sole(cells: Codes, beside: tuple[int, ...]) -> Mask:
        area = np.ones([2 * (n + more) + 1 for n, more in zip(half, beside, strict=True)], np.uint8)
        return np.asarray(reaches(cells, area), dtype=bool)

    if drift is None:
        side = 2 * EXTRA_RING_CELLS + 1
        read = reaches(unknown, touched_kernel(limits.disc_radius / resolution))
        return under_sole(bad | reaches(read, np.ones((side, side), np.uint8)), (0, 0))
    read = reaches(unknown, kernel)
    result = np.zeros(flags.shape, dtype=bool)
    beside = np.maximum(drift - kernel.shape[0] // 2, LEAST_MARGIN_CELLS)
    wide = int(beside.max(initial=0)) + 1
    pairs = beside[..., 0] * wide + beside[..., 1]
    for pair in np.flatnonzero(np.bincount(pairs.ravel())).tolist():
        result |= (pairs == pair) & under_sole(bad | read, divmod(pair, wide))
    return result


def beyond_border(kernel: Kernel) -> int:
    """Number of rows and columns beyond the border of the fused map that influence whether a sole on it is safe."""
    return kernel.shape[0] // 2 + _most_beside(kernel)


def _most_beside(kernel: Kernel) -> int:
    """Cells by which a sole in the map is wider on each side at most."""
    return max(LARGEST_DRIFT_CELLS - kernel.shape[0] // 2, LEAST_MARGIN_CELLS)


def widest_window(kernel: Kernel, resolution: float, limits: TraversabilityLimits, *, is_map: bool) -> float:
    """Distance from the centre of a cell to the farthest corner of what `edge_cells` reads around it [m]."""
    half_y, half_x = (half_cells(length, resolution) for length in (limits.sole_width, limits.sole_length))
    iy, ix = np.nonzero(kernel if is_map else touched_kernel(limits.disc_radius / resolution))
    radius = kernel.shape[0] // 2
    more = _most_beside(kernel) if is_map else EXTRA_RING_CELLS
    reach_y, reach_x = np.abs(iy - radius) + more, np.abs(ix - radius) + more
    return float(np.hypot(half_y + reach_y + 0.5, half_x + reach_x + 0.5).max()) * resolution


def clearance(flags: Flags, resolution: float) -> Float:
    """Signed distance to the nearest cell that carries a flag other than EDGE, or to the border [m]; negative inside.

    Distances are from cell centre to the nearer face of the other cell, which explains the half cells.
    """
    ny, nx = flags.shape
    bad = (flags & ALL_BUT_EDGE) != 0
    iy, ix = np.arange(ny)[:, None], np.arange(nx)[None, :]
    to_border = np.minimum(np.minimum(iy, ny - 1 - iy), np.minimum(ix, nx - 1 - ix)) + 0.5
    if not bad.any():
        return np.asarray(to_border * resolution)
    if bad.all():
        return np.asarray(-to_border * resolution)
    to_other = _distance_cells(bad) - 0.5
    return np.where(bad, -to_other, np.minimum(to_other, to_border)) * resolution


def half_cells(length: float, resolution: float) -> int:
    """Cells to each side of the centre cell that a sole of this length touches."""
    return int(np.ceil((length / 2 - resolution / 2) / resolution - 1e-9)) if length > resolution else 0


def _distance_cells(mask: Mask) -> Float:
    """Distance from each cell to the nearest one on the other side of the mask, centre to centre [cells]."""
    within = mask.astype(np.uint8)
    inside, outside = (cv2.distanceTransform(m, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) for m in (within, 1 - within))
    # One of the two is 0. OpenCV's last bit depends on where the memory lies; since the squares are whole numbers,
    # rounding corrects it.
    distance = inside + outside
    return np.sqrt(np.rint(distance * distance), dtype=np.float64)
