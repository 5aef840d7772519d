"""The shared submessages (stance, transform, outlines) as ROS 2 message objects, and back."""

from __future__ import annotations

from typing import Any

import numpy as np

from transport.arrays import Float
from transport.exceptions import MessageError
from transport.messages.rotation import matrix_from_quaternion, quaternion_from_matrix
from transport.messages.submessages import GroundPatch, ObstacleMessage, Point, StanceMessage, TransformMessage
from transport.messages.typestore import message_class


def make_point(x: float, y: float, z: float) -> Any:
    """A geometry_msgs/Point."""
    return message_class("geometry_msgs/msg/Point")(float(x), float(y), float(z))


def make_outline(outline: Float) -> list[Any]:
    """A list of geometry_msgs/Point from (n, 2) corners, z = 0."""
    return [make_point(x, y, 0.0) for x, y in outline.tolist()]


def read_outline(points: list[Any]) -> Float:
    """(n, 2) corners from a list of geometry_msgs/Point."""
    return np.array([(point.x, point.y) for point in points], dtype=np.float64).reshape(-1, 2)


def make_stance(stance: StanceMessage) -> Any:
    """A guara_msgs/Stance."""
    gravity = stance.gravity_in_base
    vector = message_class("geometry_msgs/msg/Vector3")(*(gravity or (0.0, 0.0, 0.0)))
    positions = np.array(list(stance.joint_positions.values()), dtype=np.float64)
    return message_class("guara_msgs/msg/Stance")(
        list(stance.joint_positions), positions, list(stance.support_feet), gravity is not None, vector
    )


def read_stance(message: Any) -> StanceMessage:
    """A StanceMessage from a guara_msgs/Stance.

    Raises:
        MessageError: names and positions differ in number, a name comes twice, or a number is not finite.
    """
    names, positions = message.joint_names, message.joint_positions.tolist()
    if len(names) != len(positions):
        raise MessageError(f"stance has {len(names)} joint names but {len(positions)} positions")
    if len(set(names)) != len(names):
        raise MessageError(f"stance names a joint twice: {', '.join(names)}")
    vector = message.gravity_in_base
    gravity: Point | None = (vector.x, vector.y, vector.z) if message.gravity_known else None
    return StanceMessage(
        joint_positions=dict(zip(names, positions, strict=True)),
        support_feet=tuple(message.support_feet),
        gravity_in_base=gravity,
    )


def make_transform(transform: TransformMessage) -> Any:
    """A guara_msgs/FrameTransform."""
    x, y, z, w = quaternion_from_matrix(transform.matrix[:3, :3])
    translation = message_class("geometry_msgs/msg/Vector3")(*transform.matrix[:3, 3].tolist())
    rotation = message_class("geometry_msgs/msg/Quaternion")(x, y, z, w)
    covariance = np.zeros(0) if transform.covariance is None else transform.covariance.ravel()
    return message_class("guara_msgs/msg/FrameTransform")(
        transform.source_frame,
        transform.destination_frame,
        message_class("geometry_msgs/msg/Transform")(translation, rotation),
        covariance,
    )


def read_transform(message: Any) -> TransformMessage:
    """A TransformMessage from a guara_msgs/FrameTransform.

    Raises:
        MessageError: no unit quaternion, a covariance of another length than 0 or 36, or numbers not finite.
    """
    name = f"transform_{message.source_frame}_to_{message.destination_frame}"
    rotation, translation = message.transform.rotation, message.transform.translation
    matrix = np.eye(4)
    matrix[:3, :3] = matrix_from_quaternion((rotation.x, rotation.y, rotation.z, rotation.w), name)
    matrix[:3, 3] = translation.x, translation.y, translation.z
    if len(message.covariance) not in (0, 36):
        raise MessageError(f"covariance of {name} has {len(message.covariance)} numbers; allowed: 0 or 36")
    return TransformMessage(
        source_frame=message.source_frame,
        destination_frame=message.destination_frame,
        matrix=matrix,
        covariance=message.covariance.reshape(6, 6) if len(message.covariance) else None,
    )


def make_obstacle(obstacle: ObstacleMessage) -> Any:
    """A guara_msgs/Obstacle."""
    return message_class("guara_msgs/msg/Obstacle")(
        make_outline(obstacle.outline),
        obstacle.height,
        make_point(*obstacle.position),
        obstacle.sigma,
        obstacle.hazard,
    )


def read_obstacle(message: Any) -> ObstacleMessage:
    """An ObstacleMessage from a guara_msgs/Obstacle.

    Raises:
        MessageError: a number is not finite.
    """
    return ObstacleMessage(
        outline=read_outline(message.outline),
        height=message.height,
        position=(message.position.x, message.position.y, message.position.z),
        sigma=message.sigma,
        hazard=message.hazard,
    )


def make_ground(patch: GroundPatch) -> Any:
    """A guara_msgs/GroundPatch."""
    return message_class("guara_msgs/msg/GroundPatch")(make_outline(patch.outline), patch.height, patch.sigma)


def read_ground(message: Any) -> GroundPatch:
    """A GroundPatch from a guara_msgs/GroundPatch.

    Raises:
        MessageError: fewer than three corners, or a number is not finite.
    """
    return GroundPatch(outline=read_outline(message.outline), height=message.height, sigma=message.sigma)
