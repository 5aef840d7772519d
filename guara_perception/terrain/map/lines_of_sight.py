"""Upper bounds of unknown ground by the light that passed over it."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from guara_perception.arrays import Float, Float32, Index
from guara_perception.exceptions import InvalidInput
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.layers.ceiling import Ceiling
from guara_perception.terrain.layers.geometry import GridGeometry
from guara_perception.terrain.layers.record import MapRecord
from guara_perception.terrain.map.terrain_map import TerrainMap
from kinematics.transforms import transform_points

# Height above the soles above which a bound is of no use to a swing.
HIGHEST_M = 0.14
# Margin of the scanned area in which ground below light is bounded too.
BESIDE_CELLS = 20
# A bound of a scan must also hold in all neighbours of its cell; in the map, in one cell more than the drift.
AROUND_CELLS = 1
FARTHEST_DRIFT_CELLS = 10
# Assumed sigma of a bound, from the heights of a scan and the pose of the body; `benchmarks.usable_ground` compares it
# with ground truth. A height with a larger sigma gives no bound.
BOUND_SIGMA_M = 0.003
# The light may diverge from the mirror, from a line lens before it, or from farther away. These are sideways components
# of a ray as fractions of that from the mirror; a bound must hold for all of them. Light of two successive fractions
# over the same cell belongs to points of the ground 15 mm apart, and the neighbours of each point count too.
SIDEWAYS_SHARES = tuple(number / 7 for number in range(8))
NONE = np.float32(9.0)


@dataclass(frozen=True, slots=True, eq=False)
class _Observation:
    """Bounds (ny, nx) of one scan in its footprint [m], NONE where there is no bound, with pose and time of the scan.

    `seen` (ny, nx) is the highest sample of each known cell, NaN elsewhere; `rise` is the variance of z that the walk
    had gained at the scan [m^2].
    """

    bounds: Float32
    seen: Float32
    geometry: GridGeometry
    transform_footprint_to_odom: Float
    step: int
    pause: int
    stamp: int
    rise: float


class LinesOfSight:
    """Upper bounds of unknown ground over a walk, beside a `TerrainMap`.

    Every measured point shows that the laser's light reached it and that the camera saw it: both rays were free, so the
    ground below them is lower, and the ground at the point is no higher. A bound does not make a foothold; it lets a
    swing pass over ground that was never observed, or that gave no return since: `check_path(..., ceiling=...)`.

    Bounds are conservative. A ray starts at the highest sample of its cell and counts at the far edge of each cell that
    it passes. The bound of a cell is the highest of those of the cell and all its neighbours. In the map it is dilated
    by one cell and by the drift since its scan, and raised by that drift, with the confidence of the limits. A bound
    expires when ground of the same age would be STALE, when the map takes its scan back, and where a later scan
    measured something higher. The light may diverge from any point on the mirror or before it: a bound holds for all.
    A later observation without return removes no bound, since a hole is lower. Objects that no scan can see are not
    bounded: those thinner than the gap between two stripes, and new ones that return no light.

    Example:
        fused = terrain_map.update(terrain, odometry.update(stance))
        sight.add(terrain, fused)
        verdict = fused.check_path(points, 0.02, ceiling=sight.ceiling(fused))
    """

    def __init__(self, terrain_map: TerrainMap) -> None:
        """Start with no bound.

        Args:
            terrain_map: map to which each scan is added first.
        """
        self._map = terrain_map
        self._scans: list[_Observation] = []

    def add(self, terrain: TerrainGrid, fused: TerrainGrid) -> None:
        """Add the lines of sight of one scan.

        Args:
            terrain: the scan that was added to the map.
            fused: result of `TerrainMap.update` for it.

        Raises:
            InvalidInput: the scan lacks the poses of camera and body, or `fused` is of another pause.
        """
        if fused.extent != "map" or fused.step != terrain.step:
            raise InvalidInput(
                f"a {fused.extent} of step {fused.step} was given with a scan of step {terrain.step}: "
                "give what TerrainMap.update gave for this scan"
            )
        geometry = terrain.geometry.widened(BESIDE_CELLS)
        transform, validity, _ = _map_of(fused)
        bounds = _bounds(terrain, geometry, _sensor_origins(terrain, self._map))
        seen = np.pad(terrain.elevation_max, BESIDE_CELLS, constant_values=np.nan)
        pause, rise = self._map.pause, self._map.rise_variance
        first = terrain.step - validity
        # Observations of this pause or a later one belong to scans that were taken back.
        self._scans = [scan for scan in self._scans if first <= scan.step and scan.pause < pause]
        self._scans.append(_Observation(bounds, seen, geometry, transform, terrain.step, pause, terrain.stamp, rise))

    def ceiling(self, fused: TerrainGrid) -> Ceiling:
        """Least bound of each cell of a map of the same walk.

        Args:
            fused: result of `TerrainMap.update` or `view`.
        """
        geometry, confidence = fused.geometry, fused.record.required_limits.confidence
        transform, _, seconds = _map_of(fused)
        x, y = (axis.ravel() for axis in np.meshgrid(*geometry.centres()))
        in_odom = transform_points(transform, np.column_stack((x, y, np.zeros(x.size))))
        least = np.full(x.size, NONE, np.float32)
        oldest = fused.stamp - round(seconds * 1e9)
        stands = set(self._map.sideways_drift.pauses.tolist())
        for scan in self._scans:
            if scan.pause not in stands or scan.step > fused.step or not oldest <= scan.stamp <= fused.stamp:
                continue
            pose = scan.transform_footprint_to_odom
            there = (in_odom - pose[:3, 3]) @ pose[:3, :3]
            iy, ix = scan.geometry.indices(there[:, 0], there[:, 1])
            inside = np.flatnonzero(scan.geometry.contains(iy, ix))
            pauses = np.full(inside.size, scan.pause)
            aside = self._map.sideways_drift.variances(pauses, in_odom[inside, 0], in_odom[inside, 1], pose)
            drift = np.ceil(confidence * np.sqrt(aside) / geometry.resolution).astype(np.intp)
            near = (drift <= FARTHEST_DRIFT_CELLS).all(axis=0)
            inside, drift = inside[near], drift[:, near]
            if not inside.size:
                continue
            at = iy[inside], ix[inside]
            # Heights in the footprint of the scan are converted to the present one.
            seen = np.full(x.size, np.nan, np.float32)
            seen[inside] = scan.seen[at] - there[inside, 2]
            with np.errstate(invalid="ignore"):
                broken = (seen > least + confidence * BOUND_SIGMA_M).reshape(geometry.shape)
            if broken.any():
                around = AROUND_CELLS + int(drift.max())
                least[_worst_around(broken.astype(np.float32), around, around, 0.0).ravel() > 0] = NONE
            bounds = _worst_of_each(scan.bounds, at, AROUND_CELLS + drift)
            raised = confidence * np.sqrt(max(self._map.rise_variance - scan.rise, 0.0))
            higher = np.where(bounds < NONE, bounds - there[inside, 2] + raised, NONE).astype(np.float32)
            least[inside] = np.minimum(least[inside], higher)
        height = np.where(least < NONE, least, np.nan).astype(np.float32)
        return Ceiling(height.reshape(geometry.shape), BOUND_SIGMA_M)


def _map_of(fused: TerrainGrid) -> tuple[Float, int, float]:
    """Pose of a map in odom, and its validity in pauses and seconds."""
    record = fused.record
    assert isinstance(record, MapRecord) and record.transform_footprint_to_odom is not None
    assert record.validity_pauses is not None and record.validity_seconds is not None
    return record.transform_footprint_to_odom, record.validity_pauses, record.validity_seconds


def _sensor_origins(terrain: TerrainGrid, terrain_map: TerrainMap) -> list[Float]:
    """Positions of camera and laser in base_footprint."""
    record = terrain.scan_record
    transforms = []
    for name in ("transform_camera_to_base", "transform_base_to_footprint"):
        record.check(name)
        if (transform := getattr(record, name)) is None:
            raise InvalidInput(f"the scan's metadata lacks {name!r}: lines of sight begin at camera and laser")
        transforms.append(transform)
    laser_to_base = terrain_map.robot.transform_laser_to_base
    camera, laser = (transform_points(transforms[1], matrix[:3, 3]) for matrix in (transforms[0], laser_to_base))
    return [camera, laser if record.laser_origin is None else record.laser_origin]


def _bounds(terrain: TerrainGrid, geometry: GridGeometry, origins: list[Float]) -> Float32:
    """Least bound (ny, nx) by camera or laser that also holds over all neighbours; NONE where there is none."""
    high = np.asarray(terrain.elevation_max, np.float64)
    with np.errstate(invalid="ignore"):
        iy, ix = np.nonzero(np.isfinite(high) & (np.asarray(terrain.variance_local) <= BOUND_SIGMA_M**2))
    x, y = terrain.geometry.centres()
    points = np.column_stack((x[ix], y[iy], high[iy, ix]))
    camera, laser = origins
    seen = _worst_around(_passed(points, camera - points, geometry))
    rays = [(laser - points) * (1, share, 1) for share in SIDEWAYS_SHARES]
    lit = np.maximum.reduce([_worst_around(_passed(points, ray, geometry)) for ray in rays])
    own = np.full(terrain.shape, NONE, np.float32)
    own[iy, ix] = high[iy, ix]
    return np.minimum.reduce([seen, lit, _worst_around(np.pad(own, BESIDE_CELLS, constant_values=NONE))])


def _passed(points: Float, ray: Float, geometry: GridGeometry) -> Float32:
    """Height (ny, nx) of the lowest ray over each cell, at its far edge [m]; rays (n, 3) begin at points (n, 3)."""
    least = np.full(geometry.size, NONE, np.float32)
    length = np.maximum(np.hypot(ray[:, 0], ray[:, 1]), 1e-6)
    rise, along = ray[:, 2] / length, ray[:, :2] / length[:, None]
    end = np.where(rise > 0, np.minimum(length, (HIGHEST_M - points[:, 2]) / np.maximum(rise, 1e-6)), 0.0)
    spacing = geometry.resolution / 2
    for distance in spacing * np.arange(1, int(np.ceil(end.max(initial=0.0) / spacing)) + 1):
        on = np.flatnonzero(distance <= end)
        iy, ix = geometry.indices(points[on, 0] + distance * along[on, 0], points[on, 1] + distance * along[on, 1])
        inside = geometry.contains(iy, ix)
        on, cell = on[inside], (iy * geometry.shape[1] + ix)[inside]
        # A ray may begin anywhere in its cell, and leave the cell that it passes anywhere on the edge.
        height = points[on, 2] + (distance + 1.5 * geometry.resolution) * rise[on]
        np.minimum.at(least, cell, height.astype(np.float32))
    return least.reshape(geometry.shape)


def _worst_of_each(bounds: Float32, at: tuple[Index, Index], around: Index) -> Float32:
    """The highest bound (n,) within each cell's own number of cells along x and y, `around` (2, n)."""
    worst = np.empty(around.shape[1], np.float32)
    # Cells with the same two numbers are looked up together.
    kind = around[0] * (FARTHEST_DRIFT_CELLS + AROUND_CELLS + 1) + around[1]
    for cells in (np.flatnonzero(kind == value) for value in np.unique(kind)):
        along_x, along_y = around[:, cells[0]].tolist()
        worst[cells] = _worst_around(bounds, along_x, along_y)[at[0][cells], at[1][cells]]
    return worst


def _worst_around(
    bounds: Float32, along_x: int = AROUND_CELLS, along_y: int = AROUND_CELLS, beyond: float = float(NONE)
) -> Float32:
    """The highest bound within a number of cells along x and y; beyond the border there is none."""
    area = np.ones((2 * along_y + 1, 2 * along_x + 1), np.uint8)
    return np.asarray(cv2.dilate(bounds, area, borderType=cv2.BORDER_CONSTANT, borderValue=(beyond,)))
