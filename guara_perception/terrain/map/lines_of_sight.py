"""Upper bounds of unknown ground, derived from the light that passed over it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from guara_perception.arrays import Float, Float32, Index, Mask
from guara_perception.settings import Settings
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.layers.geometry import GridGeometry
from guara_perception.terrain.layers.layers import CEILING_SIGMA_M
from guara_perception.terrain.map.fuse_heights import MapPause
from kinematics import RobotModel
from kinematics.transforms import transform_points

# Largest height of a ray above the soles at which its bound is useful for a swing; rays are not traced higher.
HIGHEST_M = 0.14
# Margin around the scanned area in which ground below rays is bounded too.
BESIDE_CELLS = 20
# Number of neighbouring cells on each side in which a bound must also hold, in the grid of its scan. In the map, it
# must hold in all scan cells that a map cell may touch at the drift since the scan.
AROUND_CELLS = 1
# Largest drift at which a bound is still used.
FARTHEST_DRIFT_CELLS = 10
# Sideways components of rays, as fractions of that of a ray from the mirror. The light may diverge from the mirror,
# from a line lens before it along the beam, or from farther away; a bound must hold in all cases. Rays of
# two successive values that pass over the same cell start at most about 15 mm apart on level ground; bounds must also
# hold in the neighbouring cells, which covers the points between.
SIDEWAYS_SHARES = tuple(number / 7 for number in range(8))
# Value of a cell without a bound [m].
NONE = np.float32(9.0)


@dataclass(frozen=True, slots=True, eq=False)
class LinesOfSight:
    """Bounds (ny, nx) from the lines of sight of one scan, in its footprint [m].

    Every measured point was reached by the laser and seen by the camera. Both rays were free, so the ground below them
    is lower than the rays, and the ground at the point is no higher than the point. A bound never makes ground safe for
    a foot; it lets a swing pass over ground that was never observed, or that gave no return in later scans.

    Bounds are conservative. A ray starts at the highest sample of its cell, and its height in a cell is taken at the
    far edge. The bound of a cell is the highest bound of the cell and all its neighbours. The light may diverge from
    the mirror or from a point before it along the beam; a bound holds in all cases. Objects that no scan can see are
    not bounded: those thinner than the gap between two stripes, and new ones that return no light.

    Attributes:
        bounds: upper bounds of the ground, NONE where there is no bound.
        seen: highest sample of each known cell, NaN elsewhere.
        geometry: geometry of both arrays.
        transform_footprint_to_odom: (4, 4) pose of the scan.
        step, pause, stamp: step, pause and time of the scan in the map.
        rise: variance of z accumulated by the walk up to the scan [m^2].
    """

    bounds: Float32
    seen: Float32
    geometry: GridGeometry
    transform_footprint_to_odom: Float
    step: int
    pause: int
    stamp: int
    rise: float

    @staticmethod
    def of(terrain: TerrainGrid, now: MapPause, robot: RobotModel) -> LinesOfSight | None:
        """Lines of sight of a scan that was fused into the map; None if its record lacks the pose of camera or body."""
        record = terrain.scan_record
        record.check("transform_camera_to_base", "transform_base_to_footprint", "laser_origin")
        camera, to_footprint = record.transform_camera_to_base, record.transform_base_to_footprint
        if camera is None or to_footprint is None:
            return None
        laser = record.laser_origin
        if laser is None:
            laser = transform_points(to_footprint, robot.transform_laser_to_base[:3, 3])
        geometry = terrain.geometry.widened(BESIDE_CELLS)
        return LinesOfSight(
            _bounds(terrain, geometry, [transform_points(to_footprint, camera[:3, 3]), laser]),
            np.pad(terrain.elevation_max, BESIDE_CELLS, constant_values=np.nan),
            geometry,
            now.transform_footprint_to_odom,
            terrain.step,
            now.pause,
            now.stamp,
            now.drift.rise,
        )


def ceiling_of(
    scans: Sequence[LinesOfSight], unknown: Mask, geometry: GridGeometry, now: MapPause, settings: Settings
) -> Float32:
    """Upper bound (ny, nx) of the ground in each unknown cell of the map [m], NaN where there is none.

    Each scan bounds a cell by the highest bound of the scan cells that it may touch, given the horizontal drift since
    the scan, plus the drift in z; both drifts are multiplied by the confidence of the limits. The lowest of these
    bounds counts. A bound expires at the age at which ground becomes STALE. It is not used where the drift exceeds
    FARTHEST_DRIFT_CELLS, or where a later scan measured something higher. A later observation without a return does not
    remove a bound: if it is a hole, the ground is lower still.

    Args:
        scans: lines of sight of the walk, oldest first.
        unknown: (ny, nx) mask of the cells of the map without a height.
        geometry: geometry of the map.
        now: pause of the map.
        settings: limits and validity.
    """
    confidence = settings.limits.confidence
    x, y = (axis.ravel() for axis in np.meshgrid(*geometry.centres()))
    in_odom = transform_points(now.transform_footprint_to_odom, np.column_stack((x, y, np.zeros(x.size))))
    least = np.full(x.size, NONE, np.float32)
    oldest = now.stamp - round(settings.validity_seconds * 1e9)
    for scan in scans:
        if now.pause - scan.pause > settings.validity_pauses or not oldest <= scan.stamp <= now.stamp:
            continue
        pose = scan.transform_footprint_to_odom
        there = (in_odom - pose[:3, 3]) @ pose[:3, :3]
        # Half the extent of a cell of the map along the axes of the scan, in cells.
        half = 0.5 * float(np.abs(pose[:2, 0] @ now.transform_footprint_to_odom[:2, :2]).sum())
        iy, ix = scan.geometry.indices(there[:, 0], there[:, 1])
        inside = np.flatnonzero(scan.geometry.contains(iy, ix))
        pauses = np.full(inside.size, scan.pause)
        aside = now.sideways.variances(pauses, in_odom[inside, 0], in_odom[inside, 1], pose)
        drift = confidence * np.sqrt(aside) / geometry.resolution
        near = (drift <= FARTHEST_DRIFT_CELLS).all(axis=0)
        # A square of this half extent, wherever in a cell its centre lies, touches no cell beyond `around`.
        inside, around = inside[near], np.ceil(drift[:, near] + half - 1e-9).astype(np.intp)
        if not inside.size:
            continue
        at = iy[inside], ix[inside]
        # Heights in the footprint of the scan are converted to the footprint of this pause.
        seen = np.full(x.size, np.nan, np.float32)
        seen[inside] = scan.seen[at] - there[inside, 2]
        with np.errstate(invalid="ignore"):
            broken = (seen > least + confidence * CEILING_SIGMA_M).reshape(geometry.shape)
        if broken.any():
            most = int(around.max())
            least[_worst_around(broken.astype(np.float32), most, most, 0.0).ravel() > 0] = NONE
        bounds = _worst_of_each(scan.bounds, at, around)
        raised = confidence * np.sqrt(max(now.drift.rise - scan.rise, 0.0))
        higher = np.where(bounds < NONE, bounds - there[inside, 2] + raised, NONE).astype(np.float32)
        least[inside] = np.minimum(least[inside], higher)
    return np.where(unknown & (least < NONE).reshape(unknown.shape), least.reshape(unknown.shape), np.float32(np.nan))


def _bounds(terrain: TerrainGrid, geometry: GridGeometry, origins: list[Float]) -> Float32:
    """Lowest bound (ny, nx) from camera rays, laser rays and points, each valid in neighbouring cells too; or NONE."""
    high = np.asarray(terrain.elevation_max, np.float64)
    with np.errstate(invalid="ignore"):
        iy, ix = np.nonzero(np.isfinite(high) & (np.asarray(terrain.variance_local) <= CEILING_SIGMA_M**2))
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
    """Height (ny, nx) of the lowest ray over each cell, at the far edge [m], for rays (n, 3) from points (n, 3)."""
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
        # A ray may begin at any point of its cell, and leave another cell at any point of that cell's edge.
        height = points[on, 2] + (distance + 1.5 * geometry.resolution) * rise[on]
        np.minimum.at(least, cell, height.astype(np.float32))
    return least.reshape(geometry.shape)


def _worst_of_each(bounds: Float32, at: tuple[Index, Index], around: Index) -> Float32:
    """Highest bound (n,) around each cell, within numbers of cells along x and y given by `around` (2, n)."""
    worst = np.empty(around.shape[1], np.float32)
    # Cells with the same two numbers are processed together.
    kind = around[0] * (FARTHEST_DRIFT_CELLS + AROUND_CELLS + 1) + around[1]
    for cells in (np.flatnonzero(kind == value) for value in np.unique(kind)):
        along_x, along_y = around[:, cells[0]].tolist()
        worst[cells] = _worst_around(bounds, along_x, along_y)[at[0][cells], at[1][cells]]
    return worst


def _worst_around(
    bounds: Float32, along_x: int = AROUND_CELLS, along_y: int = AROUND_CELLS, beyond: float = float(NONE)
) -> Float32:
    """Highest bound within a number of cells along x and y; cells outside the border have the value `beyond`."""
    area = np.ones((2 * along_y + 1, 2 * along_x + 1), np.uint8)
    return np.asarray(cv2.dilate(bounds, area, borderType=cv2.BORDER_CONSTANT, borderValue=(beyond,)))
