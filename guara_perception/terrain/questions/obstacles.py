"""Connected objects above or below the floor, and a robust fit of the floor."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from guara_perception.arrays import Flags, Float, Index, Mask
from guara_perception.exceptions import optional_library
from guara_perception.terrain.layers.layered_grid import LayeredGrid, asked
from kinematics.arrays import FrozenArrays

# Least height of an object; anything lower is relief of the floor. The paper's lowest object is 10 mm high.
LEAST_HEIGHT_M = 0.006
# Least height of an object in standard deviations of cell and floor.
LEAST_SIGMAS = 4.0
# Least area of an object: 2 x 2 cells on the default grid. Smaller objects are considered noise.
LEAST_AREA_M2 = 1e-4
# Quantile of an object's heights that counts as its highest point, because noise may raise one cell in ten.
TOP_QUANTILE = 0.9
# Cells form the top plane if they are at most this depth plus three sigmas below that quantile.
TOP_DEPTH_M = 0.004
# Number of random triples of cells. If 45 % of the cells are on the floor, at least one of 100 triples is on the floor
# with probability 1 - (1 - 0.45^3)^100.
TRIALS = 100
# Quantile of the distances from the floor that is minimised; small, because boxes may cover more than half of the view.
FLOOR_SHARE = 0.35
# Reciprocal of the FLOOR_SHARE quantile of |noise| in standard deviations. Boxes make the resulting sigma too large, so
# it is refined.
QUANTILE_TO_SIGMA = 1 / 0.4538
# Largest number of cells, evenly distributed, to which a floor is fitted. The rms error of the floor is then about
# 4 % of the noise of these cells.
CELLS = 2000
# Approximate number of these cells that are used to score the trials.
JUDGES = 250
# Heights belong to the floor if they are within three standard deviations of it, or within this distance if it is
# larger.
LEAST_TOLERANCE_M = 0.002
REFINEMENTS = 10
SEED = 2024
# Least rms extent of points across their main direction for which a plane through them is determined.
LEAST_WIDTH_M = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Obstacle(FrozenArrays):
    """Object on the floor, or a hole in it, in base_footprint.

    Attributes:
        outline: (n, 2) corners of the outline [m], along cell edges but diagonal at concave corners, counter-clockwise
            seen from above; the first one is not repeated.
        height: height of the top above the floor, or of the bottom of a hole, which is negative [m].
        top_plane: (a, b, c) of the top (or bottom) z = a x + b y + c [-, -, m].
        position: (3,) centre of the top (or bottom) [m].
        sigma: standard deviation of the height [m].
        hazard: union of the flags of the object's cells.
        area: area covered by the object [m^2].
    """

    outline: Float
    height: float
    top_plane: tuple[float, float, float]
    position: Float
    sigma: float
    hazard: int
    area: float


def obstacles(terrain: LayeredGrid, *, allow_stale: bool = False) -> list[Obstacle]:
    """Find connected objects more than 6 mm and 4 sigma above or below the floor, sorted by x, then y.

    Objects smaller than 1 cm^2 are omitted as noise. The floor is fitted to the known heights: of some 100 trial
    planes, the one with the smallest 35 % quantile of distances is refined by least squares. Unknown ground is not an
    obstacle, but it is never traversable either.

    Raises:
        MissingExtra: OpenCV is not installed.
    """
    terrain = asked(terrain, allow_stale)
    known = np.flatnonzero(np.isfinite(terrain.elevation))
    iy, ix = np.divmod(known, terrain.shape[1])
    x, y = (centres.take(index) for centres, index in zip(terrain.geometry.centres(), (ix, iy), strict=True))
    layers = terrain.elevation, terrain.variance_local
    elevation, variance = (layer.take(known).astype(np.float64) for layer in layers)
    floor = fit_floor(x, y, elevation)
    if floor is None:
        return []
    cells = _Cells(iy, ix, x, y, elevation, variance, elevation - floor.height_at(x, y), terrain.hazard.take(known))
    threshold = np.maximum(LEAST_HEIGHT_M, LEAST_SIGMAS * np.sqrt(variance + floor.sigma**2))
    least = max(int(np.ceil(LEAST_AREA_M2 / terrain.resolution**2 - 1e-9)), 1)
    found = [
        _obstacle(part.some(which), terrain, floor)
        for part in (cells.some(cells.rise > threshold), cells.some(cells.rise < -threshold))
        for which in _connected(part.iy, part.ix)
        if which.size >= least
    ]
    return sorted(found, key=lambda o: (float(o.position[0]), float(o.position[1])))


@dataclass(frozen=True, slots=True)
class _Cells:
    """Cells of a grid as arrays (n,): indices, centres, heights, variances, heights above the floor, flags."""

    iy: Index
    ix: Index
    x: Float
    y: Float
    elevation: Float
    variance: Float
    rise: Float
    hazard: Flags

    def some(self, which: Mask | Index) -> _Cells:
        """Cells selected by a mask, or by indices into the arrays."""
        return _Cells(*(getattr(self, name)[which] for name in self.__slots__))


def _connected(iy: Index, ix: Index) -> list[Index]:
    """Indices (n,) into `iy` and `ix` of each connected component; cells that touch at a corner are connected."""
    if not iy.size:
        return []
    rows, columns = iy - iy.min(), ix - ix.min()
    image = np.zeros((rows.max() + 1, columns.max() + 1), dtype=np.uint8)
    image[rows, columns] = 1
    cv2 = optional_library("cv2", None, "obstacles")
    label = cv2.connectedComponents(image, connectivity=8)[1][rows, columns]
    order = np.argsort(label, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(label[order])) + 1)


def _obstacle(cells: _Cells, terrain: LayeredGrid, floor: FloorPlane) -> Obstacle:
    """Make an obstacle from connected cells, all above or all below the floor."""
    sign = 1.0 if cells.rise[0] > 0 else -1.0
    height = sign * cells.rise
    noise = math.sqrt(float(cells.variance.sum()) / height.size)
    top = np.flatnonzero(height >= np.quantile(height, TOP_QUANTILE) - TOP_DEPTH_M - 3 * noise)
    top_x, top_y, top_z = (values.take(top) for values in (cells.x, cells.y, cells.elevation))
    a, b, c = plane = (fit_plane(top_x, top_y, top_z) if top.size >= 6 else None) or (0.0, 0.0, float(top_z.mean()))
    x, y = float(top_x.sum()) / top.size, float(top_y.sum()) / top.size
    z = a * x + b * y + c
    residual = top_z - (a * top_x + b * top_y + c)
    # Neighbouring cells share noise, so nine of them count as one independent measurement of the top.
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


def _outline(cells: _Cells, terrain: LayeredGrid) -> Float:
    """Outer contour through the corners of the cells, with straight runs as single edges."""
    first = np.array([cells.ix.min(), cells.iy.min()])
    columns, rows = cells.ix - first[0], cells.iy - first[1]
    corners = np.zeros((rows.max() + 2, columns.max() + 2), dtype=np.uint8)
    corners[rows, columns] = 1
    cv2 = optional_library("cv2", None, "obstacles")
    corners = cv2.dilate(corners, np.ones((2, 2), np.uint8), anchor=(1, 1))
    contours, _ = cv2.findContours(corners, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    contour = max(contours, key=cv2.contourArea)
    is_counter_clockwise = cv2.contourArea(contour, oriented=True) > 0
    points = np.asarray(terrain.origin) + (contour[:, 0] + first) * terrain.resolution
    return points if is_counter_clockwise else points[::-1]


@dataclass(frozen=True, slots=True)
class FloorPlane:
    """Plane z = a x + b y + c of the floor in base_footprint.

    Attributes:
        a, b: slopes along x and y.
        c: height at the origin [m].
        sigma: standard deviation of the floor's heights about the plane [m].
    """

    a: float
    b: float
    c: float
    sigma: float

    def height_at(self, x: Float | float, y: Float | float) -> Float:
        """Height of the floor [m]."""
        return np.asarray(self.a * x + self.b * y + self.c)


def fit_floor(x: Float, y: Float, z: Float) -> FloorPlane | None:
    """Fit the floor to points (n,) by least quantile of squares, then by least squares over the inliers.

    The result is deterministic, because the random trials are always the same. None if the points are fewer than three
    or collinear.
    """
    if z.size > CELLS:
        some = np.arange(CELLS) * z.size // CELLS
        x, y, z = x.take(some), y.take(some), z.take(some)
    if z.size < 3:
        return None
    mean_x, mean_y = float(x.mean()), float(y.mean())
    terms = np.stack((x - mean_x, y - mean_y, np.ones(z.size)))
    if solve_plane(terms, z) is None:
        return None
    plane, sigma = _best_trial(terms, z)
    residual = z - plane @ terms
    for _ in range(REFINEMENTS):
        near = np.flatnonzero(np.abs(residual) <= max(3 * sigma, LEAST_TOLERANCE_M))
        refined = solve_plane(terms.take(near, axis=1), z.take(near))
        if refined is None:
            break
        has_settled = bool(np.abs(refined - plane).max() < 1e-9)
        plane = refined
        residual = z - plane @ terms
        on_floor = residual.take(near)
        sigma = float(np.sqrt(on_floor @ on_floor / near.size))
        if has_settled:
            break
    a, b = float(plane[0]), float(plane[1])
    return FloorPlane(a, b, float(plane[2] - a * mean_x - b * mean_y), sigma)


def _best_trial(terms: Float, z: Float) -> tuple[Float, float]:
    """Coefficients (3,) of `terms` (3, n) with the least FLOOR_SHARE quantile of residuals, and an initial sigma."""
    triples = np.random.default_rng(SEED).integers(0, z.size, (TRIALS, 3))
    matrices = terms.T[triples]
    usable = np.abs(np.linalg.det(matrices)) > 1e-9
    trials = np.linalg.solve(matrices[usable], z[triples[usable]][..., None])[..., 0]
    judges = slice(None, None, max(z.size // JUDGES, 1))
    level = np.array([0.0, 0.0, float(np.median(z[judges]))])
    trials = np.vstack((level, trials))
    distances = np.abs(z[judges] - trials @ terms[:, judges])
    rank = int(FLOOR_SHARE * (distances.shape[1] - 1))
    misses = np.partition(distances, rank, axis=1)[:, rank]
    return trials[int(misses.argmin())], QUANTILE_TO_SIGMA * float(misses.min())


def fit_plane(x: Float, y: Float, z: Float) -> tuple[float, float, float] | None:
    """Least-squares plane (a, b, c) through points (n,); None if the points are fewer than three or collinear."""
    if z.size < 3:
        return None
    mean_x, mean_y = float(x.sum()) / z.size, float(y.sum()) / z.size
    terms = np.ones((3, z.size))
    terms[0], terms[1] = x - mean_x, y - mean_y
    solved = solve_plane(terms, z)
    if solved is None:
        return None
    a, b, c = (float(value) for value in solved)
    return a, b, c - a * mean_x - b * mean_y


def solve_plane(terms: Float, z: Float) -> Float | None:
    """Least-squares coefficients (3,) of `terms` (3, n) for z (n,), from the normal equations.

    The rows of `terms` are x, y and ones, with x and y relative to their approximate means for good conditioning.
    None if the points are fewer than three or collinear.
    """
    if len(z) < 3:
        return None
    # Dot products of the rows, because a matrix product of so few rows takes five times as long.
    normal = _products(terms, terms)
    (xx, xy), (_, yy) = normal[:2, :2]
    smallest = 0.5 * (xx + yy - np.hypot(xx - yy, 2 * xy))
    if smallest < len(z) * LEAST_WIDTH_M**2:
        return None
    return np.asarray(np.linalg.solve(normal, _products(terms, z[None])[:, 0]))


def _products(rows: Float, others: Float) -> Float:
    """Scalar products of rows (m, n) and others (k, n); numpy 1.26, the version of ROS 2 Jazzy, has no vecdot."""
    if hasattr(np, "vecdot"):
        return np.asarray(np.vecdot(rows[:, None], others))
    return np.array([[np.dot(row, other) for other in others] for row in rows])
