"""Joints checked against ground that the gait declares at the first pause of a walk."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest

from guara_perception.app.node.consistency import JointWatch
from guara_perception.app.node.node_status import NodeStatus
from guara_perception.app.node.pause import Pause
from kinematics import RobotModel, Stance
from testbed.misread_joints import ERROR, misread, walk


@pytest.mark.slow
def test_declared_ground_is_held_against_the_joints(robot: RobotModel) -> None:
    """Without an IMU, a wrong knee zero is found within a cycle if the gait declared the ground, and otherwise not."""
    wrong, pauses = "rf_kfe_joint", walk(robot, 5, 100, has_imu=False)

    def told(**changed: Any) -> tuple[str, ...]:
        watch = JointWatch(robot, NodeStatus())
        for pause in pauses:
            stance = misread(pause.stance, wrong, ERROR)
            given = {"epoch": "a", "step": pause.step, "stance": stance, "known_ground": pause.known_ground, **changed}
            doubts = watch.doubts(cast(Pause, SimpleNamespace(**given)))
        return doubts

    (doubt,) = told()
    assert wrong in doubt and "zero error" in doubt
    assert told(known_ground=()) == ()


def test_declared_ground_below_two_feet_is_not_compared(robot: RobotModel) -> None:
    """Without an IMU, the pose on two feet is not known from a single pause."""
    pause = next(iter(walk(robot, 1, 1, has_imu=False)))
    assert pause.known_ground
    stance = Stance(pause.stance.joint_positions, ("lf", "rh"))
    given = {"epoch": "a", "step": 0, "stance": stance, "known_ground": pause.known_ground}
    assert JointWatch(robot, NodeStatus()).doubts(cast(Pause, SimpleNamespace(**given))) == ()
