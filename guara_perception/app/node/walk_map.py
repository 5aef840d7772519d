"""The fused map along a walk: leg odometry joins the pauses, the rolling map keeps what was seen."""

from __future__ import annotations

import copy
import logging
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from guara_perception.arrays import Float
from guara_perception.calibration.calibration import Calibration
from guara_perception.exceptions import InvalidInput
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.map.known_ground import KnownGround
from guara_perception.terrain.map.terrain_map import TerrainMap
from kinematics import LegOdometry, OdometryLost, OdometryPose, RobotModel, Stance

logger = logging.getLogger(__name__)


@dataclass(slots=True)
class _Way:
    """All that a walk is by now: what `withdraw` comes back to."""

    odometry: LegOdometry
    map: TerrainMap
    epoch: str = ""
    step: int | None = None
    stance: Stance | None = None
    pose: OdometryPose | None = None
    last: TerrainGrid | None = None
    restarts: list[str] = field(default_factory=list)

    def copy(self) -> _Way:
        """With an odometry of its own; the map, which is large, keeps its own copy of its cells."""
        return _Way(
            copy.copy(self.odometry),
            self.map,
            self.epoch,
            self.step,
            self.stance,
            self.pose,
            self.last,
            list(self.restarts),
        )


class WalkMap:
    """Follows one walk. When the odometry is lost or another walk begins, the map starts again and says so.

    A scan that is fused may turn out to be wrong: `withdraw` undoes all since `keep`.
    """

    def __init__(self, robot: RobotModel, calibration: Calibration) -> None:
        """Start before the first pause."""
        self._robot = robot
        odometry = LegOdometry(robot, transform_camera_to_base=calibration.transform_camera_to_base)
        self._way = _Way(odometry, TerrainMap(robot))
        self._kept = self._way.copy()
        self._latest: TerrainGrid | None = None

    @property
    def latest(self) -> TerrainGrid | None:
        """The map as it was given last."""
        return self._latest

    @property
    def restarts(self) -> tuple[str, ...]:
        """Why the map was started again, each time."""
        return tuple(self._way.restarts)

    def update(
        self,
        step: int,
        stance: Stance,
        terrain: TerrainGrid,
        known_ground: Sequence[KnownGround] = (),
        *,
        epoch: str = "",
        time: float | None = None,
    ) -> TerrainGrid:
        """Fuse the scan of one pause and give the map in base_footprint of that pause.

        Args:
            step: number of the pause, growing along a walk.
            stance: stance of the robot at that pause.
            terrain: the scan alone.
            known_ground: what the gait declares, in base_footprint of this pause.
            epoch: identity of the walk.
            time: time of the scan by a clock that never steps [s]; None takes the grid's stamp.

        Raises:
            kinematics.KinematicsError: the stance does not fit the robot.
        """
        way = self._way
        if way.last is not None and (epoch, step) == (way.epoch, way.step) and stance == way.stance:
            # A further scan of a pause, on request: the ground was fused with the first.
            return way.last
        if way.step is not None and epoch != way.epoch:
            self._restart(f"walk {epoch!r} came after walk {way.epoch!r}")
        elif way.step is not None and step <= way.step:
            self._restart(f"step {step} came after step {way.step}: another walk")
        way.pose = pose = self._locate(stance)
        way.last = self._latest = way.map.update(
            terrain,
            _transform_of(terrain, pose),
            pose.covariance,
            covariance_since_last=pose.covariance_since_last,
            own_covariance=pose.own_covariance,
            known_ground=known_ground,
            metadata=self._reported(pose),
            time=time,
        )
        way.epoch, way.step, way.stance = epoch, step, stance
        return way.last

    def keep(self) -> None:
        """What was fused up to now stands."""
        self._way.map.keep()
        self._kept = self._way.copy()

    def withdraw(self, terrain: TerrainGrid, *, time: float | None = None) -> TerrainGrid:
        """Undo all since `keep`, and give the map of the pauses before, in base_footprint of the withdrawn one.

        Args:
            terrain: in which nothing is known, and why, for the withdrawn pause.
            time: as in `update`.

        Raises:
            InvalidInput: nothing was fused since.
        """
        pose = self._way.pose
        if pose is None:
            raise InvalidInput("no pause was fused that could be withdrawn")
        began_again = self._way.map is not self._kept.map
        self._way = self._kept
        if self._way.last is None:
            # Before the first pause that stands: nothing else was ever in this map.
            self._way.map = TerrainMap(self._robot)
        else:
            self._way.map.take_back()
        self._kept = self._way.copy()
        # A map that began again with this pause stands in another `odom` than the one before: nothing of that one.
        known = TerrainMap(self._robot) if began_again else self._way.map
        self._latest = known.view(
            terrain,
            _transform_of(terrain, pose),
            pose.covariance,
            metadata={**self._reported(pose), "health": dict(terrain.metadata["health"])},
            time=time,
        )
        return self._latest

    def _reported(self, pose: OdometryPose) -> dict[str, object]:
        return {
            "slipped_feet": list(pose.slipped_feet),
            "odometry_residual": pose.residual,
            "restarts": list(self._way.restarts),
        }

    def _locate(self, stance: Stance) -> OdometryPose:
        try:
            return self._way.odometry.update(stance)
        except OdometryLost as error:
            self._restart(f"odometry lost: {error}")
            return self._way.odometry.update(stance)

    def _restart(self, reason: str) -> None:
        logger.warning("the map starts again: %s", reason)
        self._way.restarts.append(reason)
        self._way.odometry.reset()
        self._way.map = TerrainMap(self._robot)


def _transform_of(terrain: TerrainGrid, pose: OdometryPose) -> Float:
    """transform_footprint_to_odom (4, 4) of the footprint that the scan was processed in.

    Without gravity that one is level with the support plane, and odometry's own with the gravity that it carries along.
    """
    to_footprint = terrain.metadata.get("transform_base_to_footprint")
    if to_footprint is None:
        return np.asarray(pose.transform_footprint_to_odom)
    return np.asarray(pose.transform_base_to_odom @ np.linalg.inv(np.array(to_footprint, dtype=np.float64)))
