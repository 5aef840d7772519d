"""Joint stream of the gait in the node's status."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from guara_perception.app.node import stream_watch
from guara_perception.app.node.stream_watch import StreamWatch
from kinematics import RobotModel
from transport import Health, MessageError, StanceStream


class Watched:
    """StreamWatch with a clock that the test sets."""

    def __init__(self, robot: RobotModel, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now, self._robot, self._sequence = 100.0, robot, 0
        monkeypatch.setattr(stream_watch.clock, "now", lambda: self.now)
        self.watch = StreamWatch(robot, "guara")
        self._rng = np.random.default_rng(0)

    def batch(self, samples: int = 4, rate: float = 200.0) -> StanceStream:
        """Next batch of a standing robot with noise; it arrives when its last sample has been read."""
        posture = self._robot.posture("scan")
        noise = self._rng.normal(0.0, 1e-3, (samples, len(posture)))
        start, self.now = self.now, self.now + samples / rate
        self._sequence += 1
        return StanceStream(
            robot="guara",
            stamp=10**18 + round(start * 1e9),
            sequence=self._sequence,
            joint_names=tuple(posture),
            legs=self._robot.legs,
            times=np.arange(samples) / rate,
            joint_positions=np.array(list(posture.values())) + noise,
            supports=np.ones((samples, len(self._robot.legs))),
        )

    @property
    def said(self) -> tuple[Health, str]:
        item = self.watch.item()
        return item.level, item.message


@pytest.fixture
def watched(robot: RobotModel, monkeypatch: pytest.MonkeyPatch) -> Watched:
    return Watched(robot, monkeypatch)


def test_a_gait_without_a_stream_is_well(watched: Watched) -> None:
    level, message = watched.said
    assert level is Health.OK and "sends no joint stream" in message


def test_the_rate_is_told_and_one_that_is_of_no_use_is_a_warning(watched: Watched) -> None:
    assert all(watched.watch.add(watched.batch()) for _ in range(60))
    assert watched.said == (Health.OK, "200 samples a second")
    for _ in range(60):
        watched.watch.add(watched.batch(1, 20.0))
    level, message = watched.said
    assert level is Health.WARN and "20 samples a second; allowed: 50 to 1000" in message
    watched.now += 5.0
    assert watched.said == (Health.WARN, "no sample for 5.0 s")
    watched.now += 6.0
    assert watched.said[0] is Health.OK


def test_a_hole_and_a_silence_are_gaps_that_are_told(watched: Watched) -> None:
    watched.watch.add(watched.batch())
    watched.batch()
    watched.watch.add(watched.batch())
    assert watched.said == (Health.WARN, "joint stream: 1 batch was lost")
    watched.now += 0.3
    watched.watch.add(watched.batch())
    assert watched.said == (Health.WARN, "joint stream: 0.30 s without a sample")
    watched.now -= 1.0
    watched.watch.add(watched.batch())
    assert "stamps did not increase" in watched.said[1]
    for _ in range(600):
        watched.watch.add(watched.batch())
    assert watched.said == (Health.OK, "200 samples a second")
    assert watched.watch.item().values["gaps"] == "3" and watched.watch.item().values["lost_batches"] == "1"


def test_a_flood_is_dropped_and_told(watched: Watched) -> None:
    """Of ten thousand samples a second, about one in ten is accepted."""
    taken = [watched.watch.add(watched.batch(100, 10_000.0)) for _ in range(300)]
    level, message = watched.said
    assert level is Health.WARN and "more than 1000 samples a second: batches are dropped" in message
    assert 0.05 < np.mean(taken[100:]) < 0.2


def test_what_is_not_of_this_robot_is_refused_and_told(watched: Watched) -> None:
    batch = watched.batch()
    names = ("no_joint", *batch.joint_names[1:])
    for wrong, text in (
        (replace(batch, robot="lobo"), "of robot 'lobo' arrived on the key of 'guara'"),
        (replace(batch, joint_names=names), "no_joint"),
        (replace(batch, legs=("arm", *batch.legs[1:])), "arm"),
    ):
        assert not watched.watch.add(wrong)
        assert text in watched.said[1]
    watched.watch.refuse(MessageError("3 bytes are none"))
    assert watched.said == (Health.WARN, "3 bytes are none")
    assert watched.watch.item().values["refused"] == "4"
