"""The fused map along a walk: leg odometry joins the pauses, the rolling map keeps what was seen."""

from __future__ import annotations

import logging
from collections.abc import Sequence

import numpy as np

from guara_perception.arrays import Float
from guara_perception.calibration.calibration import Calibration
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.map.known_ground import KnownGround
from guara_perception.terrain.map.terrain_map import TerrainMap
from kinematics import LegOdometry, OdometryLost, OdometryPose, RobotModel, Stance
from transport import GroundPatch

logger = logging.getLogger(__name__)


class WalkMap:
    """Follows one walk. When the odometry is lost or a pause number runs backwards, the map starts anew and says so."""

    def __init__(self, robot: RobotModel, calibration: Calibration) -> None:
        """Start before the first pause."""
        self._robot = robot
        self._odometry = LegOdometry(robot, transform_camera_to_base=calibration.transform_camera_to_base)
        self._map = TerrainMap(robot)
        self._step: int | None = None
        self._last: TerrainGrid | None = None
        self._restarts: list[str] = []

    @property
    def latest(self) -> TerrainGrid | None:
        """The map as it was fused last."""
        return self._last

    @property
    def restarts(self) -> tuple[str, ...]:
        """Why the map was started anew, each time."""
        return tuple(self._restarts)

    def update(
        self, step: int, stance: Stance, terrain: TerrainGrid, known_ground: Sequence[GroundPatch] = ()
    ) -> TerrainGrid:
        """Fuse the scan of one pause and give the map in base_footprint of that pause.

        Args:
            step: number of the pause, growing.
            stance: of the robot at that pause.
            terrain: the scan alone.
            known_ground: what the gait declares, in base_footprint of this pause.

        Raises:
            kinematics.KinematicsError: the stance does not fit the robot.
        """
        if self._last is not None and step == self._step:
            # A further scan of a pause, on request: the ground was fused with the first.
            return self._last
        if self._step is not None and step < self._step:
            self._restart(f"step {step} came after step {self._step}: another walk")
        pose = self._locate(stance)
        self._step = step
        self._last = self._map.update(
            terrain,
            _transform_of(terrain, pose),
            pose.covariance,
            known_ground=[KnownGround(patch.outline, patch.height, patch.sigma) for patch in known_ground],
            metadata={
                "slipped_feet": list(pose.slipped_feet),
                "odometry_residual": pose.residual,
                "restarts": list(self._restarts),
            },
        )
        return self._last

    def _locate(self, stance: Stance) -> OdometryPose:
        try:
            return self._odometry.update(stance)
        except OdometryLost as error:
            self._restart(f"odometry lost: {error}")
            return self._odometry.update(stance)

    def _restart(self, reason: str) -> None:
        logger.warning("the map starts anew: %s", reason)
        self._restarts.append(reason)
        self._odometry.reset()
        self._map = TerrainMap(self._robot)


def _transform_of(terrain: TerrainGrid, pose: OdometryPose) -> Float:
    """transform_footprint_to_odom (4, 4) of the footprint that the scan was processed in.

    Without gravity that one is level with the support plane, and odometry's own with the gravity that it carries along.
    """
    to_footprint = terrain.metadata.get("transform_base_to_footprint")
    if to_footprint is None:
        return np.asarray(pose.transform_footprint_to_odom)
    return np.asarray(pose.transform_base_to_odom @ np.linalg.inv(np.array(to_footprint, dtype=np.float64)))
