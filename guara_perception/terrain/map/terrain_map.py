"""`TerrainMap`: what the scans of a walk saw, joined; it lives in `odom` and answers in base_footprint."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from guara_perception.arrays import Float
from guara_perception.exceptions import FileFormatError, InvalidInput
from guara_perception.settings import RobotLike, Settings, robot_model
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.layers.geometry import GridGeometry
from guara_perception.terrain.map.fuse_heights import OdometryDrift
from guara_perception.terrain.map.known_ground import (
    KnownGround,
    check_scan,
    checked_pose,
    fuse_known_ground,
    fuse_scan,
)
from guara_perception.terrain.map.map_file import read_map, write_map
from guara_perception.terrain.map.odom_cells import OdomCells
from guara_perception.terrain.map.snapshot import MapPause, map_record, snapshot_layers
from guara_perception.terrain.map.support_feet import HeightAnchor, fill_under_foot, sole_error, support_feet
from guara_perception.terrain.map.walk_correction import SidewaysDrift, WalkCorrection
from kinematics import PoseInOdom, RobotModel

# The window is moved when the robot has gone this far: seldom, and still little memory.
MARGIN_M = 0.2
# Attributes of a map besides its cells.
STATE = (
    "_centre",
    "_pause",
    "_step",
    "_time",
    "_drift",
    "_sideways",
    "_anchor",
    "_walk",
    "_ground",
    "_scans",
    "_reasons",
)


class TerrainMap:
    """The rolling map of one walk.

    Each pause's scan is fused into cells that stand still in `odom`; a snapshot of the `map` extent comes back. Same
    input, same bytes. Memory does not grow: what lies further off than the map reaches (plus a margin) is forgotten.

    Example:
        terrain_map = TerrainMap(robot)
        odometry = LegOdometry(robot)
        for scan in scans:
            terrain = process_scan(scan, calibration, robot)
            fused = terrain_map.update(terrain, odometry.update(scan.stance))
    """

    def __init__(self, robot: RobotLike, *, resolution: float | None = None) -> None:
        """Start with nothing known.

        Args:
            robot: model, name or folder; its robot.toml gives area, limits and validity; its kinematics the soles.
            resolution: cell edge [m]; None = the robot's default.

        Raises:
            InvalidInput: the resolution does not divide the area.
        """
        self._robot = robot_model(robot)
        self._settings = Settings.of(self._robot)
        x, y = self._settings.map_x, self._settings.map_y
        self._grid = GridGeometry.over(x, y, self._settings.resolution if resolution is None else float(resolution))
        self._reach = float(np.hypot(max(map(abs, x)), max(map(abs, y)))) + MARGIN_M
        self._cells = OdomCells(self._grid.resolution, self._reach)
        self._centre: Float | None = None
        self._pause = 0
        self._step: int | None = None
        self._drift = OdometryDrift(0.0, 0.0, 0.0)
        self._sideways = SidewaysDrift.none()
        self._anchor = HeightAnchor()
        self._walk = WalkCorrection.none()
        self._ground: list[dict[str, Any]] = []
        self._scans = 0
        self._time: int | None = None
        self._reasons: list[str] = []
        self._kept: tuple[OdomCells, dict[str, Any]] | None = None

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
        """Number of the newest pause, counted from the first scan."""
        return self._pause

    @property
    def sideways_drift(self) -> SidewaysDrift:
        """How far cells may have drifted sideways."""
        return self._sideways

    @property
    def rise_variance(self) -> float:
        """Variance of z that cells gain while not seen, summed since the start [m^2]."""
        return self._drift.rise

    def update(
        self,
        terrain: TerrainGrid,
        pose: PoseInOdom,
        *,
        known_ground: Sequence[KnownGround] = (),
        time: float | None = None,
    ) -> TerrainGrid:
        """Fuse one scan and give the map as it is known now.

        Args:
            terrain: this pause's scan alone (extent "footprint").
            pose: where leg odometry found the body, or a `PoseInOdom` of another odometry. With its
                `covariance_since_last` the scan is laid onto the map first, which corrects sideways drift where the
                ground shows it, and its `own_covariance` is used; without, the walk is taken as odometry gives it; at
                every pause or at none.
            known_ground: what the gait declares at this pause, in its base_footprint.
            time: time of the scan by a clock that never jumps [s], by which cells grow old; None takes the grid's
                stamp. Time that runs backwards makes all that was seen before STALE.

        Returns:
            Grid of extent "map" in base_footprint of this pause. Ground that only a foot or the gait vouches for has
            `looks` 0.

        Raises:
            InvalidInput: a grid of another extent or cell size, in the compact encoding, or of an earlier pause; a pose
                that is not rigid or tilts by more than 0.2 rad; a covariance that is not (6, 6), symmetric and without
                a negative eigenvalue; covariance_since_last at some pauses and not at others.
        """
        check_scan(terrain, self._grid.resolution, self._step)
        checked = checked_pose(terrain, pose)
        transform, pose_covariance, since_last = checked.transform, checked.covariance, checked.since_last
        self._walk.check_kind(self._scans, is_registered=since_last is not None, step=terrain.step)
        self._pause += 1 if self._step is None else terrain.step - self._step
        self._step = terrain.step
        if since_last is not None:
            offset = self._anchor.offset
            self._walk = self._walk.after(self._cells, terrain, transform, offset, since_last, checked.own)
        transform = self._walk.here @ transform
        clock = self._ticked(terrain.stamp if time is None else round(time * 1e9))
        position = transform[:2, 3]
        if self._centre is None or np.abs(position - self._centre).max() > MARGIN_M:
            self._cells.centre_on(float(position[0]), float(position[1]))
            self._centre = position.copy()
        transform[2, 3] += self._anchor.offset
        feet = support_feet(self._cells, self._robot, terrain, transform, self._settings.limits)
        errors = {foot.leg: sole_error(self._cells, foot) for foot in feet}
        anchor = self._anchor.after(
            float(pose_covariance[2, 2]), {leg: e for leg, e in errors.items() if e is not None}
        )
        correction, self._anchor = anchor.offset - self._anchor.offset, anchor
        transform[2, 3] += correction
        by_odometry = pose_covariance if since_last is None else None
        before, self._drift = self._drift, self._walk.drift(self._drift, self._anchor.rise, by_odometry)
        shift, turn = self._drift.shift - before.shift, self._drift.turn - before.turn
        growth = self._walk.growth if by_odometry is None else np.diag([shift, shift, turn])
        self._sideways = self._sideways.after(self._pause, growth, transform[:2, 3])
        now = MapPause(self._pause, clock, self._drift, self._sideways, transform)
        rejected = fuse_scan(self._cells, terrain, now)
        for foot in feet:
            fill_under_foot(self._cells, foot.raised(correction), self._drift, self._pause, clock)
        # The record names earlier patches too, as long as cells that they filled may still be valid.
        oldest = terrain.step - self._settings.validity_pauses
        self._ground = [patch for patch in self._ground if patch["cells"] and patch["step"] >= oldest]
        self._ground += [fuse_known_ground(self._cells, ground, now, terrain.step) for ground in known_ground]
        self._scans += 1
        residuals = {leg: None if error is None else error.residual for leg, error in errors.items()}
        return self._snapshot(terrain, now, pose_covariance, rejected, residuals)

    def view(
        self,
        terrain: TerrainGrid,
        pose: PoseInOdom,
        *,
        time: float | None = None,
    ) -> TerrainGrid:
        """The map seen from another pause, of which nothing is fused; arguments and errors as in `update`.

        Of `terrain` only stamp, step and record count.
        """
        check_scan(terrain, self._grid.resolution, self._step)
        checked = checked_pose(terrain, pose)
        transform = self._walk.transform @ checked.transform
        transform[2, 3] += self._anchor.offset
        pause = self._pause + (1 if self._step is None else terrain.step - self._step)
        clock = terrain.stamp if time is None else round(time * 1e9)
        now = MapPause(pause, clock, self._drift, self._sideways, transform)
        return self._snapshot(terrain, now, checked.covariance, 0, {})

    def save(self, path: str | Path) -> None:
        """Write the whole map to an .npz file, from which `load` goes on as if there had been no break.

        The map lies in the `odom` of its walk: go on with the same odometry.

        Raises:
            MissingFile: the folder does not exist.
        """
        write_map(path, self._robot.name, self._cells, {name: getattr(self, name) for name in STATE})

    @classmethod
    def load(cls, path: str | Path, robot: RobotLike | None = None) -> TerrainMap:
        """The map that `save` wrote.

        Args:
            path: path of the file.
            robot: model, name or folder of its robot; None = the one of that name that comes with the package.

        Raises:
            MissingFile: no such file.
            FileFormatError: not such a file, damaged, or of a robot with another map.
            kinematics.KinematicsError: no such robot.
        """
        saved = read_map(path)
        robot = robot_model(saved.robot if robot is None else robot)
        if robot.name != saved.robot:
            raise FileFormatError(f"{path}: a map of robot {saved.robot!r}, the model given is {robot.name!r}")
        terrain_map = cls(robot, resolution=saved.resolution)
        if terrain_map._cells.side != saved.side:
            raise FileFormatError(
                f"{path}: the map has {saved.side} cells a side, that of {robot.name} has {terrain_map._cells.side}: "
                "it was saved with another robot.toml"
            )
        terrain_map._cells.restore(saved.memory, saved.first)
        for name, value in saved.state.items():
            setattr(terrain_map, name, value)
        return terrain_map

    def keep(self) -> None:
        """Keep what is fused by now: `take_back` restores it."""
        cells = self._kept[0] if self._kept is not None else OdomCells(self._grid.resolution, self._reach)
        cells.remember(self._cells)
        self._kept = cells, {name: copy.copy(getattr(self, name)) for name in STATE}

    def take_back(self) -> None:
        """Undo all that was fused since `keep`, bit for bit.

        Raises:
            InvalidInput: `keep` was never called.
        """
        if self._kept is None:
            raise InvalidInput("nothing was kept that could be restored; call keep() first")
        cells, state = self._kept
        self._cells.remember(cells)
        for name, value in state.items():
            setattr(self, name, copy.copy(value))

    def _ticked(self, clock: int) -> int:
        """Take note of the time [ns]; what was seen before it ran backwards is of unknown age."""
        last, self._time = self._time, clock
        if last is not None and clock < last:
            memory = self._cells.memory
            memory["stamp"][np.isfinite(memory["height"])] = clock - round(2e9 * self._settings.validity_seconds) - 1
            self._reasons.append(
                f"the clock of the scans went back by {(last - clock) * 1e-9:.3g} s at step {self._step}: what was "
                "seen before counts as stale"
            )
        return clock

    def _snapshot(
        self,
        terrain: TerrainGrid,
        now: MapPause,
        pose_covariance: Float,
        rejected: int,
        residuals: Mapping[str, float | None],
    ) -> TerrainGrid:
        layers = snapshot_layers(self._cells, self._grid, terrain, now, self._settings)
        record = map_record(
            terrain=terrain,
            robot=self._robot.name,
            settings=self._settings,
            layers=layers,
            transform_footprint_to_odom=now.transform_footprint_to_odom,
            covariance=pose_covariance,
            scans=self._scans,
            rejected=rejected,
            anchor=self._anchor,
            residuals=residuals,
            known_ground=self._ground,
            reasons=self._reasons,
        )
        return TerrainGrid(
            layers=layers,
            geometry=self._grid,
            stamp=terrain.stamp,
            step=terrain.step,
            extent="map",
            record=dataclasses.replace(record, **self._walk.report()),
        )
