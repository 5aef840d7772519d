"""Laser and mirror of an emulated board, through the real driver and the real pyusb."""

import math
import time
from collections.abc import Iterator

import pytest

from drivers import BoardConfig, LaserBoard
from drivers.board.protocol import BoardFault, Request
from drivers.errors import (
    BoardError,
    BoardNotOpen,
    HomeNotFound,
    LaserDead,
    LaserRefused,
    LaserStuckOn,
    MirrorNotHomed,
    MirrorOutOfRange,
    MirrorTimeout,
)
from testbed.bench_board import BenchBoard, Fault, FaultKind, bench_backend


def test_laser_obeys(board: LaserBoard, emulated: BenchBoard) -> None:
    """The status reports the laser as commanded, on and off."""
    assert board.laser_on().laser_sensed
    assert emulated.view().laser_on
    assert not board.laser_off().laser_sensed
    assert not emulated.view().laser_on


def test_dead_laser_is_found_at_once(board: LaserBoard, emulated: BenchBoard) -> None:
    """The photodiode contradicts the command."""
    emulated.inject(Fault(FaultKind.LASER_STUCK_OFF))
    with pytest.raises(LaserDead, match="senses no light"):
        board.laser_on()
    assert BoardFault.LASER_DEAD in board.status().faults
    emulated.mend()
    assert board.laser_on().laser_sensed


def test_stuck_laser_is_found_and_put_out_by_the_supply(board: LaserBoard, emulated: BenchBoard, eventually) -> None:
    """A shorted transistor raises an error, and the supply turns the laser off until it is repaired."""
    emulated.inject(Fault(FaultKind.LASER_STUCK_ON))
    board.laser_on()
    with pytest.raises(LaserStuckOn, match="the board cut its supply"):
        board.laser_off()
    eventually(lambda: not emulated.view().laser_on)
    with pytest.raises(LaserRefused, match="not ready: the laser is on without a command"):
        board.ensure_ready()
    emulated.mend()
    assert not board.ensure_ready().faults
    assert board.laser_on().laser_sensed and not board.laser_off().laser_sensed


def test_stuck_laser_behind_a_blind_sensor_still_shines(board: LaserBoard, emulated: BenchBoard) -> None:
    """Without a working sensor the board cannot know; only images or the watchdog reveal it."""
    emulated.inject(Fault(FaultKind.BLIND_SENSOR))
    emulated.inject(Fault(FaultKind.LASER_STUCK_ON))
    board.laser_on()
    assert not board.laser_off().laser_sensed
    assert emulated.view().laser_on


def test_hot_board_refuses_in_words(board: LaserBoard, emulated: BenchBoard) -> None:
    """Over-temperature turns the laser off until the board is cool; the message says so."""
    board.laser_on()
    emulated.inject(Fault(FaultKind.HOT, amount=61))
    assert board.status().temperature == 61.0
    assert not emulated.view().laser_on
    with pytest.raises(LaserRefused, match="refuses to switch the laser on: the board is too hot"):
        board.laser_on()
    with pytest.raises(LaserRefused, match="too hot"):
        board.ensure_ready()
    emulated.mend()
    board.ensure_ready()
    assert board.laser_on().laser_sensed


def test_mirror_goes_to_the_step_nearest_to_the_angle(board: LaserBoard, emulated: BenchBoard) -> None:
    """The true angle is within half a step of the requested one, and equals the returned one."""
    board.home()
    for angle in (0.1, -0.2, 0.3, 0.0, 0.2999):
        reached = board.go_to_angle(angle)
        assert abs(reached - angle) <= 0.5 * board.identity.step_angle
        assert emulated.view().mirror_angle == pytest.approx(reached, abs=1e-9)
        assert not emulated.view().moving


class Clock:
    """Time of the emulated board, which the test stops and starts."""

    def __init__(self) -> None:
        self.running = True
        self._now = self._seen = time.monotonic()

    def __call__(self) -> float:
        now = time.monotonic()
        self._now += (now - self._seen) if self.running else 0.0
        self._seen = now
        return self._now

    def advance(self, seconds: float) -> None:
        self._now += seconds


@pytest.fixture
def stopped() -> Iterator[tuple[LaserBoard, BenchBoard, Clock]]:
    """Homed board whose time stands still."""
    clock = Clock()
    emulated = BenchBoard(clock=clock)
    with LaserBoard(BoardConfig(motion_timeout=20.0), backend=bench_backend(emulated)) as board:
        board.home()
        clock.running = False
        yield board, emulated, clock


def test_motion_without_waiting_is_waited_for_later(stopped: tuple[LaserBoard, BenchBoard, Clock]) -> None:
    """`wait=False` returns while the mirror moves, `wait_until_still` once it rests."""
    board, emulated, clock = stopped
    reached = board.go_to_angle(0.4, wait=False)
    assert emulated.view().moving
    clock.running = True
    status = board.wait_until_still()
    assert not status.moving
    assert emulated.view().mirror_angle == pytest.approx(reached, abs=1e-9)


def test_going_before_homing_is_refused(board: LaserBoard) -> None:
    """Steps are undefined before homing."""
    with pytest.raises(MirrorNotHomed, match="call home"):
        board.go_to_angle(0.0)


@pytest.mark.parametrize("angle", [0.5, -0.5, math.nan, math.inf])
def test_angle_outside_the_travel_is_refused(board: LaserBoard, angle: float) -> None:
    """The message gives the angle and the travel in degrees."""
    board.home()
    with pytest.raises(MirrorOutOfRange, match=r"is outside the board's travel of -14\.998 \.\.\. 25\.003 degrees"):
        board.go_to_angle(angle)


@pytest.mark.parametrize("step", [0, 100000])
def test_step_outside_the_travel_is_refused_by_the_board(board: LaserBoard, step: int) -> None:
    """The firmware checks its travel itself."""
    board.home()
    with pytest.raises(MirrorOutOfRange, match=rf"step {step} is outside the board's travel of 64 \.\.\. \d+"):
        board.go_to_step(step)


@pytest.mark.parametrize(
    ("request_", "argument", "error", "expected_text"),
    [
        (Request.SWEEP_STEP, 3 << 16 | 20000, MirrorOutOfRange, "step 20000 is outside the board's travel of 64"),
        (Request.SWEEP_STEP, 1 << 25 | 0xFFFF, MirrorOutOfRange, "step -1 is outside the board's travel of 64"),
        (Request.SWEEP_FLASH, 5, BoardError, "the board refuses argument 5 of SWEEP_FLASH as out of range"),
        (Request.SWEEP, 1 << 25 | 1, BoardError, "argument 33554433 of SWEEP as out of range"),
    ],
)
def test_what_is_out_of_range_is_named(
    board: LaserBoard, request_: Request, argument: int, error: type[BoardError], expected_text: str
) -> None:
    """The message names a step only if the argument is a step."""
    board.home()
    with pytest.raises(BoardError, match=expected_text) as caught:
        board.command(request_, argument)
    assert type(caught.value) is error


def test_lost_steps_show_at_home(board: LaserBoard, emulated: BenchBoard) -> None:
    """A motor that lost 40 steps is off by as much until homing detects and corrects it."""
    assert board.home() == 0
    emulated.inject(Fault(FaultKind.LOST_STEP, Request.GO_TO, amount=40))
    wanted = board.go_to_angle(0.2)
    off_by = wanted - emulated.view().mirror_angle
    assert off_by == pytest.approx(40 * board.identity.step_angle, rel=1e-6)
    assert board.home() == 40
    assert BoardFault.LOST_STEPS in board.status().faults
    board.ensure_ready()
    assert board.go_to_angle(0.2) == pytest.approx(emulated.view().mirror_angle, abs=1e-9)
    assert board.home() == 0


def test_missing_home_switch_is_reported(board: LaserBoard, emulated: BenchBoard) -> None:
    """If the switch is not found, an error is raised and the mirror counts as not homed."""
    emulated.inject(Fault(FaultKind.NO_HOME_SWITCH))
    with pytest.raises(HomeNotFound, match="the home switch was not found"):
        board.home()
    assert not board.status().homed


def test_commands_while_homing_are_refused(stopped: tuple[LaserBoard, BenchBoard, Clock]) -> None:
    """A homing board rejects motion commands."""
    board, _, _ = stopped
    board.command(Request.HOME)
    with pytest.raises(MirrorTimeout, match="still homing"):
        board.command(Request.HOME)


def test_jammed_mirror_times_out(emulated: BenchBoard) -> None:
    """A motion that does not end raises an error after the configured time."""
    config = BoardConfig(home_timeout=0.1)
    emulated.inject(Fault(FaultKind.JAMMED))
    with LaserBoard(config, backend=bench_backend(emulated)) as board:
        with pytest.raises(MirrorTimeout, match=r"did not come to rest within 0\.1 s"):
            board.home()


def test_halt_stops_the_mirror_on_its_way(stopped: tuple[LaserBoard, BenchBoard, Clock]) -> None:
    """A halted mirror rests short of its target and can be moved again."""
    board, emulated, clock = stopped
    begin = emulated.view().mirror_angle
    goal = board.go_to_angle(0.4, wait=False)
    clock.advance(0.05)
    board.halt()
    clock.advance(1.0)
    assert emulated.view().mirror_angle == pytest.approx(begin + 0.05 * emulated.config.mirror_speed, abs=1e-6)
    clock.running = True
    assert board.go_to_angle(0.4) == pytest.approx(goal)
    assert emulated.view().mirror_angle == pytest.approx(goal, abs=1e-9)


@pytest.mark.parametrize("kind", [FaultKind.STALL, FaultKind.GARBAGE, FaultKind.SHORT_READ, FaultKind.TIMEOUT])
def test_a_lost_report_does_not_lose_the_motion(board: LaserBoard, emulated: BenchBoard, kind: FaultKind) -> None:
    """If the interrupt endpoint fails, the status is read instead."""
    board.home()
    emulated.inject(Fault(kind, "report", count=5))
    reached = board.go_to_angle(0.3)
    assert emulated.view().mirror_angle == pytest.approx(reached, abs=1e-9)


def test_ensure_ready_brings_back_a_board_that_was_replugged(board: LaserBoard, emulated: BenchBoard) -> None:
    """After a loss of power, one call makes the board ready for the next scan."""
    board.ensure_ready()
    emulated.unplug()
    emulated.replug()
    status = board.ensure_ready()
    assert status.homed and not status.faults
    board.go_to_angle(0.1)


def test_a_board_that_was_reset_asks_for_a_new_session(board: LaserBoard, emulated: BenchBoard) -> None:
    """A host without a session cannot switch the laser on."""
    emulated.unplug()
    emulated.replug()
    with pytest.raises(BoardNotOpen, match="forgotten this session"):
        board.laser_on()
    board.ensure_ready()
    assert board.laser_on().laser_sensed
