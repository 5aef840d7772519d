"""Lays a scan onto the map: estimates from what both saw how far odometry is off, with a covariance.

Gauss-Newton on heights. With the scan's points q in odom about the footprint, and the map's height H,

    r = H(R q + d) - (z + dz + rx y - ry x),    minimised: sum w r^2 / s^2 / n + m' P^-1 m

over m = (dx, dy, dz, rx, ry, turn): s^2 is the variance of both heights and of a cell's height on a slope, w Huber's
weight, P the prior covariance of m by odometry. Errors of neighbouring cells are correlated, so the information of the
heights is divided by n.

Heights are smoothed alike in both, and the slope is the mean of both slopes (Malis, Improving vision-based control
using efficient second-order minimization techniques, ICRA 2004). A slope that noise could cause does not show x and y:
where the scan's slope is below SLOPE_SIGMAS of its own error the cell counts as level, and a level cell shows height
and tilt only. The map's slope does not decide, because the map has seams of a millimetre or two where scans end. So on
level ground x, y and heading keep their priors, and also on a slope that is hardly steeper: the map's heights are off
by a millimetre over areas as large as a ramp, which on a ramp of slope 0.05 looks like a shift of 20 mm.

Across its stripes a laser scan has an edge where the first stripe beyond it lies: off by up to their spacing, which
grows with the distance, and always to the same side for the edges that face the robot. Scans laid one onto the other
by such edges would creep. So for a scan of stripes only the slopes along the stripes are used.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from guara_perception.arrays import Float, Mask
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.map.odom_cells import OdomCells

ROUNDS = 8
# Change [m, rad] below which the iteration ends.
SMALLEST_STEP = 1e-5
HUBER_SIGMAS = 2.0
# Least slope that is used, in sigmas that follow from those of single cells: 0.06 with cells of 5 mm and 0.3 mm sigma.
SLOPE_SIGMAS = 6.0
# Heights of neighbouring cells come from the same stripes and poses: this many of them count as one.
CELLS_THAT_COUNT_AS_ONE = 32.0
# Sigma of the difference of two heights that their own sigmas do not contain.
FLOOR_SIGMA_M = 0.0007
# Least sigma of the errors of heights that neighbours do not share.
OWN_SIGMA_M = 0.0003
# Sigma of the sideways position, relative to its cell, of the ground that a height belongs to.
ASIDE_SIGMA_M = 0.004
# Heights that differ by more are those of another object, or of its edge.
LARGEST_DIFFERENCE_M = 0.05
LEAST_CELLS = 50
# An overlap contradicts when this share of it differs by more than Huber's limit, or when it goes this many sigmas
# against the prior; only directions count in which it shrinks the prior's variance by this share.
MOST_CONTRADICTING = 0.3
MOST_SIGMAS = 4.0
LEAST_SHRUNK = 0.01
# Smoothing and slope of a grid per cell: binomial, and central differences of it.
BINOMIAL = np.array([0.25, 0.5, 0.25])
SLOPE = np.array([-0.5, 0.0, 0.5])
# Sigma of a slope, times the cell edge, over that of independent noise in the heights.
SLOPE_NOISE = float(np.linalg.norm(np.convolve(BINOMIAL, SLOPE)) * np.linalg.norm(BINOMIAL))


@dataclass(frozen=True, slots=True)
class Registration:
    """How a scan lies on the map.

    Attributes:
        motion: (6,) x, y, z [m] and rotations about x, y, z [rad] that take the scan onto the map, in odom about the
            footprint, REP-103 order.
        covariance: (6, 6) covariance of the motion.
        cells: number of cells that were compared.
        refused: why the overlap was not used, None where it was; then the motion is zero, the covariance the prior's.
    """

    motion: Float
    covariance: Float
    cells: int
    refused: str | None


def register(cells: OdomCells, terrain: TerrainGrid, transform_footprint_to_odom: Float, prior: Float) -> Registration:
    """Find the small motion that lays a scan's heights onto the map's.

    Args:
        cells: the memory of the map.
        terrain: the scan.
        transform_footprint_to_odom: (4, 4) pose that odometry gives.
        prior: (6, 6) covariance of its error against the map, REP-103 order, positive definite.
    """
    nothing = np.zeros(6)
    base = transform_footprint_to_odom[:3, 3]
    seen = _Seen.of(terrain, transform_footprint_to_odom)
    ground = _Ground.around(cells, seen.about[:, :2] + base[:2])
    information = np.asarray(np.linalg.inv(prior), dtype=np.float64)
    motion = nothing
    for _ in range(ROUNDS):
        step, hessian, weights = _step(ground, seen, base, motion, information)
        if weights.size < LEAST_CELLS:
            return Registration(nothing, prior, weights.size, f"{weights.size} cells of the scan lie on known ground")
        motion = motion + step
        if np.abs(step).max() < SMALLEST_STEP:
            break
    contradicting = float((weights < 1).mean())
    if contradicting > MOST_CONTRADICTING:
        reason = f"{100 * contradicting:.0f} % of {weights.size} cells differ from the map"
        return Registration(nothing, prior, weights.size, reason)
    covariance = np.asarray(np.linalg.inv(hessian))
    sigmas = _surprise(motion, prior, covariance)
    if sigmas > MOST_SIGMAS:
        reason = f"map and odometry contradict each other by {sigmas:.1f} sigma of both"
        return Registration(nothing, prior, weights.size, reason)
    return Registration(motion, covariance, weights.size, None)


def _surprise(motion: Float, prior: Float, covariance: Float) -> float:
    """How far the heights moved the pose from that of odometry, in sigmas of this motion, in the worst direction.

    The covariance of the motion is that by which the heights shrink the prior's; directions in which they do not
    shrink it are left out.
    """
    root = np.linalg.cholesky(prior)
    half = np.linalg.solve(root, covariance)
    left, directions = np.linalg.eigh(np.linalg.solve(root, half.T))
    pulled = (directions.T @ np.linalg.solve(root, motion)) ** 2
    shrunk = 1.0 - left
    seen = shrunk > LEAST_SHRUNK
    return float(np.sqrt(np.max(pulled[seen] / shrunk[seen], initial=0.0)))


def _smooth(heights: Float, resolution: float) -> tuple[Float, Float, Float]:
    """Smoothed heights and their slopes along columns and rows, (ny, nx) each; NaN where a cell they read is."""
    known = np.isfinite(heights).astype(np.uint8)
    filled = np.where(known, heights, 0.0)
    kernels = (BINOMIAL, BINOMIAL), (np.convolve(BINOMIAL, SLOPE) / resolution, BINOMIAL)
    (height, by_x), by_y = (
        (cv2.sepFilter2D(filled, cv2.CV_64F, x, y) for x, y in kernels),
        cv2.sepFilter2D(filled, cv2.CV_64F, kernels[1][1], kernels[1][0]),
    )
    near = cv2.erode(known, np.ones((3, 3), np.uint8), borderType=cv2.BORDER_CONSTANT, borderValue=(0,)) > 0
    wide = cv2.erode(known, np.ones((5, 5), np.uint8), borderType=cv2.BORDER_CONSTANT, borderValue=(0,)) > 0
    return np.where(near, height, np.nan), np.where(wide, by_x, 0.0), np.where(wide, by_y, 0.0)


@dataclass(frozen=True, slots=True)
class _Seen:
    """The scan's points (n, 3) about the footprint along the axes of odom, slopes (n, 2) there, and variances (n,).

    `projection` (2, 2) takes the component of a slope that is used.
    """

    about: Float
    slopes: Float
    variance: Float
    projection: Float

    @staticmethod
    def of(terrain: TerrainGrid, transform: Float) -> _Seen:
        height, by_x, by_y = _smooth(np.asarray(terrain.elevation, np.float64), terrain.resolution)
        known = np.isfinite(height)
        x, y = np.meshgrid(*terrain.geometry.centres())
        about = np.column_stack((x[known], y[known], height[known])) @ transform[:3, :3].T
        slopes = np.column_stack((by_x[known], by_y[known])) @ transform[:2, :2].T
        along = transform[:2, 1]
        projection = np.eye(2) if terrain.scan_record.stripes_planned is None else np.outer(along, along)
        return _Seen(about, slopes, np.asarray(terrain.variance, np.float64)[known], projection)


@dataclass(frozen=True, slots=True)
class _Ground:
    """A part of the map: layers (4, ny, nx) from cell `first` = (cy, cx) on.

    They are smoothed heights, their slopes along x and y, and variances; heights are NaN where they are not to be used.
    """

    layers: Float
    first: tuple[int, int]
    resolution: float

    @staticmethod
    def around(cells: OdomCells, xy: Float) -> _Ground:
        low, high = (xy.min(axis=0), xy.max(axis=0)) if len(xy) else (np.zeros(2), np.zeros(2))
        first = np.floor(low / cells.resolution).astype(int)[::-1] - 6
        shape = np.ceil(high / cells.resolution).astype(int)[::-1] + 6 - first
        at, size = (int(first[0]), int(first[1])), (int(shape[0]), int(shape[1]))
        usable = (cells.patch("looks", at, size, 0) > 0) & ~cells.patch("conflict", at, size, True)
        heights = np.where(usable, cells.patch("height", at, size, np.nan), np.nan)
        variance = cells.patch("variance", at, size, 0.0)
        return _Ground(np.stack((*_smooth(heights, cells.resolution), variance)), at, cells.resolution)

    def at(self, x: Float, y: Float) -> Float:
        """The layers (4, n) at points of odom, bilinear; NaN where the height is not known."""
        u, v = x / self.resolution - 0.5 - self.first[1], y / self.resolution - 0.5 - self.first[0]
        ny, nx = self.layers.shape[1:]
        j, i = np.floor(u).astype(np.intp), np.floor(v).astype(np.intp)
        inside = (i >= 0) & (j >= 0) & (i < ny - 1) & (j < nx - 1)
        i, j = np.clip(i, 0, ny - 2), np.clip(j, 0, nx - 2)
        a, b = u - j, v - i
        flat = self.layers.reshape(len(self.layers), -1)
        lowest = i * nx + j
        low = (1 - a) * flat[:, lowest] + a * flat[:, lowest + 1]
        high = (1 - a) * flat[:, lowest + nx] + a * flat[:, lowest + nx + 1]
        return np.asarray(np.where(inside, (1 - b) * low + b * high, np.nan))


def _step(ground: _Ground, seen: _Seen, base: Float, motion: Float, information: Float) -> tuple[Float, Float, Float]:
    """One step of Gauss-Newton: the change (6,), the Hessian (6, 6) and Huber's weights of the cells compared."""
    cosine, sine = np.cos(motion[5]), np.sin(motion[5])
    px, py, pz = seen.about.T
    x, y = base[0] + cosine * px - sine * py + motion[0], base[1] + sine * px + cosine * py + motion[1]
    z = base[2] + pz + motion[2] + motion[3] * py - motion[4] * px
    height, by_x, by_y, variance = ground.at(x, y)
    difference = height - z
    with np.errstate(invalid="ignore"):
        used: Mask = np.abs(difference) < LARGEST_DIFFERENCE_M
    difference, by_x, by_y, px, py = (v[used] for v in (difference, by_x, by_y, px, py))
    variance = variance[used] + seen.variance[used]
    in_map, in_scan = np.column_stack((by_x, by_y)), seen.slopes[used]
    slope = 0.5 * (in_map + in_scan)
    sigma = np.sqrt(variance + FLOOR_SIGMA_M**2 + (slope**2).sum(axis=1) * ASIDE_SIGMA_M**2)
    noise = SLOPE_NOISE**2 * np.maximum(seen.variance[used], OWN_SIGMA_M**2) / ground.resolution**2
    least = SLOPE_SIGMAS**2 * noise
    level = ((in_scan @ seen.projection) ** 2).sum(axis=1) < least
    slope = slope @ seen.projection
    slope[level] = 0.0
    by_x, by_y = slope.T
    size = np.abs(difference) / sigma
    weights = np.minimum(1.0, HUBER_SIGMAS / np.maximum(size, HUBER_SIGMAS))
    trust = weights / sigma**2 / CELLS_THAT_COUNT_AS_ONE
    one = np.ones(px.size)
    turned_x, turned_y = -(sine * px + cosine * py), cosine * px - sine * py
    jacobian = np.column_stack((by_x, by_y, -one, -py, px, by_x * turned_x + by_y * turned_y))
    hessian = (jacobian * trust[:, None]).T @ jacobian + information
    gradient = (jacobian * trust[:, None]).T @ difference + information @ motion
    return -np.linalg.solve(hessian, gradient), hessian, weights
