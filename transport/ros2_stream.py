"""StanceStream batches from ROS 2: joints from JointState, gravity and angular velocity from Imu (`sensor_msgs`)."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from transport.exceptions import MessageError
from transport.links.ordered_receiver import OrderedReceiver
from transport.links.ros2 import data_key
from transport.links.session import Session
from transport.messages.codec import decode
from transport.messages.stance_stream import ANY_WALK, MAXIMUM_BATCH, StanceStream, gravity_of_orientation
from transport.stance_stream_link import NOT_MEASURED, Batcher, JointSample

JOINT_STATE, IMU = "sensor_msgs/msg/JointState", "sensor_msgs/msg/Imu"
# Largest time difference between an IMU sample and the joint sample with which it is combined [ns].
SAME_INSTANT = 20_000_000


@dataclass(frozen=True, slots=True)
class JointState:
    """Stamp [ns] and joint positions [rad or m] of a `sensor_msgs/JointState`."""

    stamp: int
    positions: Mapping[str, float]


def decode_joint_state(payload: bytes) -> JointState:
    """Decode stamp, names and positions of a JointState in CDR.

    Velocities and efforts are not decoded: they are often empty, and writers pad an empty list of numbers in different
    ways.

    Raises:
        MessageError: the payload is truncated, too long or damaged, or the numbers of names and positions differ.
    """
    if len(payload) > MAXIMUM_BATCH:
        raise MessageError(f"JointState of {len(payload)} bytes; allowed: up to {MAXIMUM_BATCH} bytes")
    order, at = "<" if payload[1:2] == b"\x01" else ">", 4

    def take(form: str, size: int, count: int = 1) -> tuple[Any, ...]:
        nonlocal at
        # Numbers are aligned to multiples of their size, measured from the end of the 4-byte header.
        at += -(at - 4) % size
        found = struct.unpack_from(f"{order}{count}{form}", payload, at)
        at += count * size
        return found

    def text() -> str:
        (length,) = take("I", 4)
        (written,) = take("s", 1, length)
        return str(written.rstrip(b"\0").decode())

    try:
        (sec,), (nanosec,), _ = take("i", 4), take("I", 4), text()
        names = [text() for _ in range(min(take("I", 4)[0], len(payload)))]
        (count,) = take("I", 4)
        positions = take("d", 8, count) if count else ()
        return JointState(sec * 10**9 + nanosec, dict(zip(names, positions, strict=True)))
    except (struct.error, ValueError, MemoryError) as error:
        raise MessageError(f"{len(payload)} bytes are not a sensor_msgs/msg/JointState: {error}") from error


class Ros2Stream:
    """Receiver of `/<robot>/joint_states` and `/<robot>/imu` that converts their messages to StanceStream batches.

    JointState contains neither the support feet nor the walk. Every leg is therefore marked as supporting, which
    leaves the choice to the support feet announced at BEGIN, and the epoch is ANY_WALK, which assigns the samples to
    the current walk. Both topics must be stamped by the clock that stamps the pauses.
    """

    def __init__(
        self,
        session: Session,
        on_batch: Callable[[StanceStream], None],
        on_refused: Callable[[MessageError], None],
        *,
        robot: str,
        domain: int,
        joints: Sequence[str],
        legs: Sequence[str],
        rotation_imu_to_base: npt.ArrayLike | None = None,
    ) -> None:
        """Subscribe to the topics.

        Args:
            session: open session.
            on_batch: called with each batch, on a separate thread.
            on_refused: called with the error when a message cannot be used.
            robot: instance name.
            domain: ROS 2 domain.
            joints: names of the joints that each JointState must contain.
            legs: names of the legs.
            rotation_imu_to_base: (3, 3) rotation from the IMU's frame to `base_link`; None = the robot has no IMU, and
                Imu is not received.
        """
        self._joints, self._legs, self._batcher = tuple(joints), tuple(legs), Batcher(robot, legs)
        self._on_batch, self._on_refused = on_batch, on_refused
        self._turn = np.eye(3) if rotation_imu_to_base is None else np.asarray(rotation_imu_to_base, np.float64)
        # Stamp, gravity and angular velocity of the last IMU sample.
        self._imu: tuple[int, Sequence[float], Sequence[float]] = 0, NOT_MEASURED, NOT_MEASURED
        key = data_key(domain, f"{robot}/joint_states", JOINT_STATE)
        OrderedReceiver[JointState](session, key, decode_joint_state, self._on_joints, on_refused, latched=False)
        if rotation_imu_to_base is not None:
            key, read_imu = data_key(domain, f"{robot}/imu", IMU), partial(decode, type_name=IMU)
            OrderedReceiver[Any](session, key, read_imu, self._on_imu, on_refused, latched=False)

    def _on_joints(self, message: JointState) -> None:
        stamp, found = message.stamp, message.positions
        if missing := [name for name in self._joints if name not in found]:
            self._on_refused(
                MessageError(
                    f"JointState lacks {len(missing)} of {len(self._joints)} joints ({', '.join(missing[:4])}"
                    f"{', ...' * (len(missing) > 4)}); required: all movable joints of the URDF"
                )
            )
            return
        read, gravity, turning = self._imu
        if abs(stamp - read) > SAME_INSTANT:
            gravity = turning = NOT_MEASURED
        joints = {name: found[name] for name in self._joints}
        try:
            batch = self._batcher.add(JointSample(stamp, joints, self._legs, gravity, turning), ANY_WALK)
        except MessageError as error:
            self._on_refused(error)
            return
        if batch is not None:
            self._on_batch(batch)

    def _on_imu(self, message: Any) -> None:
        """Store the angular velocity, and gravity from a valid orientation or, without one, from the acceleration."""
        q, a, w = message.orientation, message.linear_acceleration, message.angular_velocity
        gravity: Sequence[float] = NOT_MEASURED
        length = math.hypot(q.x, q.y, q.z, q.w)
        if message.orientation_covariance[0] >= 0.0 and abs(length - 1.0) < 0.01:
            gravity = gravity_of_orientation((q.x / length, q.y / length, q.z / length, q.w / length))
        elif message.linear_acceleration_covariance[0] >= 0.0 and (a.x, a.y, a.z) != (0.0, 0.0, 0.0):
            gravity = (-a.x, -a.y, -a.z)
        gravity = (self._turn @ gravity).tolist()
        time = message.header.stamp
        self._imu = int(time.sec) * 10**9 + int(time.nanosec), gravity, (self._turn @ (w.x, w.y, w.z)).tolist()
