"""Leg odometry: pose of the footprint in `odom` at each pause, from the feet that stayed in place."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from kinematics.arrays import Float, read_only
from kinematics.carried_gravity import carry_gravity
from kinematics.exceptions import OdometryLost
from kinematics.footholds import Fit, Footholds, first_footholds
from kinematics.footprint import skew
from kinematics.model import RobotModel
from kinematics.stance import Stance
from kinematics.stance_pose import GravityEstimate, StancePose, sole_covariances, stance_pose
from kinematics.stayed_feet import find_stayed_feet, sole_readings
from kinematics.transforms import transform_points
from kinematics.tree import RobotState

# Rows of x, y, z and heading in REP-103 order.
PLANAR = [0, 1, 2, 5]
# Covariance of the first footprint, which is `odom`.
EXACT = read_only(np.zeros((6, 6)))


@dataclass(frozen=True, slots=True, eq=False)
class PoseInOdom:
    """Pose of the footprint of one pause in `odom`, from any odometry; `LegOdometry` returns an `OdometryPose`.

    Attributes:
        transform_footprint_to_odom: (4, 4) pose of the pause's footprint.
        covariance: (6, 6) covariance relative to the start, REP-103 order.
        covariance_since_last: (6, 6) covariance of the motion since the last pause; None if unknown.
        own_covariance: (6, 6) covariance of the error of this pause alone, which later pauses do not inherit; None =
            no such error.
    """

    transform_footprint_to_odom: Float
    covariance: Float
    covariance_since_last: Float | None = None
    own_covariance: Float | None = None


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class OdometryPose(PoseInOdom):
    """Pose of the footprint of one pause in `odom` by leg odometry; arrays are read-only.

    Attributes:
        step: number of the pause since the start, from 0.
        pose: the stance pose of the pause (attitude source `odometry` if gravity was carried from the last pause).
        transform_footprint_to_odom: (4, 4), a rotation about z and a translation.
        covariance: (6, 6) covariance relative to the first pause, REP-103 order. Roll and pitch are exact by
            definition, because both frames are gravity-aligned; `pose.covariance` contains the error of this alignment.
        covariance_since_last: (6, 6) covariance of the motion since the last pause, expressed in the last footprint,
            REP-103 order; zeros at the first pause. The errors of the two poses are correlated, so this covariance
            cannot be computed from theirs.
        own_covariance: (6, 6) covariance of the part of this footprint's error that no other pause shares (noise of the
            readings and the vertical), along the axes of `odom`, REP-103 order; zeros at the first pause. The rest of
            the error is drift, which later pauses inherit.
        gravity: gravity estimate from which the next pause continues.
        stayed_feet: feet that stayed in place. Only feet are considered that both stances name as supporting (even if
            found unloaded) and that are in the argument `standing` of `LegOdometry.update`.
        swung_feet: considered feet that did not stay and moved by `swing_least` or more.
        slipped_feet: considered feet that did not stay and moved by less than `swing_least`.
        residual: rms horizontal distance of the feet that stayed from their footholds [m].
        foot_slips: leg -> distance by which the foot moved since the last pause [m], for `stayed_feet` and
            `slipped_feet`. Leg odometry cannot observe a slide common to all feet; it is included only if camera images
            have located the robot.
    """

    step: int
    pose: StancePose
    covariance_since_last: Float
    own_covariance: Float
    gravity: GravityEstimate
    stayed_feet: tuple[str, ...] = ()
    swung_feet: tuple[str, ...] = ()
    slipped_feet: tuple[str, ...] = ()
    residual: float = 0.0
    foot_slips: Mapping[str, float] = field(default_factory=dict)

    @property
    def transform_base_to_odom(self) -> Float:
        """Pose of the body in `odom`, (4, 4)."""
        return read_only(self.transform_footprint_to_odom @ self.pose.transform_base_to_footprint)


@dataclass(frozen=True, slots=True, eq=False)
class OdometryState:
    """State of leg odometry after a pause, from which another `LegOdometry` can continue; arrays are read-only.

    Attributes:
        step: number of the pause since the start, from 0.
        transform_footprint_to_odom: (4, 4) pose of the pause's footprint.
        footholds: positions of the standing feet, with covariances.
        first_tilt: (6, 6) covariance of the first footprint's position caused by the error of its vertical.
    """

    step: int
    transform_footprint_to_odom: Float
    footholds: Footholds
    first_tilt: Float


class LegOdometry:
    """Leg odometry of a walk, updated at every pause; `odom` is the footprint of the first pause.

    Args:
        robot: the model.
        transform_camera_to_base: (4, 4) calibrated pose of the camera, for the stance poses; None = the pose in the
            URDF.
    """

    def __init__(self, robot: RobotModel, *, transform_camera_to_base: npt.ArrayLike | None = None) -> None:
        self._robot = robot
        self._camera = transform_camera_to_base
        self._limits = robot.odometry_limits
        self._last: OdometryPose | None = None
        self._footholds: Footholds | None = None
        self._first_tilt = np.zeros((6, 6))

    @property
    def last(self) -> OdometryPose | None:
        """Latest pose; None before the first pause."""
        return self._last

    @property
    def state(self) -> OdometryState | None:
        """State after the latest pause; None before the first."""
        if self._last is None or self._footholds is None:
            return None
        return OdometryState(self._last.step, self._last.transform_footprint_to_odom, self._footholds, self._first_tilt)

    def restore(self, state: OdometryState, stance: Stance) -> None:
        """Continue from a state, given the stance of its pause.

        The pose of the body is restored exactly if the stance includes gravity. After this, all covariances of `last`
        except that of `last.pose` are zero.

        Raises:
            KinematicsError: as in `RobotModel.stance_pose`.
        """
        pose = self._pose(self._robot.state(stance.joint_positions), stance, None)
        self._last = _exact(state.step, pose, state.transform_footprint_to_odom)
        self._footholds, self._first_tilt = state.footholds, state.first_tilt

    def reset(self) -> None:
        """Start a new walk: the next pause is its first one and defines a new `odom`."""
        self._last, self._footholds = None, None

    def update(self, stance: Stance, standing: Sequence[str] | None = None) -> OdometryPose:
        """Compute the footprint of a new pause.

        Args:
            stance: stance of the pause.
            standing: feet that may have stayed since the last pause; None = all. Needed after missed pauses, because
                the joints alone cannot distinguish feet that stood from two feet that swung alike and kept their
                distance.

        Raises:
            OdometryLost: fewer than two feet stayed since the last pause. The odometry is unchanged; call `reset` to
                start a new walk.
            KinematicsError: as in `RobotModel.stance_pose`.
        """
        if self._last is None or self._footholds is None:
            self._last, self._footholds = self._first(stance)
        else:
            self._last, self._footholds = self._next(stance, self._last, self._footholds, standing)
        return self._last

    def _pose(self, state: RobotState, stance: Stance, gravity: GravityEstimate | None) -> StancePose:
        return stance_pose(
            state,
            stance.support_feet,
            stance.gravity_in_base,
            noise=self._robot.noise,
            odometry=gravity,
            transform_camera_to_base=self._camera,
        )

    def _first(self, stance: Stance) -> tuple[OdometryPose, Footholds]:
        pose = self._pose(self._robot.state(stance.joint_positions), stance, None)
        self._first_tilt = _shift_by_tilt(pose)
        footholds = first_footholds(_named_feet(pose), *sole_readings(pose, _named_feet(pose), self._robot.noise))
        return _exact(0, pose, read_only(np.eye(4))), footholds

    def _next(
        self, stance: Stance, last: OdometryPose, footholds: Footholds, standing: Sequence[str] | None
    ) -> tuple[OdometryPose, Footholds]:
        state = self._robot.state(stance.joint_positions)
        common, (stayed, *others) = self._feet(state, stance, last, standing)
        pose = self._pose(state, stance, self._carried(state, stance, last, stayed))
        if len(stayed) < 2:
            raise OdometryLost(
                f"feet that stayed between two pauses: {len(stayed)} ({', '.join(common) or 'none'} were named as "
                "supporting at both); two are needed: scan more often than the feet move, or reset the odometry"
            )
        legs, before = _named_feet(pose), footholds
        readings = sole_readings(pose, legs, self._robot.noise)
        fit, footholds = before.after_pause(stayed, legs, *readings)
        transform = fit.transform_footprint_to_odom
        moved = self._moved(pose, last, transform, common)
        if instead := others or self._instead(common, stayed, moved):
            fit, footholds = before.after_pause(stayed, legs, *readings, instead=instead)
        # The tilt error of a pause shifts only that pause's footprint, so it is added here and not propagated.
        rotation = transform[:3, :3]
        covariance = self._first_tilt.copy()
        covariance[np.ix_(PLANAR, PLANAR)] += fit.covariance + footholds.slides_at(transform[:2, 3])
        covariance[:3, :3] += rotation @ _shift_by_tilt(pose)[:3, :3] @ rotation.T
        swung = [leg for leg in common if leg not in stayed and moved[leg] >= self._limits.swing_least]
        new = OdometryPose(
            step=last.step + 1,
            pose=pose,
            transform_footprint_to_odom=transform,
            covariance=read_only(covariance),
            covariance_since_last=read_only(_since_last(last, pose, fit)),
            own_covariance=read_only(_own(pose, transform, footholds)),
            stayed_feet=stayed,
            swung_feet=tuple(swung),
            slipped_feet=tuple(leg for leg in common if leg not in stayed and leg not in swung),
            foot_slips={leg: distance for leg, distance in moved.items() if leg not in swung},
            residual=fit.residual,
            gravity=pose.gravity,
        )
        return new, footholds

    def carried_gravity(self, stance: Stance) -> GravityEstimate | None:
        """Direction of gravity at a new pause, carried over from the last one; the odometry is unchanged.

        None at the first pause, if fewer than three feet stayed, or if the stance has gravity from an IMU, which is
        more accurate.

        Raises:
            UnknownName, JointPositionError: the joints or legs of the stance are not those of this robot, or a position
                is invalid.
            StanceError: the supporting feet are on a line.
        """
        if self._last is None:
            return None
        state = self._robot.state(stance.joint_positions)
        return self._carried(state, stance, self._last, self._feet(state, stance, self._last)[1][0])

    def _carried(
        self, state: RobotState, stance: Stance, last: OdometryPose, stayed: Sequence[str]
    ) -> GravityEstimate | None:
        if stance.gravity_in_base is not None or len(stayed) < 3:
            return None
        return carry_gravity(
            last.gravity,
            state.soles_in_base(stayed),
            last.pose.state.soles_in_base(stayed),
            state.soles_in_base(stance.support_feet),
            sole_covariances(state, stance.support_feet, self._robot.noise),
            self._robot.noise,
        )

    def _feet(
        self, state: RobotState, stance: Stance, last: OdometryPose, standing: Sequence[str] | None = None
    ) -> tuple[list[str], list[tuple[str, ...]]]:
        """Feet that support at both pauses (and are in `standing`), and sets that may have stayed, likeliest first."""
        # A foot that was found unloaded is included: it may stand on a block, and if it hangs free, its distances to
        # the other feet change.
        may_stand = stance.support_feet if standing is None else set(standing).intersection(stance.support_feet)
        common = [leg for leg in _named_feet(last.pose) if leg in may_stand]
        before = last.pose.state
        # Soles in base_link suffice, because the distances between them do not depend on the vertical.
        sets = find_stayed_feet(
            state.soles_in_base(common),
            sole_covariances(state, common, self._robot.noise),
            before.soles_in_base(common),
            sole_covariances(before, common, self._robot.noise),
            slip_sigmas=self._limits.slip_sigmas,
            turn_limit=self._limits.turn_limit,
        )
        return common, [tuple(common[row] for row in rows) for rows in sets] or [()]

    def _instead(
        self, common: Sequence[str], stayed: Sequence[str], moved: Mapping[str, float]
    ) -> Sequence[tuple[str, ...]]:
        """Single foot that may have stayed while the two in `stayed` slid in the same way; empty if there is none."""
        others = {leg: moved[leg] for leg in common if leg not in stayed}
        if len(stayed) > 2 or not others:
            return ()
        # A foot possibly stood if it moved less than `swing_least`, or less than twice that and less than half as far
        # as the foot that moved farthest.
        farthest, least = max(others.values()), self._limits.swing_least
        alone = {leg: way for leg, way in others.items() if way < least or (way < 2 * least and 2 * way < farthest)}
        return [(max(alone, key=alone.__getitem__),)] if alone else ()

    def _moved(self, pose: StancePose, last: OdometryPose, transform: Float, legs: list[str]) -> dict[str, float]:
        """Leg -> distance by which its sole moved in `odom` [m]."""
        here = transform @ pose.transform_base_to_footprint
        now = transform_points(here, pose.state.soles_in_base(legs))
        before = transform_points(last.transform_base_to_odom, last.pose.state.soles_in_base(legs))
        return dict(zip(legs, np.linalg.norm(now - before, axis=1).tolist(), strict=True))


def _exact(step: int, pose: StancePose, transform: Float) -> OdometryPose:
    """Pose of a pause at which odometry starts or continues; its footprint counts as exact."""
    return OdometryPose(
        step=step,
        pose=pose,
        transform_footprint_to_odom=transform,
        covariance=EXACT,
        covariance_since_last=EXACT,
        own_covariance=EXACT,
        gravity=pose.gravity,
    )


def _named_feet(pose: StancePose) -> tuple[str, ...]:
    """Feet that the stance named as supporting, including those found unloaded."""
    return pose.support_feet_used + pose.unloaded_feet


def _since_last(last: OdometryPose, pose: StancePose, fit: Fit) -> Float:
    """Covariance (6, 6) of the motion from the last footprint to the new one, in the frame of the last footprint.

    With headings a, positions t and R the rotation of the last footprint, the motion is (R' (t_new - t_last), a_new -
    a_last). Its covariance follows from the errors of both footprints by the chain rule; their shared errors cancel.
    """
    before, after = last.transform_footprint_to_odom, fit.transform_footprint_to_odom
    rotation = before[:3, :3]
    moved = after[:3, 3] - before[:3, 3]
    by_new, by_last = np.eye(4), -np.eye(4)
    by_new[:3, :3], by_last[:3, :3] = rotation.T, -rotation.T
    by_last[:3, 3] = rotation.T @ (moved[1], -moved[0], 0.0)
    new = fit.covariance + fit.by_slides
    shared = by_last @ fit.with_last @ by_new.T
    planar = by_last @ fit.last_covariance @ by_last.T + by_new @ new @ by_new.T + shared + shared.T
    result = np.zeros((6, 6))
    result[np.ix_(PLANAR, PLANAR)] = (planar + planar.T) / 2
    turn = rotation.T @ after[:3, :3]
    # The tilt error of each pause shifts its own footprint.
    result[:3, :3] += _shift_by_tilt(last.pose)[:3, :3] + turn @ _shift_by_tilt(pose)[:3, :3] @ turn.T
    return result


def _own(pose: StancePose, transform: Float, footholds: Footholds) -> Float:
    """Covariance (6, 6) of the part of a footprint's error that comes from the readings and vertical of its pause."""
    rotation = transform[:3, :3]
    result = np.zeros((6, 6))
    result[np.ix_(PLANAR, PLANAR)] = footholds.own_of_footprint
    result[:3, :3] += rotation @ _shift_by_tilt(pose)[:3, :3] @ rotation.T
    return result


def _shift_by_tilt(pose: StancePose) -> Float:
    """Covariance (6, 6) of the footprint's position caused by the error of the vertical."""
    lever = -skew(np.array([0.0, 0.0, -pose.height]))[:2]
    covariance = np.zeros((6, 6))
    covariance[:2, :2] = lever @ pose.covariance[3:, 3:] @ lever.T
    return covariance
