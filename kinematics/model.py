"""Model of a robot, with the checked content of its robot folder."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy.typing as npt

from kinematics.arrays import Float, Mask
from kinematics.exceptions import ArgumentError, named
from kinematics.leg import NumericLeg
from kinematics.reach import Reach, leg_kinematics, reach_from_bodies, reach_in_base
from kinematics.robot_settings import RobotSettings
from kinematics.robot_toml import RobotToml
from kinematics.scan_pattern import pattern_misses
from kinematics.srdf import Posture
from kinematics.stance import Stance
from kinematics.stance_pose import GravityEstimate, StanceNoise, StancePose, stance_pose
from kinematics.transforms import checked_transform
from kinematics.tree import KinematicTree, RobotState


class RobotModel:
    """Robot loaded and checked by `load_robot` or `robot_from_description`. Do not modify it.

    Attributes:
        folder: the robot folder; only a label if the robot was loaded from a description.
        toml_text, srdf_text: texts of robot.toml and of the SRDF, for `describe_robot`.
        name: name of the robot.
        tree: kinematic tree (names, limits, Pinocchio's model).
        legs: names of the legs, in robot.toml's order.
        joint_names: names of all moving joints: leg by leg from hip to sole, then any others.
        sole: length (x) and width (y) of the sole [m].
        noise: standard deviations of the errors of a stance (table [stance]).
        odometry_limits: limits of leg odometry (table [odometry]).
        pause_limits: limits of a stance pause (table [pause]).
        self_filter_settings: margin around the robot's own shapes, and ignored links (table [self_filter]).
        notes: content of the files that is not used or could not be checked.
        doubts: content that is accepted but should be corrected; at present only a scan pattern that misses part of
            the area.
        transform_camera_to_base: (4, 4) nominal pose of the camera, from the URDF.
        transform_laser_to_base: (4, 4) nominal pose of the laser, from the URDF; its origin is on the mirror axis,
            which is parallel to y.
    """

    def __init__(
        self,
        folder: Path,
        tree: KinematicTree,
        postures: Mapping[str, Posture],
        settings: RobotSettings,
        texts: tuple[str, str],
        notes: tuple[str, ...] = (),
    ) -> None:
        """Assemble the content read and checked by `load_robot`; `texts` are those of robot.toml and of the SRDF."""
        self.notes = notes
        self.folder = folder
        self.toml_text, self.srdf_text = texts
        self.tree = tree
        self.name = tree.config.name
        self.legs = tuple(tree.legs)
        self.joint_names = tree.joint_names
        self.sole = tree.config.sole
        self.noise = settings.noise
        self.odometry_limits = settings.odometry_limits
        self.pause_limits = settings.pause_limits
        self.self_filter_settings = settings.self_filter
        self._postures = dict(postures)
        nominal = RobotState(tree, self.posture(self.config.scan_posture))
        self.transform_camera_to_base: Float = nominal.transform_to_base(self.config.camera_frame)
        self.transform_laser_to_base: Float = nominal.transform_to_base(self.config.laser_frame)
        mirror = self.transform_laser_to_base[:3, 3]
        floor = float(nominal.soles_in_base()[:, 2].mean())
        missed = pattern_misses(self.config.root, float(mirror[0]), float(mirror[2]) - floor)
        self.doubts = () if missed is None else (f"[scan]: {missed}",)

    def __repr__(self) -> str:
        """Name, legs, number of joints, and folder."""
        return f"RobotModel({self.name!r}, legs {' '.join(self.legs)}, {len(self.joint_names)} joints, {self.folder})"

    @property
    def config(self) -> RobotToml:
        """Kinematic content of robot.toml."""
        return self.tree.config

    @property
    def posture_names(self) -> tuple[str, ...]:
        """Names of all postures."""
        return tuple(self._postures)

    def posture(self, name: str) -> dict[str, float]:
        """Joint name -> position [rad] of a named posture.

        Raises:
            UnknownName: no such posture; the message lists the known ones.
        """
        return dict(named("posture", name, self._postures).joint_positions)

    def optical_centre(self, transform_camera_to_base: npt.ArrayLike | None = None) -> Float:
        """Optical centre (3,) in `base_link` [m] for a calibrated pose (4, 4) of the camera; None = pose in the URDF.

        Raises:
            ArgumentError: the matrix is not a transform.
        """
        if transform_camera_to_base is None:
            return self.transform_camera_to_base[:3, 3]
        return checked_transform(transform_camera_to_base, "transform_camera_to_base")[:3, 3]

    def state(self, joint_positions: Mapping[str, float] | npt.ArrayLike) -> RobotState:
        """State of the robot at joint positions, given by name or as (n,) in the order of `joint_names` [rad].

        Positions beyond the joint limits are accepted with one `JointLimitWarning`.

        Raises:
            UnknownName: a joint that the robot does not have.
            JointPositionError: a joint is missing, a value is not a finite number or obviously not in radians, or an
                array has the wrong length.
        """
        return RobotState(self.tree, joint_positions)

    def stance_pose(
        self,
        stance: Stance,
        *,
        attitude: str | None = None,
        odometry: GravityEstimate | None = None,
        transform_camera_to_base: npt.ArrayLike | None = None,
        find_unloaded: bool = True,
        noise: StanceNoise | None = None,
    ) -> StancePose:
        """Pose of the body at a pause.

        Other arguments are as in `kinematics.stance_pose`; `noise` defaults to that of the robot.

        Raises:
            UnknownName, JointPositionError: as in `state`, or a leg that the robot does not have.
            StanceError, ArgumentError: as in `kinematics.stance_pose`.
        """
        for foot in stance.support_feet:
            self.tree.leg(foot)
        return stance_pose(
            self.state(stance.joint_positions),
            stance.support_feet,
            stance.gravity_in_base,
            noise=noise or self.noise,
            attitude=attitude,
            odometry=odometry,
            transform_camera_to_base=transform_camera_to_base,
            find_unloaded=find_unloaded,
        )

    def reach(self, leg: str, soles_in_base: npt.ArrayLike, sole_pitch: npt.ArrayLike = 0.0) -> Reach:
        """Joint positions that place a leg's sole at points (..., 3) in `base_link`; see `kinematics.reach_in_base`."""
        return reach_in_base(self.tree, leg, soles_in_base, sole_pitch)

    def reach_from(self, leg: str, soles: npt.ArrayLike, transforms_base_to_ground: npt.ArrayLike) -> Reach:
        """As `reach`, but for level soles on the ground and given poses of the body.

        Arguments and errors are as in `kinematics.reach.reach_from_bodies`.
        """
        return reach_from_bodies(self.tree, leg, soles, transforms_base_to_ground)

    def shanks(self, leg: str, joint_positions: npt.ArrayLike) -> tuple[Float, Float]:
        """Upper and lower ends (..., 3) of a leg's shank in `base_link` [m], for its joint positions (..., n) [rad].

        Raises:
            UnknownName: no such leg.
            ArgumentError: the leg has no closed-form kinematics; see `kinematics.leg`.
        """
        solver = leg_kinematics(self.tree, leg)
        if isinstance(solver, NumericLeg):
            raise ArgumentError(
                f"leg {leg!r} of {self.name!r} has no closed-form kinematics, which require hip roll, two or three "
                "pitch joints and the geometry described in kinematics.leg"
            )
        return solver.shanks_in_base(joint_positions)

    def reachable(self, leg: str, soles_in_base: npt.ArrayLike, sole_pitch: npt.ArrayLike = 0.0) -> Mask:
        """Mask (...) of the points (..., 3) in `base_link` [m] that a leg's sole reaches within the joint limits."""
        return self.reach(leg, soles_in_base, sole_pitch).is_reachable
