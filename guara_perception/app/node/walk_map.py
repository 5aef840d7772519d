"""Fused map of a walk: a rolling elevation map whose scans are placed by leg odometry."""

from __future__ import annotations

import copy
import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np

from guara_perception.app.node.claim import Claim
from guara_perception.app.node.journal import Journal
from guara_perception.arrays import Float
from guara_perception.calibration.calibration import Calibration
from guara_perception.exceptions import InvalidInput
from guara_perception.ground_picture import GroundPicture
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.layers.record import Health
from guara_perception.terrain.map.known_ground import KnownGround
from guara_perception.terrain.map.terrain_map import TerrainMap
from kinematics import GravityEstimate, LegOdometry, OdometryLost, OdometryPose, RobotModel, Stance
from kinematics.transforms import transform_points

logger = logging.getLogger(__name__)
NONE_KNOWN: Mapping[str, int] = MappingProxyType({})


@dataclass(slots=True)
class _WalkState:
    """State of a walk; `withdraw` restores a copy of it."""

    odometry: LegOdometry
    map: TerrainMap
    epoch: str = ""
    step: int | None = None
    stance: Stance | None = None
    pose: OdometryPose | None = None
    last: TerrainGrid | None = None
    restarts: list[str] = field(default_factory=list)
    # Sole positions in the map's `odom`; None if the image of the last pause did not locate the robot.
    soles: Mapping[str, Float] | None = None
    # True after a scan that was too incomplete to confirm or reject the walk of the journal, until a later scan does.
    is_undecided: bool = False

    def copy(self) -> _WalkState:
        """Copy with its own odometry. The map is shared, since it is large and keeps its own undo state."""
        return replace(self, odometry=copy.copy(self.odometry), restarts=list(self.restarts))


class WalkMap:
    """Map of a walk. It restarts if the odometry is lost or another walk begins; its record states the reasons.

    Since a fused scan may turn out to be wrong, `withdraw` undoes all updates since `keep`.

    Attributes:
        latest: newest map returned by `update` or `withdraw`; None before the first.
    """

    def __init__(self, robot: RobotModel, calibration: Calibration, journal: Journal | None = None) -> None:
        """Start with an empty map.

        The walk of the journal continues if the first scan fits a claim in it. If that scan was cut short and only its
        image or heights do not fit, the next scan decides.
        """
        self._robot, self._journal = robot, journal
        odometry = LegOdometry(robot, transform_camera_to_base=calibration.transform_camera_to_base)
        self._state = _WalkState(odometry, TerrainMap(robot))
        self._kept = self._state.copy()
        self.latest: TerrainGrid | None = None

    def update(
        self,
        step: int,
        stance: Stance,
        terrain: TerrainGrid,
        known_ground: Sequence[KnownGround] = (),
        *,
        epoch: str = "",
        time: float | None = None,
        picture: GroundPicture | str | None = None,
        standing_pauses: Mapping[str, int] = NONE_KNOWN,
    ) -> TerrainGrid:
        """Fuse the scan of one pause and return the map in base_footprint of that pause.

        Another scan of the newest pause with the same stance is not fused; the newest map is returned.

        Args:
            step: number of the pause, increasing along a walk.
            stance: stance of the robot at that pause.
            terrain: grid of the scan alone.
            known_ground: ground that the gait declares, in base_footprint of this pause.
            epoch: identity of the walk.
            time: time of the scan on a monotonic clock [s]; None = the grid's stamp.
            picture: laser-off image of the scan, as in `TerrainMap.update`.
            standing_pauses: by leg, number of previous pauses through which the foot has stayed on the ground.

        Raises:
            kinematics.KinematicsError: the stance does not fit the robot, or its pose cannot be computed.
            InvalidInput: as in `TerrainMap.update`.
        """
        state = self._state
        if state.last is not None and (epoch, step) == (state.epoch, state.step) and stance == state.stance:
            # A requested scan of the same pause: its ground was already fused with the first scan.
            return state.last
        refused, standing = "", None
        if state.step is None or state.is_undecided:
            at = terrain.stamp * 1e-9 if time is None else time
            refused, standing = self._resume((epoch, step, standing_pauses), stance, terrain, at, picture)
        state = self._state
        if state.step is not None and epoch != state.epoch:
            self._restart(f"walk {epoch!r} came after walk {state.epoch!r}")
        elif state.step is not None and step <= state.step:
            self._restart(f"step {step} came after step {state.step}: another walk")
        state.pose = pose = self._locate(stance, standing)
        fused = state.map.update(terrain, pose, known_ground=known_ground, time=time, picture=picture)
        if refused:
            reasons = fused.record.health.reasons if fused.record.health else ()
            fused = fused.restated(health=Health.of((*reasons, refused)))
        slips = self._slips(pose, fused)
        if slips is not None:
            state.pose = replace(pose, foot_slips=slips)
        state.last = self.latest = fused.restated(**self._reported(pose), foot_slips=slips)
        state.epoch, state.step, state.stance = epoch, step, stance
        return state.last

    def gravity(self, step: int, stance: Stance, *, epoch: str = "") -> GravityEstimate | None:
        """Gravity estimated by leg odometry for the scan of a pause; None if unknown, or if an IMU measures gravity.

        Args:
            step, stance, epoch: as in `update`.

        Raises:
            kinematics.KinematicsError: the stance does not fit the robot.
        """
        state = self._state
        if state.step is None or epoch != state.epoch or step < state.step:
            return None
        if step > state.step:
            return state.odometry.carried_gravity(stance)
        is_carried = stance == state.stance and state.pose is not None and state.pose.pose.attitude_source == "odometry"
        return state.pose.gravity if is_carried and state.pose is not None else None

    @property
    def pose(self) -> OdometryPose | None:
        """Odometry of the newest pause, with the slip of the feet if images measured it; None before the first."""
        return self._state.pose

    def keep(self) -> None:
        """Make all updates so far permanent; `withdraw` returns to this state."""
        self._state.map.keep()
        self._kept = self._state.copy()
        if self._journal is not None and not self._state.is_undecided:
            self._journal.claims = ()

    def claim(self, time: float) -> Claim | None:
        """Claim for the journal after the last pause, whose scan ended at `time` [s].

        None before the first pause, and until a scan has confirmed or rejected the journal found at the start.
        """
        state = self._state
        odometry = state.odometry.state
        if state.step is None or state.stance is None or odometry is None or state.is_undecided:
            return None
        restarts = tuple(state.restarts)
        return Claim(state.epoch, state.step, state.stance, time, odometry, state.map.copy(), restarts)

    def withdraw(self, terrain: TerrainGrid, *, time: float | None = None) -> TerrainGrid:
        """Undo all updates since `keep`; return the remaining map, in base_footprint of the withdrawn pause.

        Args:
            terrain: all-unknown grid of the withdrawn pause; its health gives the reason.
            time: as in `update`.

        Raises:
            InvalidInput: no pause was fused yet, or all fused pauses were withdrawn.
        """
        pose = self._state.pose
        if pose is None:
            raise InvalidInput("there is no fused pause to withdraw")
        began_again = self._state.map is not self._kept.map
        self._state = self._kept
        if self._state.last is None:
            # No pause was kept, so the map contains withdrawn scans only.
            self._state.map = TerrainMap(self._robot)
        else:
            self._state.map.take_back()
        self._kept = self._state.copy()
        # A map that restarted at this pause has another `odom`, in which nothing of the earlier map may be shown.
        known = TerrainMap(self._robot) if began_again else self._state.map
        view = known.view(terrain, pose, time=time)
        self.latest = view.restated(**self._reported(pose), health=terrain.record.health)
        return self.latest

    def _resume(
        self,
        pause: tuple[str, int, Mapping[str, int]],
        stance: Stance,
        terrain: TerrainGrid,
        time: float,
        picture: GroundPicture | str | None,
    ) -> tuple[str, Sequence[str] | None]:
        """Continue from the newest claim of this walk before a pause, if the scan of the pause fits.

        Args:
            pause: epoch, step and standing_pauses, as in `update`.
            stance, terrain, time, picture: as in `update`.

        Returns:
            Reason why a new walk begins, empty if the claimed walk continues or there is no claim; and the feet that
            have stood since the claim, None if a new walk begins.
        """
        journal, (epoch, step, standing_pauses) = self._journal, pause
        if journal is None or not journal.claims:
            return "", None
        may_fit_later = False
        claim = next((each for each in journal.claims if (each.epoch, each.step < step) == (epoch, True)), None)
        if claim is None:
            newest = journal.claims[0]
            why = f"the journal ends at step {newest.step} of walk {newest.epoch!r}; this is step {step} of {epoch!r}"
        else:
            odometry = copy.copy(self._state.odometry)
            standing = [leg for leg, pauses in standing_pauses.items() if pauses >= step - claim.step]
            why, may_fit_later = claim.misfit(stance, terrain, odometry, standing, time=time, picture=picture)
        if claim is None or why:
            if may_fit_later:
                reason = f"the scan was cut short; the next scan decides whether the journal fits: {why}"
                logger.warning("journal: %s", reason)
            else:
                journal.refuse(why)
                reason = f"the journal does not fit: {why}"
            self._state.is_undecided = may_fit_later
            self._state.restarts.append(reason)
            return reason, None
        odometry.restore(claim.odometry, claim.stance)
        journal.resumed(claim)
        restarts = list(claim.restarts)
        self._state = _WalkState(odometry, claim.map.copy(), claim.epoch, claim.step, claim.stance, restarts=restarts)
        return "", standing

    def _slips(self, pose: OdometryPose, fused: TerrainGrid) -> dict[str, float] | None:
        """Slip of each standing foot since the last pause [m]; None unless images located the robot at both pauses."""
        told, before = fused.metadata, self._state.soles
        is_shown = self._state.step is None or "visual_corners" in told
        if not is_shown or "visual_refused" in told or "transform_base_to_footprint" not in told:
            self._state.soles = None
            return None
        to_odom = np.array(told["transform_footprint_to_odom"]) @ np.array(told["transform_base_to_footprint"])
        legs = tuple(self._robot.legs)
        soles = transform_points(to_odom, pose.pose.state.soles_in_base(legs))
        self._state.soles = now = dict(zip(legs, soles, strict=True))
        stood = (*pose.stayed_feet, *pose.slipped_feet)
        return None if before is None else {leg: float(np.linalg.norm((now[leg] - before[leg])[:2])) for leg in stood}

    def _reported(self, pose: OdometryPose) -> dict[str, object]:
        return {
            "slipped_feet": tuple(pose.slipped_feet),
            "odometry_residual": pose.residual,
            "restarts": tuple(self._state.restarts),
        }

    def _locate(self, stance: Stance, standing: Sequence[str] | None) -> OdometryPose:
        try:
            return self._state.odometry.update(stance, standing)
        except OdometryLost as error:
            self._restart(f"odometry lost: {error}")
            return self._state.odometry.update(stance)

    def _restart(self, reason: str) -> None:
        logger.warning("the map restarts: %s", reason)
        self._state.restarts.append(reason)
        self._state.odometry.reset()
        self._state.map, self._state.soles, self._state.step = TerrainMap(self._robot), None, None
