"""JointState and Imu as rclpy writes them, sent on the keys of rmw_zenoh: the node's stream of joints."""

from __future__ import annotations

import json
import subprocess
import threading
from pathlib import Path

import numpy as np
import pytest

import transport
from tests.interop.ros_environment import environment
from transport import MessageError, StanceStream
from transport.links.ros2 import data_key
from transport.messages.typestore import type_hash
from transport.ros2_stream import IMU, JOINT_STATE, Ros2Stream

pytestmark = pytest.mark.heavy
WRITE = """
import json, sys
from rclpy.serialization import serialize_message
from sensor_msgs.msg import Imu, JointState
imu = Imu()
imu.header.stamp.sec, imu.header.frame_id = 1700000000, "imu_link"
imu.orientation_covariance[0] = -1.0
imu.linear_acceleration.x, imu.linear_acceleration.z = 1.0, 9.7
made = [["imu", serialize_message(imu).hex()]]
for number in range(9):
    state = JointState(name=["hip", "knee"], position=[0.25, float(number)], velocity=[1.0, 2.0])
    state.header.stamp.sec, state.header.stamp.nanosec = 1700000000, 4_000_000 * number
    made.append(["joint_states", serialize_message(state).hex()])
print(json.dumps(made))
"""


def test_what_rclpy_writes_is_the_stream(ros: Path, free_endpoint: str) -> None:
    """Real rosidl and Fast-CDR: joints by name, stamps, gravity by the acceleration."""
    command = [str(ros / "bin" / "python"), "-c", WRITE]
    done = subprocess.run(command, env=environment(ros), capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    batches, refused, changed = list[StanceStream](), list[MessageError](), threading.Condition()

    def take(batch: StanceStream) -> None:
        with changed:
            batches.append(batch)
            changed.notify_all()

    kinds = {"imu": IMU, "joint_states": JOINT_STATE}
    with transport.open_node(listen=free_endpoint) as node, transport.open_client(free_endpoint) as client:
        names = {"joints": ("knee", "hip"), "legs": ("a", "b", "c", "d"), "robot": "guara"}
        stream = Ros2Stream(node, take, refused.append, domain=0, rotation_imu_to_base=np.eye(3), **names)
        (_, imu), *states = json.loads(done.stdout)
        while not stream._imu[0]:
            client.raw.put(data_key(0, "guara/imu", IMU), bytes.fromhex(imu))
        for topic, payload in states:
            client.raw.put(data_key(0, f"guara/{topic}", kinds[topic]), bytes.fromhex(payload))
        with changed:
            assert changed.wait_for(lambda: batches, 30.0)
    (batch, *_) = batches
    assert not refused and batch.stamp == 1_700_000_000 * 10**9
    np.testing.assert_allclose(batch.times, np.arange(5) * 0.004, atol=1e-9)
    np.testing.assert_array_equal(batch.joint_positions, [[number, 0.25] for number in range(5)])
    np.testing.assert_array_equal(batch.gravity_in_base, [[-1.0, 0.0, -9.7]] * 5)


def test_rosidl_computes_the_same_hash_for_joints_and_imu(ros: Path) -> None:
    """Which is part of the keys."""
    for kind in (JOINT_STATE, IMU):
        package, _, name = kind.split("/")
        table = json.loads((ros / "share" / package / "msg" / f"{name}.json").read_text())["type_hashes"]
        assert next(item["hash_string"] for item in table if item["type_name"] == kind) == type_hash(kind)
