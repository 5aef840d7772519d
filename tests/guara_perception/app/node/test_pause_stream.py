"""Stream of a pause: which pauses use one, which frames it confirms, and how it dates flashes."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from drivers import AcquireOptions, Camera, CameraSettings, timing
from drivers.emulator import EmulatedClock
from drivers.sweep.options import SweepOptions
from guara_perception.app.node import pause_stream
from guara_perception.app.node.pause import Pause
from guara_perception.app.node.pause_stream import PauseStream
from guara_perception.app.node.rangefinder import LAG_SIGMA, Rangefinder
from guara_perception.app.node.stream_watch import StreamWatch
from kinematics import RobotModel, Stance, StanceError, Stillness
from kinematics.body_track import HALF_WINDOW, MOST_TIME_SIGMA
from tests.guara_perception.app.node.test_stream_watch import Watched
from transport import StanceStream
from transport.messages.stance_stream import ANY_WALK
from transport.queries.remote_clock import ClockBound
from transport.stance_link import GaitClock

BEGIN = 10**18 + 100 * 10**9


class Clock:
    """The gait's clock as known to the node: 1e9 s ahead, within `doubt` either way."""

    def __init__(self, doubt: float = 0.0, known_after: int = 0) -> None:
        self._bound = ClockBound(1e9 + 100.0, 100.0 - doubt, 100.0 + doubt)
        self._unknown, self.waited = known_after, 0

    def at(self, time: float) -> tuple[float, float] | None:
        return None if self.waited < self._unknown else self._bound.at(time)

    def wait(self, timeout: float) -> None:
        self.waited += 1

    def earliest(self, stamp: int) -> float | None:
        return self._bound.earliest(stamp * 1e-9)


def stance_of(robot: RobotModel) -> Stance:
    return Stance(robot.posture("scan"), robot.legs, None)


def stream_of(robot: RobotModel, clock: Clock | None = None, epoch: str = "") -> PauseStream:
    return PauseStream(robot, stance_of(robot), BEGIN, cast(GaitClock, clock or Clock()), epoch=epoch)


def watch_of(robot: RobotModel, monkeypatch: pytest.MonkeyPatch) -> Watched:
    """StreamWatch with a stopped clock, also for its streams."""
    watched = Watched(robot, monkeypatch)
    monkeypatch.setattr(pause_stream.clock, "now", lambda: watched.now)
    return watched


def test_a_pause_follows_a_stream_that_is_there_when_it_begins(
    robot: RobotModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the samples of the last second; a stream of another walk, a slow one and a silent one are not used."""
    watched = watch_of(robot, monkeypatch)
    watch: StreamWatch = watched.watch
    assert watch.begin(lambda: stream_of(robot), "") is None
    for _ in range(60):
        watch.add(watched.batch())
    assert watch.begin(lambda: stream_of(robot), "another walk") is None
    stream = watch.begin(lambda: stream_of(robot), "")
    assert stream is not None
    begun = watched.now - 100.0
    assert stream.track.latest == pytest.approx(begun - 0.005)
    assert stream.track.longest_gap(begun - 0.85, begun - 0.1) == pytest.approx(0.005)
    watch.add(watched.batch())
    assert stream.track.latest == pytest.approx(begun + 0.015)
    after = watch.begin(lambda: stream_of(robot), "")
    watch.add(watched.batch())
    assert after is not None and after.track.latest > stream.track.latest == pytest.approx(begun + 0.015)

    def refuse() -> PauseStream:
        raise StanceError("two feet")

    assert watch.begin(refuse, "") is None
    watched.now += 0.3
    assert watch.begin(lambda: stream_of(robot), "") is None
    for _ in range(60):
        watch.add(watched.batch(1, 20.0))
    assert watch.begin(lambda: stream_of(robot), "") is None


def test_a_stream_that_knows_of_no_walks_is_of_the_one_that_begins(
    robot: RobotModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    watched = watch_of(robot, monkeypatch)
    for _ in range(60):
        watched.watch.add(replace(watched.batch(), epoch=ANY_WALK))
    assert watched.watch.begin(lambda: stream_of(robot, epoch="walk"), "walk") is not None


def test_samples_of_another_walk_or_of_the_past_are_left_out_and_joints_are_put_in_order(
    robot: RobotModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    watched = watch_of(robot, monkeypatch)
    stream = stream_of(robot)
    assert stream.shown[1] == -math.inf
    one, two = watched.batch(), watched.batch()
    posture = np.array([robot.posture("scan")[name] for name in robot.tree.joint_names])
    names = one.joint_names[::-1]
    turned = StanceStream(
        robot="guara",
        stamp=one.stamp,
        sequence=1,
        joint_names=names,
        legs=one.legs[::-1],
        times=one.times,
        joint_positions=np.asarray(one.joint_positions)[:, ::-1],
        supports=np.array([[1, 0, 1, 1]] * 4),
    )
    stream.add(turned)
    stream.add(two)
    stream.add(turned)
    rows = stream.track._rows[: stream.track._end]
    assert len(rows) == 8 and np.abs(rows[:, 1:-4] - posture).max() < 0.01
    np.testing.assert_array_equal(rows[0, -4:], [1, 1, 0, 1])
    of_walk = stream_of(robot, epoch="walk")
    of_walk.add(one)
    assert of_walk.track.latest == -math.inf
    of_walk.add(replace(one, epoch=ANY_WALK))
    assert of_walk.track.latest == pytest.approx((one.stamps[-1] - BEGIN) * 1e-9)
    stamp, heard = stream.shown
    assert stamp == two.stamps[-1] - round(1e9 * HALF_WINDOW) and heard == watched.now


def test_an_instant_is_told_by_the_gaits_clock_with_what_is_not_known_of_it(robot: RobotModel) -> None:
    """In whole nanoseconds, as they are recorded."""
    stream = stream_of(robot, Clock(doubt=0.006))
    instant, sigma = stream.instant(101.25, 0.002)
    assert instant == pytest.approx(1.25, abs=1e-6) and round(instant * 1e9) * 1e-9 == instant
    assert sigma == pytest.approx(math.hypot(0.002, (0.006 + 0.00125) / math.sqrt(3.0)), abs=1e-9)
    record = stream.record((instant, sigma))
    assert record is not None and record.begin == BEGIN
    assert ((record.stamp - record.begin) * 1e-9, record.sigma * 1e-9) == (instant, sigma)
    assert stream.record(None) is None
    unknown = stream_of(robot, Clock(known_after=1)).instant(101.0, 0.002)
    assert math.isnan(unknown[0])


def test_where_instants_are_in_doubt_the_stream_is_not_used(robot: RobotModel, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pause_stream.clock, "now", lambda: 100.0)
    assert stream_of(robot, Clock(known_after=1)).doubt((100.0, 0.002)) == ""
    assert "does not report its clock" in stream_of(robot, Clock(known_after=2)).doubt((100.0, 0.002))
    assert "lag is not known" in stream_of(robot).doubt(None)
    text = stream_of(robot, Clock(doubt=0.05)).doubt((100.0, 0.002))
    assert f"sigma of flash times is 29 ms; allowed: up to {1e3 * MOST_TIME_SIGMA:.0f} ms" in text


class Readings:
    """Readings of a body that moved."""

    motion, still_until, undetectable = "the camera moved", -math.inf, ""

    def add(self, time: float, stance: Stance) -> None:
        """Add a reading."""


def test_a_pause_with_a_stream_is_confirmed_by_its_samples_although_the_body_moves(robot: RobotModel) -> None:
    """Until the stream is abandoned: then the readings decide, including earlier ones."""
    clock = Clock()
    shown = [(BEGIN, -math.inf)]
    stream = cast(PauseStream, SimpleNamespace(shown=shown[0]))
    pause = Pause(
        step=0,
        epoch="walk",
        stance=stance_of(robot),
        stillness=cast(Stillness, Readings()),
        earliest=clock.earliest,
        limits=robot.pause_limits,
        begun=100.0,
        stamp=BEGIN,
        stream=stream,
    )
    pause.hold(stance_of(robot), 101.0, BEGIN + 10**9)
    assert not pause.broken and pause.still_until == -math.inf
    stream.shown = (BEGIN + 2 * 10**9, 102.1)  # type: ignore[misc]
    assert pause.still_until == pytest.approx(102.0, abs=0.003)
    stream.shown = (BEGIN + 3 * 10**9, 102.1)  # type: ignore[misc]
    assert pause.still_until == -math.inf, "samples of the future"
    pause.leave_stream()
    assert pause.moved and pause.broken == "the camera moved" and pause.ended.is_set()
    assert pause.still_until == pytest.approx(100.0, abs=0.003)


def test_the_middle_of_the_light_is_told_by_stamp_lag_and_exposure() -> None:
    camera = cast(Camera, SimpleNamespace(lag=None))
    rangefinder = Rangefinder(board=cast(object, None), camera=camera)  # type: ignore[arg-type]
    assert rangefinder.flash(10.0) is None
    camera.lag = 0.04
    middle, sigma = rangefinder.flash(10.0) or (0.0, 0.0)
    assert middle == pytest.approx(9.98) and sigma == pytest.approx(math.hypot(0.04 / math.sqrt(12.0), LAG_SIGMA))
    rangefinder._locked = CameraSettings(exposure=0.01)
    assert rangefinder.flash(10.0) == (pytest.approx(9.965), LAG_SIGMA)
    rangefinder.options = AcquireOptions(sweep=SweepOptions(flash=0.004))
    assert rangefinder.flash(10.0) == (pytest.approx(9.962), LAG_SIGMA)


def test_an_emulated_clock_catches_up_with_the_machines_and_never_goes_back(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = EmulatedClock(1000.0)
    rangefinder = Rangefinder(board=cast(object, None), camera=cast(Camera, None), clock=clock)  # type: ignore[arg-type]
    for machine, shown in ((1234.0, 1234.0), (1100.0, 1234.0)):
        monkeypatch.setattr(timing.time, "monotonic", lambda machine=machine: machine)
        rangefinder.keep_time()
        assert clock.monotonic() == shown
