"""Rolling elevation map of a walk, kept in `odom` and queried in `base_footprint`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import IO

import numpy as np

from guara_perception.arrays import Float
from guara_perception.exceptions import FileFormatError, InvalidInput, errors_as
from guara_perception.files import whole_file
from guara_perception.ground_picture import GroundPicture
from guara_perception.settings import RobotLike, Settings, robot_model
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.layers.geometry import GridGeometry, cell_edge
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK, cells_by_flag
from guara_perception.terrain.layers.record import POSE, Health, MapRecord
from guara_perception.terrain.map.checked_input import (
    CheckedPose,
    check_scan,
    checked_pose,
    tilt_between_looks,
    tilt_since,
)
from guara_perception.terrain.map.fuse_heights import MapPause, OdometryDrift, dispute_heights
from guara_perception.terrain.map.fuse_scan import fuse_scan
from guara_perception.terrain.map.known_ground import KnownGround, fuse_known_ground
from guara_perception.terrain.map.lines_of_sight import LinesOfSight, ceiling_of
from guara_perception.terrain.map.map_file import MapState, read_map, write_map
from guara_perception.terrain.map.odom_cells import OdomCells
from guara_perception.terrain.map.registration import SQUARE_M, SeenGround
from guara_perception.terrain.map.seen_texture import GroundView, VisualMotion, seen_after, view_of, visual_motion
from guara_perception.terrain.map.snapshot import snapshot_layers
from guara_perception.terrain.map.soft_ground import remembered, slid_feet, sunk_feet
from guara_perception.terrain.map.support_feet import fill_under_foot, sole_error, support_feet
from guara_perception.terrain.map.walk_correction import SIDEWAYS, SidewaysDrift, covariance_in_odom
from kinematics import OdometryPose, PoseInOdom, RobotModel

# The window is recentred when the robot is farther than this from its centre along x or y.
MARGIN_M = 0.2
# Covariance (6, 6) of an almost unknown pose; it is wider than the range in which texture can be found.
ANYWHERE = np.diag([0.1] * 6) ** 2
# Fields of a scan's record that also apply to the map of the same pause.
FROM_SCAN = (*POSE[1:], "pose_covariance")


class TerrainMap:
    """Rolling elevation map of one walk.

    `update` fuses the scan of a pause into cells that are fixed in `odom`, and returns a grid of extent `map`. The
    result is deterministic to the byte. Memory is bounded: cells that leave a square window around the robot are
    forgotten.

    Example:
        terrain_map = TerrainMap(robot)
        odometry = LegOdometry(robot)
        for scan in scans:
            terrain = process_scan(scan, calibration, robot)
            fused = terrain_map.update(terrain, odometry.update(scan.stance))
    """

    def __init__(self, robot: RobotLike, *, resolution: float | None = None) -> None:
        """Create an empty map.

        Args:
            robot: model, name or folder; defines area, limits, validity and kinematics.
            resolution: edge length of a cell [m]; None = the robot's default.

        Raises:
            InvalidInput: the resolution is not positive, does not divide the area, or gives too many cells.
            kinematics.KinematicsError: the robot cannot be loaded.
        """
        self._robot = robot_model(robot)
        self._settings = Settings.of(self._robot)
        x, y = self._settings.map_x, self._settings.map_y
        self._grid = GridGeometry.over(x, y, cell_edge(resolution, self._settings.resolution))
        # Least distance from the centre of the window to its edges.
        reach = float(np.hypot(max(map(abs, x)), max(map(abs, y)))) + MARGIN_M
        self._cells = OdomCells(self._grid.resolution, 2 * (int(np.ceil(reach / self._grid.resolution)) + 1))
        self._state = MapState()
        # Lines of sight that bound unknown heights. They are not saved in files: a loaded map starts without them.
        self._sight: tuple[LinesOfSight, ...] = ()
        self._kept: tuple[OdomCells, MapState, tuple[LinesOfSight, ...]] | None = None

    @property
    def grid(self) -> GridGeometry:
        """Geometry of the grids that `update` returns."""
        return self._grid

    @property
    def robot(self) -> RobotModel:
        """Model of the robot."""
        return self._robot

    @property
    def pause(self) -> int:
        """Number of the newest pause: 1 for the first scan, 0 before it."""
        return self._state.pause

    @property
    def sideways_drift(self) -> SidewaysDrift:
        """Accumulated covariance of the planar drift (x, y, yaw), by pause."""
        return self._state.sideways

    def update(
        self,
        terrain: TerrainGrid,
        pose: PoseInOdom,
        *,
        known_ground: Sequence[KnownGround] = (),
        time: float | None = None,
        picture: GroundPicture | str | None = None,
    ) -> TerrainGrid:
        """Fuse one scan and return the map.

        Args:
            terrain: scan of this pause alone (extent "footprint").
            pose: pose from leg odometry, or a `PoseInOdom` from another odometry. If it has `covariance_since_last`,
                the scan is registered to the map, which corrects planar drift, with `own_covariance` as the noise of
                this pose. Otherwise only the height is corrected. Give `covariance_since_last` at all pauses or at
                none.
            known_ground: ground declared by the gait at this pause, in its base_footprint.
            time: time of the scan on a monotonic clock [s], for the age of cells; None = the grid's stamp. If time
                runs backwards, everything seen before becomes STALE.
            picture: laser-off image of the scan, or the reason why it has none, as in `ScanProcessor.ground_picture`.
                If the pose has `covariance_since_last`, ground texture also corrects planar drift, whose sigma then
                includes slip (`[odometry] slip_share`). None = no image at this pause.

        Returns:
            Grid of extent "map" in base_footprint of this pause. Ground known only from foot contacts or declared by
            the gait has `looks` 0.

        Raises:
            InvalidInput: the grid is of another robot, frame, extent or cell size, is in the compact encoding, or its
                step is not greater than that of the last scan; a field of its record that is needed here is unreadable;
                the pose is not rigid or tilts by more than 0.2 rad; a covariance is not (6, 6), symmetric and positive
                semidefinite; covariance_since_last is given at some pauses only.
            transport.StaleTerrain: the grid is stale; in a map it would count as newly seen.
            kinematics.KinematicsError: the stance of the scan does not fit the robot of the map.
        """
        state, settings = self._state, self._settings
        check_scan(terrain, self._robot.name, self._grid.resolution, state.step)
        checked, tilt = checked_pose(terrain, pose), tilt_between_looks(self._robot, terrain)
        transform, since_last, walk = checked.transform, checked.since_last, state.walk
        walk.check_kind(state.scans, is_registered=since_last is not None, step=terrain.step)
        view: GroundView | str | None = None
        if since_last is not None:
            if picture is not None or state.texture is not None:
                view = view_of(picture or "no laser-off picture was given", terrain)
            walk = walk.after(
                self._cells,
                terrain,
                transform,
                state.anchor.offset,
                since_last,
                checked.noise,
                tilt,
                state.seen,
                self._robot.odometry_limits.slip_share,
                view,
                state.texture,
            )
        transform = walk.pause_transform @ transform
        clock, reasons = _clock(terrain, time), state.reasons
        if state.time is not None and clock < state.time:
            memory = self._cells.memory
            memory["stamp"][np.isfinite(memory["height"])] = clock - round(2e9 * settings.validity_seconds) - 1
            reasons += (
                f"the clock of the scans went back by {(state.time - clock) * 1e-9:.3g} s at step {terrain.step}: "
                "ground seen before counts as stale",
            )
        position, centre = transform[:2, 3].copy(), state.centre
        if centre is None or np.abs(position - centre).max() > MARGIN_M:
            self._cells.centre_on(float(position[0]), float(position[1]))
            centre = position
        transform[2, 3] += state.anchor.offset
        feet = support_feet(self._cells, self._robot, terrain, transform, settings.limits)
        errors = {foot.leg: sole_error(self._cells, foot) for foot in feet}
        measured = {leg: error for leg, error in errors.items() if error is not None}
        odometry_variance = float(checked.covariance[2, 2])
        prior = state.anchor.prior(odometry_variance)
        seen = min((sole.pause for sole in measured.values()), default=0)
        gave_way = sunk_feet(measured, prior, tilt_since(terrain, tilt, max(self._pause_of(terrain) - seen, 1)))
        anchor = state.anchor.after(odometry_variance, {leg: measured[leg] for leg in measured if leg not in gave_way})
        slid = dict[str, float]()
        if isinstance(pose, OdometryPose):
            slid = slid_feet(pose.foot_slips, pose.slipped_feet, {foot.leg: foot.aside for foot in feet})
        soft = remembered(state.soft, [foot.centre for foot in feet if foot.leg in {*gave_way, *slid}])
        correction = anchor.offset - state.anchor.offset
        transform[2, 3] += correction
        shift, turn, growth = walk.shift, walk.turn, walk.growth
        if since_last is None:
            shift, turn = float(np.diag(checked.covariance)[:2].max()), float(checked.covariance[5, 5])
        drift = OdometryDrift(anchor.rise, max(state.drift.shift, shift), max(state.drift.turn, turn))
        if since_last is None:
            shift, turn = drift.shift - state.drift.shift, drift.turn - state.drift.turn
            growth = np.diag([shift, shift, turn])
        pause = self._pause_of(terrain)
        sideways = state.sideways.after(pause, growth, position, walk.own, walk.slip)
        now = MapPause(pause, clock, drift, sideways, transform)
        rejected = fuse_scan(self._cells, terrain, now, tilt)
        for x, y in walk.displaced.tolist():
            dispute_heights(self._cells, (x, y), (x + SQUARE_M, y + SQUARE_M))
        texture = None
        if view is not None and not walk.unseen:
            before = None if walk.is_denied else state.texture
            texture, is_new = seen_after(view, before, transform, held=walk.visual_refused is None)
            if is_new:
                walk = replace(walk, off_texture=walk.noise, off_way=np.zeros(2), begun=walk.slip)
        for foot in feet:
            if foot.leg not in gave_way:
                fill_under_foot(self._cells, replace(foot, centre=foot.centre + (0.0, 0.0, correction)), now)
        # The record also contains earlier patches as long as cells that they filled may be valid.
        oldest = terrain.step - settings.validity_pauses
        ground = [patch for patch in state.ground if patch["cells"] and patch["step"] >= oldest]
        ground += [fuse_known_ground(self._cells, patch, now, terrain.step) for patch in known_ground]
        self._state = MapState(
            centre=centre,
            pause=pause,
            step=terrain.step,
            time=clock,
            drift=drift,
            sideways=now.sideways,
            anchor=anchor,
            walk=walk,
            seen=None if since_last is None else SeenGround.of(terrain),
            texture=texture,
            ground=tuple(ground),
            scans=state.scans + 1,
            reasons=reasons,
            soft=soft,
        )
        lines = LinesOfSight.of(terrain, now, self._robot)
        valid = (each for each in self._sight if pause - each.pause <= settings.validity_pauses)
        self._sight = (*valid, *([] if lines is None else [lines]))
        residuals = {leg: None if error is None else error.residual for leg, error in errors.items()}
        fused = self._snapshot(terrain, now, checked.covariance, rejected, residuals)
        events = [f"the ground gave way under {leg} by {1e3 * depth:.0f} mm: SOFT" for leg, depth in gave_way.items()]
        events += [f"the ground is slippery: {leg} slid by {1e3 * way:.0f} mm: SOFT" for leg, way in slid.items()]
        if not events:
            return fused
        health = Health.of((*(fused.record.health.reasons if fused.record.health else ()), *events))
        return fused.restated(sunk_feet=gave_way, slid_feet=slid, health=health)

    def view(
        self,
        terrain: TerrainGrid,
        pose: PoseInOdom,
        *,
        time: float | None = None,
    ) -> TerrainGrid:
        """Return the map in the base_footprint of another pause without fusing its scan.

        `terrain`, `pose` and `time` are as in `update`, with the same checks, except that the stance is not checked and
        `covariance_since_last` is optional at every pause; without it, the motion since the last fused scan is as
        uncertain as `covariance`. Of `terrain`, only stamp, step and record enter the result.
        """
        state = self._state
        check_scan(terrain, self._robot.name, self._grid.resolution, state.step)
        checked = checked_pose(terrain, pose)
        transform = state.walk.transform @ checked.transform
        transform[2, 3] += state.anchor.offset
        pause = self._pause_of(terrain)
        drift, sideways = self._drifted(checked, transform, pause)
        now = MapPause(pause, _clock(terrain, time), drift, sideways, transform)
        return self._snapshot(terrain, now, checked.covariance, 0, {})

    def _drifted(self, pose: CheckedPose, transform: Float, pause: int) -> tuple[OdometryDrift, SidewaysDrift]:
        """Drift up to a pause whose scan is not fused, so that nothing corrects it."""
        state, walk, growth = self._state, self._state.walk, pose.covariance
        slip = walk.slip
        if walk.last is not None:
            before = walk.transform @ walk.last
            if pose.since_last is not None:
                growth = covariance_in_odom(before, pose.since_last)
            if state.texture is not None:
                slip = slip + self._robot.odometry_limits.slip_share * (transform - before)[:2, 3]
        shift, turn = float(np.linalg.eigvalsh(growth[:2, :2])[-1]), float(growth[5, 5])
        planar = growth[np.ix_(SIDEWAYS, SIDEWAYS)]
        if walk.last is None:
            # Without registration, `covariance` is that of all motions since the start.
            shift, turn = max(shift - state.drift.shift, 0.0), max(turn - state.drift.turn, 0.0)
            planar = np.diag([shift, shift, turn])
        rise = state.anchor.after(float(pose.covariance[2, 2]), {}).rise
        drift = OdometryDrift(rise, state.drift.shift + shift, state.drift.turn + turn)
        return drift, state.sideways.after(pause, planar, transform[:2, 3], np.zeros((3, 3)), slip)

    def save(self, path: str | Path) -> None:
        """Write the whole map to an .npz file; the map returned by `load` continues exactly where this one ends.

        Only the bounds of unknown ground (layer `ceiling`) are not saved. Because the map is fixed in the `odom` of its
        walk, continue with the same odometry.

        Raises:
            MissingFile: the folder does not exist.
            InvalidInput: the path is a folder.
            OSError: the file cannot be written.
        """
        with whole_file(path) as temporary, temporary.open("wb") as stream:
            self.write(stream)

    def write(self, stream: IO[bytes]) -> None:
        """Write the map to a stream in the format of `save`.

        The stream may be a file that already contains other data: `load` ignores data that precede the map.
        """
        write_map(stream, self._robot.name, self._cells, self._state)

    def copy(self) -> TerrainMap:
        """Independent copy, without the state saved by `keep`."""
        copied = TerrainMap(self._robot, resolution=self._grid.resolution)
        copied._cells.restore(self._cells.memory, self._cells.first)
        copied._state, copied._sight = self._state, self._sight
        return copied

    def motion_by_texture(
        self, terrain: TerrainGrid, pose: PoseInOdom, picture: GroundPicture | str | None
    ) -> VisualMotion:
        """Estimate the error of a pause's pose from texture alone, without odometry as a prior; the map is not changed.

        The arguments are those of `update`. Only the pose is checked.
        """
        transform = self._state.walk.transform @ checked_pose(terrain, pose).transform
        transform[2, 3] += self._state.anchor.offset
        view = view_of(picture or "no laser-off picture was given", terrain)
        return visual_motion(view, self._state.texture, transform, ANYWHERE, ANYWHERE[:3, :3], np.zeros((3, 3)))

    @classmethod
    def load(cls, path: str | Path, robot: RobotLike | None = None) -> TerrainMap:
        """Read a map written by `save`.

        Args:
            path: path of the file.
            robot: model, name or folder of the map's robot; None = the robot that the file names.

        Raises:
            MissingFile: no such file.
            FileFormatError: the file is not a map file, is damaged, or belongs to another robot or robot.toml.
            kinematics.KinematicsError: the robot cannot be loaded.
        """
        name, cells, state = read_map(path)
        robot = robot_model(name if robot is None else robot)
        if robot.name != name:
            raise FileFormatError(f"{path}: map of robot {name!r}, but the given model is {robot.name!r}")
        with errors_as(FileFormatError, path, InvalidInput):
            terrain_map = cls(robot, resolution=cells.resolution)
        if terrain_map._cells.side != cells.side:
            raise FileFormatError(
                f"{path}: the map has {cells.side} cells per side, but a map of {robot.name} has "
                f"{terrain_map._cells.side}: it was saved with another robot.toml"
            )
        terrain_map._cells, terrain_map._state = cells, state
        return terrain_map

    def keep(self) -> None:
        """Save the current state in memory for `take_back`."""
        cells = self._kept[0] if self._kept is not None else OdomCells(self._grid.resolution, self._cells.side)
        cells.restore(self._cells.memory, self._cells.first)
        self._kept = cells, self._state, self._sight

    def take_back(self) -> None:
        """Undo all updates since `keep`, bit for bit.

        Raises:
            InvalidInput: `keep` was never called.
        """
        if self._kept is None:
            raise InvalidInput("there is no state to restore: call keep() first")
        cells, self._state, self._sight = self._kept
        self._cells.restore(cells.memory, cells.first)

    def _pause_of(self, terrain: TerrainGrid) -> int:
        """Number of the pause of a scan."""
        return self._state.pause + (1 if self._state.step is None else terrain.step - self._state.step)

    def _snapshot(
        self,
        terrain: TerrainGrid,
        now: MapPause,
        pose_covariance: Float,
        rejected: int,
        residuals: Mapping[str, float | None],
    ) -> TerrainGrid:
        state, scan, settings = self._state, terrain.record, self._settings
        layers = snapshot_layers(self._cells, self._grid, terrain, now, settings, state.soft)
        hazard = np.asarray(layers["hazard"], np.uint16)
        unknown = (hazard & UNKNOWN_MASK) != 0
        layers["ceiling"] = ceiling_of(self._sight, unknown, self._grid, now, settings)
        known = float((~unknown).mean())
        correction, walk = state.walk.pause_transform, state.walk
        reasons = (
            *(scan.health.reasons if scan.health else ()),
            *state.reasons,
            *(
                f"the sole of {leg} is ignored: it is {1e3 * (residuals.get(leg) or 0.0):+.1f} mm above the map"
                for leg in state.anchor.rejected
            ),
        )
        record = MapRecord(
            **{name: getattr(scan, name) for name in FROM_SCAN},
            robot=self._robot.name,
            limits=settings.limits,
            validity_pauses=settings.validity_pauses,
            validity_seconds=settings.validity_seconds,
            transform_footprint_to_odom=now.transform_footprint_to_odom,
            odometry_covariance=pose_covariance,
            scans=state.scans,
            disagreeing_cells=rejected,
            support_residuals=residuals,
            height_correction=state.anchor.offset,
            height_correction_sigma=float(np.sqrt(state.anchor.variance)),
            known_ground=state.ground,
            coverage=known,
            known=known,
            hazard_cells=cells_by_flag(hazard),
            health=Health.of(reasons),
            sideways_correction=(*correction[:2, 3].tolist(), float(np.arctan2(*correction[1::-1, 0]))),
            sideways_correction_sigma=tuple(np.sqrt(np.diag(walk.pause_covariance)).tolist()),
            registration_refused=walk.refused,
            visual_corners=walk.corners,
            visual_refused=walk.visual_refused,
            # Unreadable fields of the scan's record are kept; `registration_refused` is written even if it is null.
            extra={name: scan.extra[name] for name in FROM_SCAN if name in scan.extra} | {"registration_refused": None},
        )
        return TerrainGrid(
            layers=layers, geometry=self._grid, stamp=terrain.stamp, step=terrain.step, extent="map", record=record
        )


def _clock(terrain: TerrainGrid, time: float | None) -> int:
    """Time of a scan [ns]: `time` [s] if given, otherwise its stamp."""
    return terrain.stamp if time is None else round(time * 1e9)
