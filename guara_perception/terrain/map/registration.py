"""Registration of a scan to the map or to the previous scan, from the heights of their common cells.

The error of odometry is estimated by Gauss-Newton iteration on heights. Let q = (x, y, z) be the scan's points and H
the height of the map, both relative to the footprint and along the axes of odom. The cost

    sum w r^2 / s^2 / n + m' P^-1 m    with    r = H(R q + d) - (z + dz + rx y - ry x)

is minimised over m = (dx, dy, dz, rx, ry, turn). R is the rotation by `turn`, d = (dx, dy), w the Huber weight, and P
the prior covariance of m from odometry. s^2 is the variance of r: the variances of both heights, FLOOR_SIGMA_M^2, and
the effect of a horizontal position error on a slope. Errors of neighbouring cells are correlated, so the information of
the heights is divided by n.

Both height fields are smoothed in the same way, and the slope is the mean of both slopes (Malis, Improving vision-based
control using efficient second-order minimization techniques, ICRA 2004). A slope that may be noise must not be used for
x, y and yaw: a cell whose slope in the scan is below SLOPE_SIGMAS times its sigma counts as level, and a level cell
observes only height and tilt. The slope of the map is not used for this decision, because the map has seams of a
millimetre or two at the ends of scans. On level ground and gentle slopes, x, y and yaw therefore keep their priors.
Slopes this small cannot be used: the map's heights are off by a millimetre over areas as large as a ramp, which is
equivalent to a shift of 20 mm on a ramp of slope 0.05.

Across its stripes, a laser scan shows an edge at the first stripe behind the true edge. This error is up to the spacing
of the stripes, which grows with the distance, and has the same sign for all edges that face the robot. Registration to
such edges would drift, so for a scan of stripes only slopes along the stripes are used.

Parts of the ground may have moved since they were seen. The area of the scan is divided into squares, and the heights
of each square alone give its displacement relative to the fitted motion. Squares displaced by more than a gate are
omitted, and the fit is repeated; the gate narrows from half of the largest displacement to MOST_DISPLACED_SIGMAS, so
that the fit converges to the motion of the majority. Without a clear majority, nothing is corrected.

The motion between two scans is estimated in the same way, with a prior so wide that the heights alone determine x, y
and yaw.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial

import cv2
import numpy as np

from guara_perception.arrays import Float, Float32, Index, Mask
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.map.odom_cells import OdomCells
from kinematics.arrays import FrozenArrays

ROUNDS = 8
# Step below which the iteration ends [m, rad].
SMALLEST_STEP = 1e-5
HUBER_SIGMAS = 2.0
# Least slope that is used, in sigmas of a slope: 0.09 with cells of 5 mm and a height sigma of 0.3 mm.
SLOPE_SIGMAS = 6.0
# Number n of neighbouring cells that count as one, because their heights come from the same stripes and poses.
CELLS_THAT_COUNT_AS_ONE = 32.0
# Same number for two scans, which have no pose in common; chi-square per degree of freedom of walks over still ground
# is then 0.2 to 0.7.
CELLS_OF_TWO_SCANS = 8.0
# Prior sigma of x, y [m] and yaw [rad] between two scans, wide enough for the heights alone to decide.
OPEN_SIGMA = 0.05
# Additional sigma of the difference of two heights.
FLOOR_SIGMA_M = 0.0007
# Lower bound of the sigma of independent errors of heights.
OWN_SIGMA_M = 0.0003
# Horizontal sigma of the position of a height relative to its cell.
ASIDE_SIGMA_M = 0.004
# Largest height difference between scan and map in a cell that is used; with a larger one, the scan shows another
# object or the edge of an object.
LARGEST_DIFFERENCE_M = 0.05
LEAST_CELLS = 50
# Rows of x, y and yaw in REP-103 order.
PLANAR = [0, 1, 5]
# A registration is refused if it compares fewer than LEAST_CELLS cells, if the residuals of more than the fraction
# MOST_CONTRADICTING of them exceed Huber's limit, or if its motion is more than MOST_SIGMAS from the prior in a
# direction in which it reduces the prior's variance by more than the fraction LEAST_SHRUNK.
MOST_CONTRADICTING = 0.3
MOST_SIGMAS = 4.0
LEAST_SHRUNK = 0.01
# Edge of the squares whose displacements are compared [m].
SQUARE_M = 0.1
# Sigmas of errors of the heights that a whole square has in common: height and displacement [m], and tilt [rad].
SEAMS_SIGMA_M, SEAMS_SIGMA_RAD = 0.0015, 0.02
# A displacement is compared in directions in which its sigma is below SURE_SIGMA_M. On walks over still ground, the
# largest of a scan deviates by less than 1.9 sigmas, on periodic ribs once by 2.8.
SURE_SIGMA_M, MOST_DISPLACED_SIGMAS = 0.005, 3.0
# Smallest fraction of the information about displacements in squares that were not displaced.
LEAST_MAJORITY = 0.65
# Kernels of smoothing (binomial) and slope (central differences).
BINOMIAL = np.array([0.25, 0.5, 0.25])
SLOPE = np.array([-0.5, 0.0, 0.5])
# Sigma of a slope times the cell edge, divided by the sigma of independent noise in the heights.
SLOPE_NOISE = float(np.linalg.norm(np.convolve(BINOMIAL, SLOPE)) * np.linalg.norm(BINOMIAL))


@dataclass(frozen=True, slots=True)
class Registration:
    """Result of a registration.

    Attributes:
        motion: (6,) x, y, z [m] and rotations about x, y, z [rad] from the scan to the map, along the axes of odom and
            about the footprint, in REP-103 order.
        covariance: (6, 6) covariance of the motion.
        cells: number of compared cells.
        refused: reason why the registration was refused, None if it was not. If it was refused, the motion is zero and
            the covariance is the prior.
        displaced: (n, 2) smallest x, y in odom of the squares, SQUARE_M wide, whose ground moved [m].
    """

    motion: Float
    covariance: Float
    cells: int
    refused: str | None
    displaced: Float = field(default_factory=partial(np.empty, (0, 2)))


def register(cells: OdomCells, terrain: TerrainGrid, transform_footprint_to_odom: Float, prior: Float) -> Registration:
    """Estimate the small motion that registers the heights of a scan to the map.

    Args:
        cells: memory of the map.
        terrain: grid of the scan.
        transform_footprint_to_odom: (4, 4) pose from odometry, with the corrections so far.
        prior: (6, 6) positive definite covariance of the pose error relative to the map, in REP-103 order.
    """
    base = transform_footprint_to_odom[:3, 3]
    seen = _Scan.of(terrain, transform_footprint_to_odom)
    ground = _Ground.around(cells, seen.about[:, :2] + base[:2])
    corners, squares = np.unique(np.floor(seen.about[:, :2] / SQUARE_M), axis=0, return_inverse=True)
    squares = squares.reshape(-1)
    held, gate = np.ones(len(seen.about), dtype=bool), np.inf
    for _ in range(2 * ROUNDS):
        motion, covariance, weights = _fit(ground, seen, base, prior, CELLS_THAT_COUNT_AS_ONE, held)
        if weights.size < LEAST_CELLS:
            reason = f"{weights.size} cells are on known ground of the map, {LEAST_CELLS} are needed"
            return Registration(np.zeros(6), prior, weights.size, reason)
        sigmas, information = _displacements(ground, seen, base, motion, squares)
        gate = max(MOST_DISPLACED_SIGMAS, 0.5 * min(gate, float(sigmas.max())))
        before, held = held, (sigmas <= gate)[squares]
        if gate == MOST_DISPLACED_SIGMAS and np.array_equal(held, before):
            break
    displaced = base[:2] + SQUARE_M * corners[sigmas > gate]
    majority = float(information[sigmas <= gate].sum() / max(information.sum(), 1e-30))
    contradicting, deviation = float((weights < 1).mean()), _surprise(motion, prior, covariance)
    if len(displaced) and majority < LEAST_MAJORITY:
        reason = f"parts of the ground moved, and only {100 * majority:.0f} % of the evidence agrees on a motion"
    elif contradicting > MOST_CONTRADICTING:
        reason = f"{100 * contradicting:.0f} % of {weights.size} cells differ from the map"
    elif deviation > MOST_SIGMAS:
        reason = f"map and odometry contradict each other by {deviation:.1f} combined sigma"
    else:
        return Registration(motion, covariance, weights.size, None, displaced)
    return Registration(np.zeros(6), prior, weights.size, reason, displaced)


def _displacements(ground: _Ground, seen: _Scan, base: Float, motion: Float, squares: Index) -> tuple[Float, Float]:
    """Displacements of the squares relative to a motion, in sigmas, and the information about each [1/m^2]; (k,)."""
    lines = _linearised(ground, seen, base, motion, CELLS_OF_TWO_SCANS)
    count = int(squares.max()) + 1
    sigmas, information = np.zeros(count), np.zeros(count)
    order = np.argsort(squares[lines.used], kind="stable")
    ends = np.searchsorted(squares[lines.used][order], np.arange(count + 1))
    free = np.diag([1 / OPEN_SIGMA**2] * 2 + [1 / SEAMS_SIGMA_M**2] + [1 / SEAMS_SIGMA_RAD**2] * 2)
    for square in range(count):
        rows = order[ends[square] : ends[square + 1]]
        if rows.size < LEAST_CELLS:
            continue
        jacobian = lines.jacobian[rows, :5]
        # Tilt is about the centre of the square.
        jacobian[:, 3:] -= jacobian[:, 3:].mean(axis=0)
        weighted = jacobian.T * lines.trust[rows]
        covariance = np.linalg.inv(weighted @ jacobian + free)
        shift = covariance @ (weighted @ lines.difference[rows])
        variances, directions = np.linalg.eigh(covariance[:2, :2] + SEAMS_SIGMA_M**2 * np.eye(2))
        sure = variances < SURE_SIGMA_M**2
        sigmas[square] = np.sqrt(((directions.T @ shift[:2]) ** 2 / variances)[sure].max(initial=0.0))
        information[square] = (1 / variances)[sure].sum()
    return sigmas, information


@dataclass(frozen=True, slots=True, eq=False)
class SeenGround(FrozenArrays):
    """Ground measured by the last scan, in its footprint.

    Attributes:
        layers: (2, ny, nx) float32 elevation [m] and local variance [m^2], NaN where unknown.
        origin: (2,) corner with the smallest x and y [m].
    """

    layers: Float32
    origin: Float

    @staticmethod
    def of(terrain: TerrainGrid) -> SeenGround:
        """Ground of a scan."""
        return SeenGround(np.stack((terrain.elevation, terrain.variance_local)), np.array(terrain.geometry.origin))


def motion_between(
    before: SeenGround, terrain: TerrainGrid, transform_to_last: Float, prior: Float
) -> tuple[Float, Float]:
    """Estimate the motion between the previous scan and this one, minus the motion from odometry.

    Args:
        before: ground of the previous scan.
        terrain: grid of this scan.
        transform_to_last: (4, 4) transform from this footprint to that of the previous scan, from odometry.
        prior: (6, 6) covariance of height and tilt between the scans; its x, y and yaw are not used.

    Returns:
        x, y [m] and yaw [rad] (3,) about this footprint, along the axes of the previous one, and covariance (3, 3).
        Zero and the wide prior if too few cells are common to both scans.
    """
    prior = prior.copy()
    prior[PLANAR] = prior[:, PLANAR] = 0.0
    prior[PLANAR, PLANAR] = OPEN_SIGMA**2
    elevation, variance = before.layers.astype(np.float64)
    resolution = terrain.resolution
    first = (float(before.origin[1]) / resolution, float(before.origin[0]) / resolution)
    ground = _Ground(np.stack((*_smooth(elevation, resolution), variance)), first, resolution)
    seen = _Scan.of(terrain, transform_to_last)
    motion, covariance, weights = _fit(ground, seen, transform_to_last[:3, 3], prior, CELLS_OF_TWO_SCANS)
    if weights.size < LEAST_CELLS:
        motion, covariance = np.zeros(6), prior
    return motion[PLANAR], covariance[np.ix_(PLANAR, PLANAR)]


def _fit(
    ground: _Ground, seen: _Scan, base: Float, prior: Float, count_as_one: float, held: Mask | None = None
) -> tuple[Float, Float, Float]:
    """Motion (6,), its covariance (6, 6), and Huber weights of the compared cells, from points in the mask `held`."""
    information = np.asarray(np.linalg.inv(prior), dtype=np.float64)
    motion = np.zeros(6)
    seen = seen if held is None or held.all() else seen.part(held)
    for _ in range(ROUNDS):
        lines = _linearised(ground, seen, base, motion, count_as_one)
        weighted, weights = lines.jacobian.T * lines.trust, lines.weights
        hessian = weighted @ lines.jacobian + information
        if weights.size < LEAST_CELLS:
            break
        step = np.linalg.solve(hessian, weighted @ lines.difference - information @ motion)
        motion = motion + step
        if np.abs(step).max() < SMALLEST_STEP:
            break
    return motion, np.asarray(np.linalg.inv(hessian)), weights


def _surprise(motion: Float, prior: Float, covariance: Float) -> float:
    """Deviation of a motion from its prior in sigmas, in the worst direction.

    `prior` and `covariance` are the covariances (6, 6) of the motion before and after the registration. If prior and
    heights are consistent, the estimated motion is distributed with covariance `prior - covariance`. Directions in
    which this reduction is negligible are omitted.
    """
    root = np.linalg.cholesky(prior)
    half = np.linalg.solve(root, covariance)
    ratios, directions = np.linalg.eigh(np.linalg.solve(root, half.T))
    innovation = (directions.T @ np.linalg.solve(root, motion)) ** 2
    reduction = 1.0 - ratios
    observed = reduction > LEAST_SHRUNK
    return float(np.sqrt(np.max(innovation[observed] / reduction[observed], initial=0.0)))


def _smooth(heights: Float, resolution: float) -> tuple[Float, Float, Float]:
    """Smoothed heights and their slopes along x and y, (ny, nx) each.

    Close to unknown cells and to the border, heights are NaN and slopes 0.
    """
    known = np.isfinite(heights).astype(np.uint8)
    filled = np.where(known, heights, 0.0)
    slope = np.convolve(BINOMIAL, SLOPE) / resolution
    kernels = (BINOMIAL, BINOMIAL), (slope, BINOMIAL), (BINOMIAL, slope)
    height, by_x, by_y = (cv2.sepFilter2D(filled, cv2.CV_64F, x, y) for x, y in kernels)
    near, wide = (
        cv2.erode(known, np.ones((n, n), np.uint8), borderType=cv2.BORDER_CONSTANT, borderValue=(0,)) > 0
        for n in (3, 5)
    )
    return np.where(near, height, np.nan), np.where(wide, by_x, 0.0), np.where(wide, by_y, 0.0)


@dataclass(frozen=True, slots=True)
class _Scan:
    """Known points of a scan, along the axes of odom or of the previous footprint.

    Attributes:
        about: (n, 3) points relative to the footprint [m].
        slopes: (n, 2) slopes of the ground along x and y.
        variance: (n,) local variances of the heights [m^2].
        projection: (2, 2) projection to the component of a slope that is used.
    """

    about: Float
    slopes: Float
    variance: Float
    projection: Float

    def part(self, held: Mask) -> _Scan:
        """Points of a mask (n,)."""
        return _Scan(self.about[held], self.slopes[held], self.variance[held], self.projection)

    @staticmethod
    def of(terrain: TerrainGrid, transform: Float) -> _Scan:
        height, by_x, by_y = _smooth(np.asarray(terrain.elevation, np.float64), terrain.resolution)
        known = np.isfinite(height)
        x, y = np.meshgrid(*terrain.geometry.centres())
        about = np.column_stack((x[known], y[known], height[known])) @ transform[:3, :3].T
        slopes = np.column_stack((by_x[known], by_y[known])) @ transform[:2, :2].T
        along = transform[:2, 1]
        projection = np.eye(2) if terrain.scan_record.stripes_planned is None else np.outer(along, along)
        return _Scan(about, slopes, np.asarray(terrain.variance_local, np.float64)[known], projection)


@dataclass(frozen=True, slots=True)
class _Ground:
    """Part of the map, or the previous scan.

    Attributes:
        layers: (4, ny, nx) smoothed heights, NaN where unusable, slopes along x and y, and variances.
        first: position (y, x) of the corner of cell `layers[:, 0, 0]` [cells].
        resolution: cell edge [m].
    """

    layers: Float
    first: tuple[float, float]
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
        """Layers (4, n) interpolated bilinearly at points [m]; NaN outside the grid, the height also where unknown."""
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


@dataclass(frozen=True, slots=True)
class _Lines:
    """Heights of n compared cells, linearised about a motion.

    Attributes:
        used: indices of the points of the scan.
        jacobian: (n, 6) derivative of the prediction of `difference` by the motion.
        difference: (n,) height of the map minus that of the scan [m].
        weights: (n,) Huber's weights.
        trust: (n,) weight of the square of each difference [1/m^2].
    """

    used: Index
    jacobian: Float
    difference: Float
    weights: Float
    trust: Float


def _linearised(ground: _Ground, seen: _Scan, base: Float, motion: Float, count_as_one: float) -> _Lines:
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
    trust = weights / sigma**2 / count_as_one
    one = np.ones(px.size)
    turned_x, turned_y = -(sine * px + cosine * py), cosine * px - sine * py
    jacobian = -np.column_stack((by_x, by_y, -one, -py, px, by_x * turned_x + by_y * turned_y))
    return _Lines(np.flatnonzero(used), jacobian, difference, weights, trust)
