"""Joints and gravity of ROS 2 as the gait's stream: names, frames, what is missing, and refusals."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import transport
from transport import MessageError, StanceStream
from transport.links.ros2 import data_key
from transport.messages.codec import encode
from transport.messages.typestore import QUATERNION, make_message
from transport.ros2_stream import IMU, JOINT_STATE, Ros2Stream, decode_joint_state

JOINTS, LEGS = ("a", "b", "c"), ("l", "r")
START, PERIOD = 1_700_000_000_000_000_000, 5_000_000
# The IMU is mounted with its z axis along y of the body.
MOUNT = Rotation.from_euler("x", -90, degrees=True).as_matrix()


def header(stamp: int) -> Any:
    time = make_message("builtin_interfaces/msg/Time", sec=stamp // 10**9, nanosec=stamp % 10**9)
    return make_message("std_msgs/msg/Header", stamp=time)


def joint_state(stamp: int, names: tuple[str, ...] = ("c", "x", "a", "b")) -> Any:
    """Joints in another order and with one more; each has the value of its letter."""
    values = np.array([float(ord(name)) for name in names])
    return make_message(JOINT_STATE, header=header(stamp), name=list(names), position=values)


def imu(stamp: int, turn: Rotation, *, has_orientation: bool, length: float = 1.0) -> Any:
    """Imu message of a body at rest in this orientation, whose quaternion has the given length."""
    x, y, z, w = length * turn.as_quat()
    covariance = np.zeros(9)
    covariance[0] = 0.0 if has_orientation else -1.0
    up = turn.inv().apply([0.0, 0.0, 9.81])
    return make_message(
        IMU,
        header=header(stamp),
        orientation=make_message(QUATERNION, x=x, y=y, z=z, w=w),
        orientation_covariance=covariance,
        linear_acceleration=make_message("geometry_msgs/msg/Vector3", **dict(zip("xyz", up, strict=True))),
        angular_velocity=make_message("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.5),
    )


class Bridged:
    """A bridge, and a ROS 2 node that sends to it."""

    def __init__(self, node: transport.Session, ros: transport.Session, rotation: np.ndarray | None) -> None:
        self.batches: list[StanceStream] = []
        self.refused: list[MessageError] = []
        self._ros, self._changed = ros, threading.Condition()
        names = {"joints": JOINTS, "legs": LEGS, "robot": "guara"}
        self.stream = Ros2Stream(node, self._take, self._refuse, domain=4, rotation_imu_to_base=rotation, **names)

    def _take(self, batch: StanceStream) -> None:
        with self._changed:
            self.batches.append(batch)
            self._changed.notify_all()

    def _refuse(self, error: MessageError) -> None:
        with self._changed:
            self.refused.append(error)
            self._changed.notify_all()

    def send(self, topic: str, kind: str, message: Any) -> None:
        self._ros.raw.put(data_key(4, f"guara/{topic}", kind), bytes(encode(message)))

    def wait(self, batches: int = 0, refused: int = 0) -> None:
        with self._changed:
            assert self._changed.wait_for(lambda: len(self.batches) >= batches and len(self.refused) >= refused, 30.0)


@pytest.mark.slow
def test_joint_states_become_batches_of_the_stream(endpoint: str) -> None:
    """In the robot's order, 20 ms long, one after the other, with all legs down and no gravity."""
    with transport.open_node(listen=endpoint) as node, transport.open_client(endpoint) as ros:
        bridged = Bridged(node, ros, None)
        for number in range(9):
            bridged.send("joint_states", JOINT_STATE, joint_state(START + number * PERIOD))
        bridged.wait(batches=2)
        first, second = bridged.batches
        assert (first.sequence, second.sequence, first.epoch) == (0, 1, "*")
        assert first.stamp == START and second.stamp == START + 4 * PERIOD
        np.testing.assert_allclose(first.times, np.arange(4) * 0.005, atol=1e-9)
        assert first.joint_names == JOINTS
        np.testing.assert_array_equal(first.joint_positions, [[97.0, 98.0, 99.0]] * 4)
        assert np.asarray(first.supports).all() and first.gravity_in_base is None and first.angular_velocity is None
        bridged.send("joint_states", JOINT_STATE, joint_state(START))
        bridged.send("joint_states", JOINT_STATE, joint_state(START + 10 * PERIOD, ("a", "c")))
        bridged.wait(refused=2)
        assert "later than the previous one" in str(bridged.refused[0])
        assert "JointState lacks 1 of 3 joints (b); required" in str(bridged.refused[1])
        assert len(bridged.batches) == 2


@pytest.mark.slow
@pytest.mark.parametrize(("has_orientation", "length"), [(True, 1.0), (True, 1.009), (False, 1.0)])
def test_gravity_is_that_of_the_body(endpoint: str, has_orientation: bool, length: float) -> None:
    """By orientation or by acceleration, turned from the IMU's frame; none when the IMU is silent."""
    leaning = Rotation.from_euler("xyz", [10, -7, 50], degrees=True)
    down = leaning.inv().apply([0.0, 0.0, -1.0])
    with transport.open_node(listen=endpoint) as node, transport.open_client(endpoint) as ros:
        bridged = Bridged(node, ros, MOUNT)
        # base -> world is leaning, imu -> base is MOUNT.
        turn = leaning * Rotation.from_matrix(MOUNT)
        message = imu(START, turn, has_orientation=has_orientation, length=length)
        while bridged.stream._imu[0] != START:
            # The two topics come on threads of their own.
            bridged.send("imu", IMU, message)
        for number in range(14):
            bridged.send("joint_states", JOINT_STATE, joint_state(START + number * PERIOD))
        bridged.wait(batches=3)
        told, *_, silent = bridged.batches
        gravity = np.array(told.gravity_in_base)
        gravity /= np.linalg.norm(gravity, axis=1, keepdims=True)
        np.testing.assert_allclose(gravity, [down] * 4, atol=1e-9)
        np.testing.assert_allclose(told.angular_velocity, [MOUNT @ (0.0, 0.0, 0.5)] * 4, atol=1e-12)
        assert silent.gravity_in_base is None and silent.angular_velocity is None


def test_a_payload_that_is_no_joint_state_is_refused() -> None:
    """Cut anywhere before the end of the positions, counts beyond the payload, more names than positions."""
    whole = bytes(encode(joint_state(START)))
    assert decode_joint_state(whole).positions == {"c": 99.0, "x": 120.0, "a": 97.0, "b": 98.0}
    assert decode_joint_state(whole).stamp == START
    end = whole.index(np.float64(98.0).tobytes()) + 8
    for length in range(end):
        with pytest.raises(MessageError, match="not a sensor_msgs/msg/JointState"):
            decode_joint_state(whole[:length])
    assert decode_joint_state(whole[:end]).stamp == START
    for place in range(12, end - 32):
        try:
            decode_joint_state(whole[:place] + b"\xff\xff\xff\x7f" + whole[place + 4 :])
        except MessageError as error:
            assert "JointState" in str(error)
