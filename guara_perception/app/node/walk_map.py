"""The fused map along a walk: leg odometry joins the pauses, the rolling map keeps what was seen."""

from __future__ import annotations

import copy
import logging
from collections.abc import Sequence
from dataclasses import dataclass, field

from guara_perception.calibration.calibration import Calibration
from guara_perception.exceptions import InvalidInput
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.map.known_ground import KnownGround
from guara_perception.terrain.map.terrain_map import TerrainMap
from kinematics import LegOdometry, OdometryLost, OdometryPose, RobotModel, Stance

logger = logging.getLogger(__name__)


@dataclass(slots=True)
class _WalkState:
    """Everything that a walk has gathered so far; `withdraw` goes back to a copy of it."""

    odometry: LegOdometry
    map: TerrainMap
    epoch: str = ""
    step: int | None = None
    stance: Stance | None = None
    pose: OdometryPose | None = None
    last: TerrainGrid | None = None
    restarts: list[str] = field(default_factory=list)

    def copy(self) -> _WalkState:
        """A copy with its own odometry. The map is shared: it is large, and keeps what it needs to go back itself."""
        return _WalkState(
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
        self._state = _WalkState(odometry, TerrainMap(robot))
        self._kept = self._state.copy()
        self._latest: TerrainGrid | None = None

    @property
    def latest(self) -> TerrainGrid | None:
        """The map that `update` or `withdraw` returned last."""
        return self._latest

    @property
    def restarts(self) -> tuple[str, ...]:
        """Why the map was started again, each time."""
        return tuple(self._state.restarts)

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
            terrain: grid of the scan alone.
            known_ground: what the gait declares, in base_footprint of this pause.
            epoch: identity of the walk.
            time: time of the scan by a clock that never jumps [s]; None takes the grid's stamp.

        Raises:
            kinematics.KinematicsError: the stance does not fit the robot.
        """
        state = self._state
        if state.last is not None and (epoch, step) == (state.epoch, state.step) and stance == state.stance:
            # A further scan of a pause, on request: the ground was fused with the first.
            return state.last
        if state.step is not None and epoch != state.epoch:
            self._restart(f"walk {epoch!r} came after walk {state.epoch!r}")
        elif state.step is not None and step <= state.step:
            self._restart(f"step {step} came after step {state.step}: another walk")
        state.pose = pose = self._locate(stance)
        state.last = self._latest = state.map.update(
            terrain,
            pose,
            known_ground=known_ground,
            time=time,
        ).restated(**self._reported(pose))
        state.epoch, state.step, state.stance = epoch, step, stance
        return state.last

    def keep(self) -> None:
        """Make all that was fused so far permanent: `withdraw` goes back to here."""
        self._state.map.keep()
        self._kept = self._state.copy()

    def withdraw(self, terrain: TerrainGrid, *, time: float | None = None) -> TerrainGrid:
        """Undo all since `keep`, and give the map of the pauses before, in base_footprint of the withdrawn one.

        Args:
            terrain: grid of the withdrawn pause, without a known cell; its health says why.
            time: as in `update`.

        Raises:
            InvalidInput: no pause was fused since.
        """
        pose = self._state.pose
        if pose is None:
            raise InvalidInput("no pause was fused that could be withdrawn")
        began_again = self._state.map is not self._kept.map
        self._state = self._kept
        if self._state.last is None:
            # No pause was kept yet: nothing else was ever in this map.
            self._state.map = TerrainMap(self._robot)
        else:
            self._state.map.take_back()
        self._kept = self._state.copy()
        # A map that began again with this pause has another `odom` than the map before, of which nothing may be shown.
        known = TerrainMap(self._robot) if began_again else self._state.map
        self._latest = known.view(
            terrain,
            pose,
            time=time,
        ).restated(**self._reported(pose), health=terrain.record.health)
        return self._latest

    def _reported(self, pose: OdometryPose) -> dict[str, object]:
        return {
            "slipped_feet": tuple(pose.slipped_feet),
            "odometry_residual": pose.residual,
            "restarts": self.restarts,
        }

    def _locate(self, stance: Stance) -> OdometryPose:
        try:
            return self._state.odometry.update(stance)
        except OdometryLost as error:
            self._restart(f"odometry lost: {error}")
            return self._state.odometry.update(stance)

    def _restart(self, reason: str) -> None:
        logger.warning("the map starts again: %s", reason)
        self._state.restarts.append(reason)
        self._state.odometry.reset()
        self._state.map = TerrainMap(self._robot)
