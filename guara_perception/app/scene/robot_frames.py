"""Where every frame of the robot is, as transforms from child to parent: the tree that ROS calls TF."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from guara_perception.arrays import Float
from kinematics import BASE_FOOTPRINT, RobotModel, Stance
from transport import TransformMessage
from transport.recording import CAMERA_FRAME


class RobotFrames:
    """The links of one robot, its camera where the calibration says that it is, not where the URDF does."""

    def __init__(self, robot: RobotModel, transform_camera_to_base: npt.ArrayLike) -> None:
        """For a robot and the camera that it carries, (4, 4)."""
        self._robot = robot
        self._camera_to_base = np.asarray(transform_camera_to_base, dtype=np.float64)

    def fixed(self) -> list[TransformMessage]:
        """What no joint moves."""
        nominal = self._robot.posture(self._robot.config.scan_posture)
        fixed = self._between_links(nominal, of_fixed_joints=True)
        camera = self._robot.config.camera_frame
        if camera != CAMERA_FRAME:
            # The frame that pictures name, whatever the URDF calls the camera's.
            fixed.append(TransformMessage(source_frame=CAMERA_FRAME, destination_frame=camera, matrix=np.eye(4)))
        return fixed

    def moving(self, joint_positions: Mapping[str, float]) -> list[TransformMessage]:
        """What the joints move.

        Raises:
            kinematics.KinematicsError: the joints are not those of the robot.
        """
        return self._between_links(joint_positions, of_fixed_joints=False)

    def standing(self, stance: Stance) -> list[TransformMessage]:
        """The joints, and the body over the ground that its feet stand on.

        Raises:
            kinematics.KinematicsError: the stance does not fit the robot.
        """
        pose = self._robot.stance_pose(stance, transform_camera_to_base=self._camera_to_base)
        base = self._robot.config.base_frame
        return [
            TransformMessage(
                source_frame=base, destination_frame=BASE_FOOTPRINT, matrix=pose.transform_base_to_footprint
            ),
            *self.moving(stance.joint_positions),
        ]

    def _between_links(self, joint_positions: Mapping[str, float], *, of_fixed_joints: bool) -> list[TransformMessage]:
        state = self._robot.state(joint_positions)

        def to_base(link: str) -> Float:
            if link == self._robot.config.camera_frame:
                return self._camera_to_base
            return state.transform_to_base(link)

        return [
            TransformMessage(
                source_frame=joint.child,
                destination_frame=joint.parent,
                matrix=np.linalg.inv(to_base(joint.parent)) @ to_base(joint.child),
            )
            for joint in self._robot.tree.urdf.joints
            if (joint.kind == "fixed") == of_fixed_joints
        ]
