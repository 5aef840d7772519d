"""When a pause ends by itself, and what its HOLDs confirm; no clock runs here."""

import math

import pytest

from guara_perception.app.node.pause import Pause
from kinematics import RobotModel, Stance

LIMIT = 30.0


@pytest.fixture
def stance(robot: RobotModel) -> Stance:
    return Stance(dict.fromkeys(robot.joint_names, 0.0), tuple(robot.legs))


def _pause(stance: Stance, time_available: float = 0.0) -> Pause:
    return Pause(
        step=0,
        epoch="walk",
        stance=stance,
        check=lambda begin, now: None,
        begun=100.0,
        limit=LIMIT,
        time_available=time_available,
    )


def test_a_pause_of_unknown_length_ends_after_the_last_announcement_of_the_gait(
    stance: Stance, robot: RobotModel
) -> None:
    """30 s after BEGIN, or after the last HOLD; that is the limit of robot.toml."""
    assert robot.pause_limits.time_limit == LIMIT
    pause = _pause(stance)
    pause.hold(stance, 120.0, 20_000_000_000, 0.0)
    pause.expire(149.9)
    assert not pause.ended.is_set() and pause.time_left(149.9) == pytest.approx(0.1)
    pause.expire(150.1)
    assert pause.ended.is_set() and "had no END within its time of 50 s" in pause.broken


def test_a_pause_of_known_length_is_not_made_longer_by_a_hold_without_a_time(stance: Stance) -> None:
    """It ends after its 2 s, unless a HOLD says how much time is left."""
    pause = _pause(stance, time_available=2.0)
    pause.hold(stance, 101.0, 1_000_000_000, 0.0)
    assert pause.time_left(101.0) == pytest.approx(1.0)
    pause.hold(stance, 101.5, 1_500_000_000, 5.0)
    pause.expire(106.4)
    assert not pause.ended.is_set()
    pause.expire(106.6)
    assert pause.ended.is_set() and not pause.moved


def test_joints_of_the_future_confirm_no_more_than_now(stance: Stance) -> None:
    """A gait whose stamps run ahead cannot confirm frames that are not taken yet."""
    pause = _pause(stance)
    pause.hold(stance, 101.0, 10**18, 0.0)
    assert pause.still_until == 101.0
    pause.hold(stance, 103.0, 2_000_000_000, 0.0)
    assert pause.still_until == pytest.approx(102.0)
    pause.end(stance)
    assert pause.still_until == math.inf
