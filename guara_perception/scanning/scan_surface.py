"""Layers of the grids of a scan, computed from the points of its stripes and updated stripe by stripe."""

from __future__ import annotations

import functools
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from operator import itemgetter

import numpy as np
import numpy.typing as npt

from guara_perception.arrays import Array, Flags, Float, Index, Mask
from guara_perception.calibration.height_sigma import HeightUncertainty
from guara_perception.exceptions import InvalidInput
from guara_perception.ranging.scan_geometry import TOGETHER, ScanGeometry, in_groups, variance_by_motion
from guara_perception.ranging.stripe_points import ColumnPoints, StripePoints
from guara_perception.ranging.surface import Key, sample_count, shares, surface_of
from guara_perception.settings import Settings
from guara_perception.stripes.band import StripeStatus
from guara_perception.stripes.kernel.library import address, addresses, kernel
from guara_perception.terrain.assessment.assess import DiscTests, assess_layers
from guara_perception.terrain.assessment.causes import LookPlan, unknown_causes
from guara_perception.terrain.assessment.raster import (
    CellSamples,
    Raster,
    cells_of,
    merge,
    pool,
    pool_flags,
    rasterise_swaths,
    runs,
    without_cells,
)
from guara_perception.terrain.layers.geometry import GridGeometry
from guara_perception.terrain.layers.hazard import Hazard
from guara_perception.terrain.layers.record import Run
from kinematics import RobotModel, StancePose
from kinematics.self_filter import SelfFilter

# Upper bound of the raster's cell edge [m]. Coarser grids are pooled from such a raster: cells of their size could
# hide the gap that a lost stripe leaves.
FINEST_CELL_M = 0.005
AREAS = ("footprint", "wide")
# Tolerance for rounding errors [cells].
ROUNDING = 1e-6


class SharedVariance:
    """Height variance shared by neighbouring cells, from the stance pose, camera motion and the calibration.

    Errors of the calibrated planes are shared, because each plane serves a whole stripe and the planes of neighbouring
    stripes are fitted together. Noise of single stripe positions and relief between stripes are not included.
    """

    def __init__(self, geometry: ScanGeometry, pose: Float, motion: Float | None) -> None:
        """Precompute the parts that do not depend on the ground.

        Args:
            geometry: geometry of the scan.
            pose: (6, 6) covariance of the stance pose in base_footprint, as in `StancePose`.
            motion: (6, 6) covariance in `base_link` of camera motion during the scan; None = no motion.

        Raises:
            FileFormatError: the covariance of the calibration does not have the documented form.
        """
        self._geometry, self._pose = geometry, pose[2:5, 2:5]
        self._calibration = HeightUncertainty.of(geometry.calibration)
        self._planes = np.ascontiguousarray(geometry.planes_in_footprint, np.float64)
        self._planes_in_camera = np.array([stripe.plane_in_camera for stripe in geometry.stripes.values()])
        self._motion = np.zeros((3, 3))
        if motion is not None:
            to_base = geometry.calibration.transform_camera_to_base
            turn = geometry.transform_camera_to_footprint[:3, :3] @ to_base[:3, :3].T
            # Components of the motion in base_footprint that change heights: z, and rotations about x and y.
            rows = np.kron(np.eye(2), turn)[2:5]
            self._motion = rows @ motion @ rows.T

    def at(self, points: Float) -> Float:
        """Variances (n,) of the heights of points (3, n) in base_footprint [m^2]."""
        geometry = self._geometry
        transform = geometry.transform_camera_to_footprint
        variance = variance_by_motion(points, np.zeros(3), self._pose)
        variance += variance_by_motion(points, transform[:3, 3], self._motion)
        if self._calibration is not None and points.size:
            points, planes = np.ascontiguousarray(points, np.float64), self._planes
            nearest, distance = np.empty(points.shape[1], np.int64), np.empty(len(planes), np.float32)
            kernel().nearest_planes(
                address(points), nearest.size, address(planes), len(planes), *addresses(distance, nearest)
            )
            variance += self._calibration.variance(
                list(geometry.stripes),
                self._planes_in_camera,
                points,
                transform,
                geometry.calibration.transform_camera_to_base,
                nearest,
            )
        return variance


class SurfaceRaster:
    """Raster of the stripes of a scan, added in any order.

    A swath is the surface on a stripe or between two neighbouring stripes. It is rasterised as soon as no later stripe
    can change it, and otherwise when `raster` is called.

    Attributes:
        counts: number of image columns of all stripes, by `StripeStatus`.
    """

    def __init__(
        self,
        geometry: GridGeometry,
        pattern: range,
        join_height: float,
        parted: Collection[Key] = (),
        hidden: Callable[[Float], Mask] | None = None,
    ) -> None:
        """Start without stripes.

        Args:
            geometry: geometry of the raster.
            pattern: indices of the stripes of the scan's mode.
            join_height: limit of the height difference between neighbouring points of one surface [m].
            parted: pairs of neighbouring stripes between which there is no surface.
            hidden: returns the mask of the points (n, 3) that the robot hides from its own camera or laser. A stripe
                ends there because of the robot, so an unusable return says nothing about the ground. None = no such
                points.
        """
        self._hidden = hidden
        self._parted = frozenset(parted)
        self._geometry = geometry
        self._pattern = pattern
        self._stripes: dict[int, StripePoints] = {}
        self.counts = np.zeros(len(StripeStatus), np.intp)
        self._join_height = join_height
        # Columns and samples by swath.
        self._swaths: dict[Key, tuple[slice, CellSamples]] = {}
        # Swaths to be rasterised because a stripe that they depend on was added, and columns to be merged.
        self._to_make: set[Key] = set()
        self._to_merge = np.zeros(geometry.shape[1], dtype=bool)
        self._raster = merge((), geometry)
        self._too_high, self._marks = np.zeros(geometry.shape, dtype=bool), np.zeros(geometry.shape, np.uint16)
        # Stripes whose unusable returns are in `_marks`.
        self._marked: set[int] = set()

    @property
    def stripes(self) -> dict[int, StripePoints]:
        """Points of the stripes added so far, by ascending index."""
        return dict(sorted(self._stripes.items()))

    def add(self, stripes: Mapping[int, StripePoints]) -> None:
        """Add stripes by index. Adding several in one call is faster and gives the same result."""
        for group in in_groups(list(stripes)):
            self._stripes.update((index, stripes[index]) for index in group)
            status = np.concatenate([stripes[index].status for index in group])
            self.counts += np.bincount(status, minlength=self.counts.size)
            self._to_make.update(key for index in group for key in self._touched(index) if self._is_there(key))
            self._make([key for key in self._to_make if self._is_settled(key)])
            self._mark_out_of_range(group)

    def raster(self) -> Raster:
        """Raster of all stripes added so far; a cell with a return above the height limits is unknown.

        A return below the limits does not make a cell unknown: below a measured surface it is a stray reflection.
        Only the columns of swaths made since the last call are merged again.
        """
        self._make(list(self._to_make))
        for columns in runs(self._to_merge):
            there = [
                swath
                for _, (own, swath) in sorted(self._swaths.items(), key=itemgetter(0))
                if own.start < columns.stop and columns.start < own.stop
            ]
            self._raster = self._raster.with_columns(columns, merge(there, self._geometry, columns))
        self._to_merge.fill(False)
        return without_cells(self._raster, self._too_high)

    def marks(self) -> Flags:
        """Flags (rows, columns) of the cells with unusable returns of all stripes so far; not a copy."""
        new = [stripe for index, stripe in self._stripes.items() if index not in self._marked]
        self._marked.update(self._stripes)
        doubtful = np.concatenate([np.empty((0, 3)), *(stripe.doubtful.points for stripe in new)])
        if self._hidden is not None and len(doubtful):
            doubtful = doubtful[~self._hidden(doubtful)]
        if len(doubtful):
            self._marks.ravel()[cells_of(doubtful, self._geometry)[0]] |= np.uint16(Hazard.AMBIGUOUS)
        return self._marks

    def _touched(self, index: int) -> list[Key]:
        """Keys of the stripes and pairs whose surface depends on a stripe."""
        stride = self._pattern.step
        return [
            *((k, k) for k in (index - stride, index, index + stride)),
            *((k, k + stride) for k in (index - 2 * stride, index - stride, index, index + stride)),
        ]

    def _is_there(self, key: Key) -> bool:
        return key[0] in self._stripes and key[1] in self._stripes

    def _is_settled(self, key: Key) -> bool:
        """Test that no later stripe can change a swath."""
        first, second = key
        around = (first - self._pattern.step, second + self._pattern.step)
        return all(i in self._stripes or i not in self._pattern for i in around)

    def _make(self, keys: list[Key]) -> None:
        """Rasterise swaths from the stripes added so far."""
        cell = self._geometry.resolution
        low = self._geometry.origin[1] - cell
        y_range = (low, low + (self._geometry.shape[0] + 2) * cell)
        for group in in_groups(sorted(keys), 2 * TOGETHER):
            samples = surface_of(self._stripes, group, self._pattern, self._join_height, cell, y_range, self._parted)
            found = rasterise_swaths(samples, len(group), self._geometry)
            for key, swath in zip(group, found, strict=True):
                columns = swath.columns(self._geometry)
                before, _ = self._swaths.get(key, (columns, swath))
                self._to_merge[before] = self._to_merge[columns] = True
                self._swaths[key] = columns, swath
        self._to_make.difference_update(keys)

    def _mark_out_of_range(self, group: list[int]) -> None:
        """Mark the cells of returns beyond the height limits, and the cells between two such returns."""
        beyond = [index for index in group if self._stripes[index].out_of_range.columns.size]
        if not beyond:
            return
        stride, cell = self._pattern.step, self._geometry.resolution
        firsts = {first for index in beyond for first in (index - stride, index)}
        # Ground between two neighbouring returns that are both out of range is out of range too.
        ends = [(first, first + stride) for first in firsts if self._is_there((first, first + stride))]
        lines = [line_samples((self._stripes[i].out_of_range, self._stripes[j].out_of_range), cell) for i, j in ends]
        points = np.concatenate([*(self._stripes[index].out_of_range.points for index in beyond), *lines])
        cells, inside = cells_of(points, self._geometry)
        self._marks.ravel()[cells] |= np.uint16(Hazard.OUT_OF_RANGE)
        self._too_high.ravel()[cells[points[inside, 2] > 0]] = True


class ScanSurface(SurfaceRaster):
    """Ground seen by a scan; `layers` merges only the columns that changed since its last call.

    Attributes:
        grids: geometry of the grid of each of AREAS, by name.
    """

    def __init__(
        self,
        cell: float,
        geometry: ScanGeometry,
        settings: Settings,
        pattern: range,
        body: SelfFilter,
        shared: SharedVariance,
        attitude_sigma: float,
        sway_variance: Callable[[GridGeometry], Float] | None = None,
        parted: Collection[Key] = (),
    ) -> None:
        """Start without stripes.

        Args:
            cell: edge of the cells [m].
            geometry: geometry of the scan.
            settings: settings of the robot.
            pattern: indices of the stripes of the scan's mode.
            body: body of the robot at the stance of the scan, in base_footprint.
            shared: variance that neighbouring heights share.
            attitude_sigma: standard deviation of the vertical, per axis [rad].
            sway_variance: returns the variance (ny, nx) of the heights of a grid due to the body's sway [m^2], which
                averaging over samples does not reduce; None = no sway.
            parted: pairs of neighbouring stripes between which there is no surface.

        Raises:
            InvalidInput: `cell` does not divide the footprint.
        """
        self._order = np.array(list(geometry.stripes), dtype=np.int64)
        # The functions below hold no reference to this surface: a cycle would delay the release of its memory.
        self._shared, self._attitude_sigma = shared, attitude_sigma
        self._limits, self._origins = settings.limits, (origins := geometry.sensor_origins)
        planes, size = geometry.planes_in_footprint, geometry.calibration.camera.size

        def hidden(points: Float) -> Mask:
            return np.logical_or.reduce([body.blocks(origin, points) for origin in origins])

        def area(grid: GridGeometry, rows: slice) -> _Area:
            plan = LookPlan(grid, planes, geometry.pixels, size)
            sway = None if sway_variance is None else sway_variance(grid)
            return _Area(rows, plan, ByHeight(grid.size, np.bool_), ByHeight(grid.size, np.float64), DiscTests(), sway)

        self._in_shadow = hidden
        rows = area_rows(settings, cell)
        self.grids = {name: grid for name, (grid, _) in rows.items()}
        # Computed on demand, because most scans need only one area.
        self._area = functools.cache(lambda name: area(*rows[name]))
        self._pooling = max(int(np.ceil(cell / FINEST_CELL_M - 1e-9)), 1)
        super().__init__(self.grids["wide"].refined(self._pooling), pattern, settings.join_height, parted, hidden)

    @property
    def pairs(self) -> Index:
        """Index (ny, nx) of the first stripe of the pair that encloses each footprint cell on flat ground, else -1."""
        footprint = self.grids["footprint"]
        pairs = self._area("footprint").plan.pairs(np.arange(footprint.size))
        return np.append(self._order, -1)[pairs].reshape(footprint.shape)

    def layers(self, area: str, *, may_sway: bool) -> dict[str, Array]:
        """All layers of an area's grid by name, read-only, from the stripes added so far.

        Args:
            area: one of AREAS.
            may_sway: True to add the variance due to the body's sway.

        Raises:
            InvalidInput: no such area.
        """
        check_area(area)
        own = self._area(area)
        raster = pool(self.raster(), self._pooling).window((own.rows, slice(None)))
        if may_sway and own.sway_variance is not None:
            raster = replace(raster, variance=raster.variance + own.sway_variance)
        marks = pool_flags(self.marks(), self._pooling)[own.rows]
        usable = np.array([index in self._stripes for index in self._order.tolist()])
        pair_usable = usable[:-1] & usable[1:] & (np.diff(self._order) == self._pattern.step)

        def in_own_shadow(cells: Index, points: Float) -> Mask:
            heights = np.full(own.plan.geometry.size, np.nan)
            heights[cells] = points[:, 2]
            return own.shadowed.of(heights, lambda new: self._in_shadow(own.plan.points(new, heights[new])))[cells]

        causes = unknown_causes(own.plan, self._origins, raster.elevation, pair_usable, marks, in_own_shadow)
        return assess_layers(
            raster,
            causes,
            self.grids[area].resolution,
            self._limits,
            shared=self._shared_of(raster.elevation, own),
            slope_sigma=self._attitude_sigma,
            discs=own.discs,
        )

    def _shared_of(self, elevation: Float, area: _Area) -> Float:
        """Variance (ny, nx) that neighbouring cells share [m^2], NaN in unknown cells."""
        heights = elevation.ravel()
        shared = area.shared.of(heights, lambda new: self._shared.at(area.plan.points(new, heights[new]).T))
        return np.where(np.isnan(heights), np.nan, shared).reshape(elevation.shape)

    def lost_cells(self, layers: Mapping[str, Array], is_lost: Mask, area: str) -> tuple[Run, ...]:
        """Unknown cells that lost stripes might have measured; see the function `lost_cells`.

        Args:
            layers: layers of the area.
            is_lost: (s,) mask of the stripes of the pattern that were fired and have no usable frame.
            area: "footprint" or "wide".
        """
        if not is_lost.any():
            return ()
        plan, grid = self._area(area).plan, self.grids[area]
        in_view = plan.in_view(np.arange(grid.size)).reshape(grid.shape)
        elevation = np.asarray(layers["elevation"], np.float64)
        hazard = np.asarray(layers["hazard"], np.uint16)
        return lost_cells(elevation, hazard, in_view, plan.planes_in_footprint, is_lost, grid)


class ByHeight:
    """Values of cells that depend on the height of the cell, computed again only where it has changed."""

    def __init__(self, cells: int, kind: npt.DTypeLike) -> None:
        """Start with no values, for a number of cells and a type of values."""
        self._heights, self._values = np.full(cells, np.nan), np.zeros(cells, kind)

    def of(self, heights: Float, compute: Callable[[Index], Array]) -> Array:
        """Values (cells,) at heights (cells,) [m]; `compute` returns those of some cells.

        The value of a cell with height NaN has no meaning: it may be left from earlier heights.
        """
        new = np.flatnonzero((self._heights != heights) & ~np.isnan(heights))
        if new.size:
            self._heights[new], self._values[new] = heights[new], compute(new)
        return self._values


@dataclass(frozen=True, slots=True)
class _Area:
    """One area of a scan.

    Attributes:
        rows: rows of the widest area's raster that belong to this area.
        plan: stripe pair and visibility of each of its cells.
        shadowed: True where the robot hides the ground from its own camera or laser.
        shared: variance that neighbouring heights share [m^2].
        discs: tests of the discs around its cells.
        sway_variance: (ny, nx) variance due to the body's sway [m^2], or None.
    """

    rows: slice
    plan: LookPlan
    shadowed: ByHeight
    shared: ByHeight
    discs: DiscTests
    sway_variance: Float | None


def area_rows(settings: Settings, cell: float) -> dict[str, tuple[GridGeometry, slice]]:
    """Grid of each of AREAS, and its rows within the widest one.

    The wide area has the x range of the footprint and the y range of the map, in whole cells. Far from the robot, the
    camera sees more than the width of the footprint; the map uses this ground when the robot gets there.

    Args:
        settings: settings of the robot.
        cell: edge of the cells [m].

    Raises:
        InvalidInput: `cell` does not divide the footprint.
    """
    footprint = GridGeometry.over(settings.footprint_x, settings.footprint_y, cell)
    (low, high), (map_low, map_high) = settings.footprint_y, settings.map_y
    right, left = (max(int(np.floor(more / cell + ROUNDING)), 0) for more in (low - map_low, map_high - high))
    ny, nx = footprint.shape
    wide = GridGeometry((footprint.origin[0], footprint.origin[1] - right * cell), cell, (right + ny + left, nx))
    rows = slice(right, right + ny), slice(0, right + ny + left)
    return dict(zip(AREAS, zip((footprint, wide), rows, strict=True), strict=True))


def sway_variance(robot: RobotModel, pose: StancePose) -> Callable[[GridGeometry], Float] | None:
    """Function that returns the variance (ny, nx) of a grid's heights due to the robot's sway [m^2]; None without sway.

    A rotation w about the centre of the feet lifts ground at (x, y) relative to this centre by w_x y - w_y x. The
    amplitude of the sway is used as the sigma of w, so that a height that sway can change by more than the sigma limit
    is UNCERTAIN.
    """
    sway = robot.pause_limits.stance_sway
    middle = pose.soles_in_footprint[:, :2].mean(axis=0)

    def variance(grid: GridGeometry) -> Float:
        x, y = (axis - centre for axis, centre in zip(grid.centres(), middle, strict=True))
        return np.asarray(sway**2 * (x[None, :] ** 2 + y[:, None] ** 2))

    return variance if sway else None


def check_area(area: str) -> None:
    """Reject an area that is not one of AREAS.

    Raises:
        InvalidInput: unknown area.
    """
    if area not in AREAS:
        raise InvalidInput(f"area is {area!r}, allowed: {', '.join(AREAS)}")


def lost_cells(
    elevation: Float,
    hazard: Flags,
    in_view: Mask,
    planes_in_footprint: Float,
    is_lost: Mask,
    geometry: GridGeometry,
) -> tuple[Run, ...]:
    """Unscanned or occluded cells in the camera's view that lie between the neighbours of a lost stripe.

    The ground of a cell may be at any height between the lowest and the highest that this scan measured; z = 0 is
    included.

    Args:
        elevation, hazard: (ny, nx) layers of the scan.
        in_view: (ny, nx) cells that the camera sees if their ground is at z = 0.
        planes_in_footprint: (s, 4) laser planes in the order of the pattern.
        is_lost: (s,) mask of the stripes that were fired and have no usable frame.
        geometry: the grid.

    Returns:
        Runs [ix, first iy, end iy] of cells, end exclusive, in order; they are few, because stripes run along y.
    """
    known = np.isfinite(elevation)
    heights = np.append(elevation[known], 0.0)
    x, y = geometry.centres()
    ground = np.column_stack((np.tile(x, y.size), np.repeat(y, x.size)))

    def side(height: float) -> Mask:
        return np.asarray(
            ground @ planes_in_footprint[:, :2].T + planes_in_footprint[:, 2] * height + planes_in_footprint[:, 3] > 0
        )

    low, high = side(float(heights.min())), side(float(heights.max()))
    lost = np.zeros(geometry.size, dtype=bool)
    last = len(planes_in_footprint) - 1
    for stripe in np.flatnonzero(is_lost).tolist():
        before, after = max(stripe - 1, 0), min(stripe + 1, last)
        # Cells between the two laser planes at the lowest or the highest height, or on different sides of the first
        # plane at the two heights.
        lost |= (low[:, before] != low[:, after]) | (high[:, before] != high[:, after])
        lost |= low[:, before] != high[:, before]
    not_looked_at = (hazard & np.uint16(Hazard.UNSCANNED | Hazard.OCCLUDED)) != 0
    mask = lost.reshape(geometry.shape) & not_looked_at & in_view
    columns = np.flatnonzero(mask.any(axis=0)).tolist()
    return tuple((ix, run.start, run.stop) for ix in columns for run in runs(mask[:, ix]))


def line_samples(ends: tuple[ColumnPoints, ColumnPoints], resolution: float) -> Float:
    """Points (n, 3) along lines between two stripes, one line per image column in which both have a point."""
    _, in_first, in_second = np.intersect1d(ends[0].columns, ends[1].columns, assume_unique=True, return_indices=True)
    if not in_first.size:
        return np.empty((0, 3))
    first = ends[0].points[in_first]
    difference = ends[1].points[in_second] - first
    longest = np.sqrt((difference[:, :2] ** 2).sum(axis=1).max(keepdims=True))
    (n,) = sample_count(longest, resolution)
    return np.asarray((first + shares(n)[..., None] * difference).reshape(-1, 3))
