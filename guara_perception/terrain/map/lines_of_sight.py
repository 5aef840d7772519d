"""`LinesOfSight`: how high unknown ground can be at most, by the light that passed over it."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from guara_perception.arrays import Float, Float32, Index
from guara_perception.exceptions import InvalidInput
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.layers.geometry import GridGeometry
from guara_perception.terrain.layers.layered_grid import Ceiling
from guara_perception.terrain.layers.record import MapRecord
from guara_perception.terrain.map.terrain_map import TerrainMap
from kinematics.transforms import transform_points

# Light that passes higher than this over the soles bounds nothing that a swing needs.
HIGHEST_M = 0.14
# Ground beside the scanned area over which light passed is bounded too, this far out.
BESIDE_CELLS = 20
# In the scan a bound counts where it holds over all neighbours too; in the map, one cell further than it may drift.
AROUND_CELLS = 1
FARTHEST_DRIFT_CELLS = 10
# Assumed sigma of a bound, from the heights of a scan and the pose of the body; `benchmarks.usable_ground` compares it
# with the truth. A height with a larger sigma gives no bound.
BOUND_SIGMA_M = 0.003
# The light may start to widen on the mirror, at a line lens before it, or farther away. Its sideways component, as a
# share of that with a start on the mirror: bounds hold for all of these. From one to the next, light over the same
# cell comes from points of the ground 15 mm apart, and the neighbours of each point count too.
SIDEWAYS_SHARES = tuple(number / 7 for number in range(8))
NONE = np.float32(9.0)


@dataclass(frozen=True, slots=True, eq=False)
class _Look:
    """Bounds (ny, nx) of one scan in its footprint [m], NONE where there is none; and where it was taken, and when.

    `seen` (ny, nx) is the highest sample of each cell that it saw, NaN elsewhere; `rise` is the variance of z that the
    walk had gathered by then [m^2].
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
    """Bounds of unknown ground over a walk, kept beside a `TerrainMap`.

    Every point that a scan saw proves that the laser's light reached it and that the camera saw it: along both rays
    there was nothing, so ground below such a ray is lower than it, and the ground at the point itself is no higher. A
    bound says nothing about whether a foot may be set there; it lets a swing pass over ground that nobody saw, or that
    was seen and gave no return since: `check_path(..., ceiling=...)`.

    Taken to the safe side: from the highest sample of each cell seen, at the far edge of each cell passed; the least
    that holds over a cell and all its neighbours; moved aside and raised by what the map may have drifted since (its
    confidence in sigmas), and one cell more. A bound is forgotten when ground of its age would be STALE, with the
    scan that the map took back, and where a later scan saw something higher. Where the laser's light starts to widen,
    on the mirror or at any distance before it, is left open: a bound holds for all. A later look without return lifts
    no older bound: it may be a hole by now, which is lower. What no scan can see limits it too: a thing thinner than
    the gap between two stripes, or one put there later that returns no light.

    Example:
        fused = terrain_map.update(terrain, odometry.update(stance))
        sight.add(terrain, fused)
        verdict = fused.check_path(points, 0.02, ceiling=sight.ceiling(fused))
    """

    def __init__(self, terrain_map: TerrainMap) -> None:
        """Start with no bound.

        Args:
            terrain_map: takes each scan before it is given here.
        """
        self._map = terrain_map
        self._looks: list[_Look] = []

    def add(self, terrain: TerrainGrid, fused: TerrainGrid) -> None:
        """Take the lines of sight of one scan.

        Args:
            terrain: the scan, as the map took it.
            fused: what `TerrainMap.update` gave for it.

        Raises:
            InvalidInput: the scan does not say where camera and body were, or `fused` is of another pause.
        """
        if fused.extent != "map" or fused.step != terrain.step:
            raise InvalidInput(
                f"a {fused.extent} of step {fused.step} was given with a scan of step {terrain.step}: "
                "give what TerrainMap.update gave for this scan"
            )
        geometry = terrain.geometry.widened(BESIDE_CELLS)
        transform, validity, _ = _map_of(fused)
        bounds = _bounds(terrain, geometry, _sensor_origins(terrain, self._map))
        seen = _laid_out(np.asarray(terrain.elevation_max, np.float32), np.nan)
        pause, rise = self._map.pause, self._map.rise_variance
        first = terrain.step - validity
        # A look of this pause or a later one is of a scan that was taken back.
        self._looks = [look for look in self._looks if first <= look.step and look.pause < pause]
        self._looks.append(_Look(bounds, seen, geometry, transform, terrain.step, pause, terrain.stamp, rise))

    def ceiling(self, fused: TerrainGrid) -> Ceiling:
        """The least bound of each cell of a map of the same walk, as it lies now.

        Args:
            fused: what `TerrainMap.update` or `view` gave.
        """
        geometry, confidence = fused.geometry, fused.record.required_limits.confidence
        transform, _, seconds = _map_of(fused)
        x, y = (axis.ravel() for axis in np.meshgrid(*geometry.centres()))
        in_odom = transform_points(transform, np.column_stack((x, y, np.zeros(x.size))))
        least = np.full(x.size, NONE, np.float32)
        oldest = fused.stamp - round(seconds * 1e9)
        stands = set(self._map.sideways_drift.pauses.tolist())
        for look in self._looks:
            if look.pause not in stands or look.step > fused.step or not oldest <= look.stamp <= fused.stamp:
                continue
            there = (in_odom - look.transform_footprint_to_odom[:3, 3]) @ look.transform_footprint_to_odom[:3, :3]
            iy, ix = look.geometry.indices(there[:, 0], there[:, 1])
            inside = np.flatnonzero(look.geometry.contains(iy, ix))
            aside = self._map.sideways_drift.variances(
                np.full(inside.size, look.pause),
                in_odom[inside, 0],
                in_odom[inside, 1],
                look.transform_footprint_to_odom,
            )
            drift = np.ceil(confidence * np.sqrt(aside) / geometry.resolution).astype(np.intp)
            near = (drift <= FARTHEST_DRIFT_CELLS).all(axis=0)
            inside, drift = inside[near], drift[:, near]
            if not inside.size:
                continue
            at = iy[inside], ix[inside]
            # Heights in the footprint of the look become heights in the present one.
            seen = np.full(x.size, np.nan, np.float32)
            seen[inside] = look.seen[at] - there[inside, 2]
            with np.errstate(invalid="ignore"):
                broken = (seen > least + confidence * BOUND_SIGMA_M).reshape(geometry.shape)
            if broken.any():
                around = AROUND_CELLS + int(drift.max())
                least[_worst_around(broken.astype(np.float32), around, around, 0.0).ravel() > 0] = NONE
            bounds = _worst_of_each(look.bounds, at, AROUND_CELLS + drift)
            raised = confidence * np.sqrt(max(self._map.rise_variance - look.rise, 0.0))
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
    for name in ("transform_camera_to_base", "transform_base_to_footprint"):
        record.check(name)
        if getattr(record, name) is None:
            raise InvalidInput(f"the scan's metadata lacks {name!r}: lines of sight begin at camera and laser")
    assert record.transform_camera_to_base is not None and record.transform_base_to_footprint is not None
    camera, to_footprint = record.transform_camera_to_base[:3, 3], record.transform_base_to_footprint
    camera = transform_points(to_footprint, camera)
    if record.laser_origin is not None:
        return [camera, record.laser_origin]
    laser = terrain_map.robot.transform_laser_to_base[:3, 3]
    return [camera, transform_points(to_footprint, laser)]


def _bounds(terrain: TerrainGrid, geometry: GridGeometry, origins: list[Float]) -> Float32:
    """The least bound (ny, nx) by camera or laser that holds over all neighbours too; NONE where there is none."""
    high = np.asarray(terrain.elevation_max, np.float64)
    with np.errstate(invalid="ignore"):
        iy, ix = np.nonzero(np.isfinite(high) & (np.asarray(terrain.variance) <= BOUND_SIGMA_M**2))
    x, y = terrain.geometry.centres()
    points = np.column_stack((x[ix], y[iy], high[iy, ix]))
    camera, laser = origins
    seen = _worst_around(_passed(points, camera - points, geometry), AROUND_CELLS, AROUND_CELLS)
    to_mirror = laser - points
    lit = [
        _worst_around(_passed(points, to_mirror * (1, share, 1), geometry), AROUND_CELLS, AROUND_CELLS)
        for share in SIDEWAYS_SHARES
    ]
    own = np.full(terrain.shape, NONE, np.float32)
    own[iy, ix] = high[iy, ix]
    return np.minimum.reduce(
        [seen, np.maximum.reduce(lit), _worst_around(_laid_out(own, NONE), AROUND_CELLS, AROUND_CELLS)]
    )


def _laid_out(values: Float32, beside: float | np.float32) -> Float32:
    """Values of a scan's cells on the widened geometry."""
    return np.asarray(np.pad(values, BESIDE_CELLS, constant_values=beside))


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
        # A ray may begin at any point of its cell, and leave the cell that it passes at any point of the edge.
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


def _worst_around(bounds: Float32, along_x: int, along_y: int, beyond: float = float(NONE)) -> Float32:
    """The highest bound within a number of cells along x and y; beyond the border there is none."""
    area = np.ones((2 * along_y + 1, 2 * along_x + 1), np.uint8)
    return np.asarray(cv2.dilate(bounds, area, borderType=cv2.BORDER_CONSTANT, borderValue=(beyond,)))
