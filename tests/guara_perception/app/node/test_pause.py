"""When a pause expires, and which frames its readings confirm; no clock runs in these tests."""

import math
from dataclasses import dataclass, field
from typing import cast

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from guara_perception.app.node.announcements import Walks
from guara_perception.app.node.pause import Pause
from kinematics import RobotModel, Stance, Stillness
from kinematics.robot_settings import PauseLimits
from tests.thorough import examples
from transport import PausePhase, StanceMessage, StancePause
from transport.queries.remote_clock import DRIFT, ClockBound

LIMIT, ARRIVED = 30.0, 100.0
S = 10**9
LIMITS = PauseLimits(0.05, 0.2, 3, 0.0005, 0.001)


@dataclass
class Readings:
    """Readings in which one joint encodes the true position of the camera."""

    motion: str = ""
    still_until: float = -math.inf
    undetectable: str = ""
    heard: list[float] = field(default_factory=list)

    def add(self, time: float, stance: Stance) -> None:
        if stance.joint_positions["camera"]:
            self.motion = "the camera moved"
        else:
            self.still_until = max(self.still_until, time)


def _stance(position: float = 0.0) -> Stance:
    return Stance({"camera": position}, ("lf", "rf", "lh"))


def _pause(time_available: float = 0.0, *, clock: ClockBound | None = None, stamp: int = 0) -> Pause:
    """Pause whose BEGIN arrived at ARRIVED, when the gait's clock shows 0, unless another clock is given."""
    bound = clock or ClockBound(0.0, ARRIVED, ARRIVED)
    return Pause(
        step=0,
        epoch="walk",
        stance=_stance(),
        stillness=cast(Stillness, Readings()),
        earliest=lambda at: bound.earliest(at * 1e-9),
        limits=LIMITS,
        begun=ARRIVED,
        stamp=stamp,
        time_available=time_available,
    )


def test_a_pause_of_unknown_length_ends_after_the_last_announcement_of_the_gait(robot: RobotModel) -> None:
    """It ends 30 s and the grace after BEGIN or the last HOLD, as limited by robot.toml."""
    assert robot.pause_limits.time_limit == LIMIT
    pause = _pause()
    pause.hold(_stance(), 120.0, 20 * S)
    pause.expire(151.9)
    assert not pause.ended.is_set() and pause.time_left(149.9) == pytest.approx(0.1)
    pause.expire(152.1)
    assert pause.ended.is_set() and "no END arrived within the 50 s of the pause and 2 s of grace" in pause.broken


def test_a_pause_of_known_length_is_not_made_longer_by_a_hold_without_a_time() -> None:
    """It ends after its 2 s, unless a HOLD states the remaining time; an older HOLD changes nothing."""
    pause = _pause(2.0)
    pause.hold(_stance(), 101.0, 1 * S)
    assert pause.time_left(101.0) == pytest.approx(1.0)
    pause.hold(_stance(), 101.5, 3 * S // 2, 5.0)
    pause.hold(_stance(), 101.5, 1 * S, 0.1)
    assert pause.planned_end == pytest.approx(106.5, abs=0.01)
    pause.expire(106.5 + 1.2)
    assert not pause.ended.is_set()
    pause.expire(106.5 + 1.3)
    assert pause.ended.is_set() and not pause.moved


@pytest.mark.parametrize(
    ("announced", "late", "is_used"),
    [
        (4.0, 0.02, True),
        (4.0, 0.99, True),
        (4.0, 1.01, False),
        (1.0, 0.49, True),
        (1.0, 0.51, False),
        (20.0, 1.9, 1),
    ],
)
def test_an_end_may_come_a_quarter_of_the_time_too_late(announced: float, late: float, is_used: bool) -> None:
    """The grace is at least half a second and at most two; no frame is taken after the planned end."""
    pause = _pause(announced)
    assert pause.time_left(ARRIVED + announced) == 0.0
    pause.expire(ARRIVED + announced + late)
    if not pause.ended.is_set():
        pause.end(_stance(), ARRIVED + announced + late, round(announced * S))
    assert bool(pause.broken) != is_used
    assert is_used == (pause.still_until > ARRIVED + 0.99 * announced)


@pytest.mark.parametrize("delay", [0.0, 2.0, 3600.0])
def test_a_begin_that_comes_late_moves_no_deadline(delay: float) -> None:
    """The time counts from the stamp: a BEGIN that was delayed for an hour is over on arrival."""
    pause = _pause(4.0, clock=ClockBound(0.0, ARRIVED - delay, ARRIVED - delay))
    assert pause.time_left(ARRIVED) == pytest.approx(max(4.0 - delay, 0.0), abs=0.01)
    without = _pause(4.0)
    without.earliest = lambda stamp: None
    assert without.planned_end == ARRIVED + 4.0


@pytest.mark.parametrize("absurd", [-1.0, math.nan, math.inf, 1e10, 1e308])
def test_no_length_of_a_pause_can_be_waited_for_too_long(absurd: float) -> None:
    """For any announced length, all times are short enough for threads to wait."""
    pause = _pause(absurd)
    pause.hold(_stance(), 101.0, 1 * S, absurd)
    assert 0.0 < pause.time_left(101.0) <= pause.deadline - 101.0 < 4000.0


def test_joints_of_the_future_confirm_nothing() -> None:
    """Stamps ahead of the gait's clock are from another clock, or it was set: their delay is unknown."""
    pause = _pause()
    # The clock was read at ARRIVED and then set forward by 1 s; the joints were read at 101.0.
    pause.hold(_stance(), 101.5, 2 * S)
    assert pause.still_until == -math.inf and not pause.is_clock_known
    pause.hold(_stance(), 102.0, 10**18)
    assert pause.still_until == -math.inf and not pause.is_clock_known and not pause.broken


def test_without_the_gaits_clock_nothing_is_confirmed() -> None:
    """A stamp alone cannot distinguish a late message from a wrong clock."""
    pause = _pause()
    pause.earliest = lambda stamp: None
    pause.end(_stance(), 103.0, 2 * S)
    assert pause.still_until == -math.inf and not pause.is_clock_known and not pause.broken


def test_a_begin_that_is_repeated_after_the_end_is_refused() -> None:
    """A delayed copy must not turn the laser on under a walking robot."""
    pause, walks = _pause(), Walks("guara", "run")
    message = StanceMessage(joint_positions={"camera": 0.0}, support_feet=("lf",))
    begin = StancePause(robot="guara", step=0, phase=PausePhase.BEGIN, stamp=0, stance=message)
    assert walks.refusal(begin, pause) == ""
    pause.end(_stance(), 101.0, 1 * S)
    assert "comes late" in walks.refusal(begin, pause)
    later = StancePause(robot="guara", step=0, phase=PausePhase.BEGIN, stamp=2 * S, stance=message)
    assert walks.refusal(later, pause) == ""


PHASES = st.sampled_from([PausePhase.BEGIN, PausePhase.HOLD, PausePhase.END])
# Time of a request, round trip, and the fraction of it after which the clock was read.
ROUND_TRIP = st.tuples(st.floats(-10.0, 8.0), st.floats(0.0, 0.5), st.floats(0.0, 1.0))
MESSAGES = st.lists(st.tuples(PHASES, st.floats(0.0, 6.0), st.floats(0.0, 2.0)), max_size=8)


@given(
    messages=MESSAGES,
    moves_at=st.floats(0.0, 8.0),
    offset=st.floats(-1.0, 1.0),
    drift=st.floats(-0.9 * DRIFT, 0.9 * DRIFT),
    round_trips=st.lists(ROUND_TRIP, min_size=1, max_size=4),
    begin_delay=st.floats(0.0, 2.0),
)
@settings(max_examples=examples(300), deadline=None)
def test_no_frame_is_confirmed_that_came_later_than_the_joints_were_read(
    messages: list[tuple[PausePhase, float, float]],
    moves_at: float,
    offset: float,
    drift: float,
    round_trips: list[tuple[float, float, float]],
    begin_delay: float,
) -> None:
    """Whatever arrives when, by a clock that is off and drifts: an oracle knows when each joint was read.

    The body moves at `moves_at` and stays there. Joints are read at some time, and arrive up to 2 s later, in any
    order; the gait's clock was asked for with round trips of up to 0.5 s, in which it was read at any instant.
    """

    def shown(true: float) -> int:
        return round(((true - ARRIVED) * (1.0 + drift) + offset + 50.0) * S)

    bound: ClockBound | None = None
    for at, trip, share in sorted(round_trips):
        asked = ARRIVED + at
        newer = ClockBound(shown(asked + trip * share) * 1e-9, asked, asked + trip)
        bound = newer if bound is None else bound.after(newer)
    begun = ARRIVED + begin_delay
    pause = _pause(60.0, clock=bound, stamp=shown(ARRIVED))
    pause.begun = begun
    pause.__post_init__()
    last_still = ARRIVED
    for phase, read, delay in sorted(messages, key=lambda message: message[1] + message[2]):
        arrives = max(ARRIVED + read + delay, begun)
        stance = _stance(0.0 if read < moves_at else 1.0)
        if pause.ended.is_set():
            pause.add_late(stance, arrives, shown(ARRIVED + read))
        elif phase is PausePhase.HOLD:
            pause.hold(stance, arrives, shown(ARRIVED + read))
        elif phase is PausePhase.END:
            pause.end(stance, arrives, shown(ARRIVED + read))
        else:
            pause.begin_again(stance, arrives, shown(ARRIVED + read))
        if read < moves_at:
            last_still = max(last_still, ARRIVED + read)
        assert pause.still_until <= last_still + 1e-6
        assert pause.still_until <= max(arrives, begun)
