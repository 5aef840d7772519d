"""A snapshot of the robot: joint positions with forward kinematics already done."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from kinematics.arrays import Float, read_only
from kinematics.joint_positions import beyond_limits, checked_positions
from kinematics.tree import KinematicTree


class RobotState:
    """Where every link of the robot is, for one set of joint positions; immutable.

    Args:
        tree: the robot's kinematic tree.
        joint_positions: joint name -> position [rad], every joint once; or (n,) in the order of `tree.joint_names`.

    Attributes:
        tree: as given.
        positions: (n,) joint positions [rad] in the order of `tree.joint_names`, read-only.
        beyond_limits: joint name -> how far it stands beyond its limit [rad]; empty when all is well.

    Raises:
        UnknownName: a joint that the robot does not have.
        JointPositionError: a joint is missing, a value is not finite, or an array has the wrong length.
    """

    def __init__(self, tree: KinematicTree, joint_positions: Mapping[str, float] | npt.ArrayLike) -> None:
        """Run forward kinematics once; everything else reads its result."""
        import pinocchio

        self.tree = tree
        self.positions = read_only(checked_positions(tree, joint_positions))
        self.beyond_limits: Mapping[str, float] = MappingProxyType(beyond_limits(tree, self.positions))
        self._data = tree.pinocchio_model.createData()
        pinocchio.framesForwardKinematics(tree.pinocchio_model, self._data, tree.configuration(self.positions))
        pinocchio.computeJointJacobians(tree.pinocchio_model, self._data)

    @property
    def joint_positions(self) -> Mapping[str, float]:
        """Joint name -> position [rad], read-only."""
        return MappingProxyType(dict(zip(self.tree.joint_names, self.positions.tolist(), strict=True)))

    def joint_position(self, joint: str) -> float:
        """Position of one joint [rad]; `UnknownName` when the robot does not have it."""
        return float(self.positions[self.tree.joint_index(joint)])

    def transform_to_base(self, frame: str) -> Float:
        """`transform_<frame>_to_base`, (4, 4), read-only.

        Raises:
            UnknownName: the robot has no such frame; the message lists them.
        """
        # `homogeneous` is a copy: the placement itself is a live view of Pinocchio's data.
        return read_only(self._data.oMf[self.tree.frame_id(frame)].homogeneous)

    def position_in_base(self, frame: str) -> Float:
        """Origin of a frame in `base_link`, (3,) [m], read-only; `UnknownName` as above."""
        return read_only(self._data.oMf[self.tree.frame_id(frame)].translation)

    def soles_in_base(self, legs: Iterable[str] | None = None) -> Float:
        """Sole centres in `base_link`, (n, 3) [m], in the order of `legs` (default: all legs)."""
        names = tuple(self.tree.legs) if legs is None else tuple(legs)
        frames = [self.tree.frame_id(self.tree.leg(leg).sole) for leg in names]
        return read_only(np.reshape([self._data.oMf[frame].translation for frame in frames], (-1, 3)))

    def jacobian(self, frame: str) -> Float:
        """Jacobian of a frame's origin, (6, n): d(linear [m], angular [rad]) / d(positions).

        In axes of `base_link`, the body held still; columns follow `tree.joint_names`.
        """
        import pinocchio

        jacobian = pinocchio.getFrameJacobian(
            self.tree.pinocchio_model,
            self._data,
            self.tree.frame_id(frame),
            pinocchio.ReferenceFrame.LOCAL_WORLD_ALIGNED,
        )
        return read_only(jacobian[:, self.tree.velocity_indices])

    @property
    def centre_of_mass_in_base(self) -> Float:
        """Centre of mass of the whole robot in `base_link`, (3,) [m]."""
        import pinocchio

        # From the placements that are there; nothing else of this state's data is touched.
        return read_only(pinocchio.centerOfMass(self.tree.pinocchio_model, self._data, False))
