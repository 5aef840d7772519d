"""The emulated firmware on a clock set by the test: limits of the laser to the millisecond."""

import dataclasses

import pytest

from drivers.board.board_records import BoardStatus
from drivers.board.protocol import PROTOCOL_MAJOR, BoardFault, BoardFlag, Request, Result
from drivers.emulator import EmulatorConfig
from testbed.bench_board import BenchBoard, Fault, FaultKind

HELLO = PROTOCOL_MAJOR << 8


class Bench:
    """Board whose time is set by the test."""

    def __init__(self, **changes: object) -> None:
        self.now = 100.0
        self.board = BenchBoard(dataclasses.replace(EmulatorConfig(), **changes), clock=lambda: self.now)

    def ask(self, request: Request, argument: int = 0) -> BoardStatus:
        data = self.board.serve(request, argument)
        assert data is not None
        return BoardStatus.unpack(data)


@pytest.fixture
def bench() -> Bench:
    bench = Bench()
    bench.ask(Request.HELLO, HELLO)
    return bench


def test_nothing_but_off_works_without_a_session() -> None:
    """Before HELLO, the laser cannot be switched on nor the mirror moved; off always works."""
    bench = Bench()
    for request, argument in [(Request.LASER, 1), (Request.HOME, 0), (Request.GO_TO, 100), (Request.HALT, 0)]:
        assert bench.ask(request, argument).result is Result.NO_SESSION
    assert bench.ask(Request.LASER, 0).result is Result.OK
    assert bench.ask(Request.STATUS).result is Result.OK
    assert not bench.board.view().laser_on


def test_other_major_version_gets_no_session() -> None:
    """A host with another major version gets no session."""
    bench = Bench()
    status = bench.ask(Request.HELLO, (PROTOCOL_MAJOR + 1) << 8)
    assert status.result is Result.VERSION and BoardFlag.SESSION not in status.flags


def test_watchdog_acts_after_its_time_of_silence(bench: Bench) -> None:
    """The laser is on just before 0.4 s and off at 0.4 s exactly; it stays off until the fault is cleared."""
    bench.ask(Request.LASER, 1)
    bench.now += 0.399
    assert bench.board.view().laser_on
    bench.now += 7.0
    assert not bench.board.view().laser_on
    assert bench.board.switchings()[-1].time == pytest.approx(100.4)
    status = bench.ask(Request.LASER, 1)
    assert status.result is Result.LASER_REFUSED and status.faults == BoardFault.WATCHDOG
    bench.ask(Request.CLEAR_FAULTS, int(BoardFault.WATCHDOG))
    assert bench.ask(Request.LASER, 1).laser_sensed


def test_every_request_of_a_session_feeds_the_watchdog(bench: Bench) -> None:
    """With a status every 0.3 s the laser stays on; IDENTIFY does not count."""
    bench.ask(Request.LASER, 1)
    for _ in range(10):
        bench.now += 0.3
        bench.ask(Request.STATUS)
    assert bench.board.view().laser_on
    bench.now += 0.3
    bench.board.serve(Request.IDENTIFY, 0)
    bench.now += 0.2
    assert not bench.board.view().laser_on


def test_silence_in_the_dark_is_no_fault(bench: Bench) -> None:
    """Without the laser on, silence of any length is no fault."""
    bench.now += 3600.0
    assert not bench.ask(Request.STATUS).faults
    assert bench.ask(Request.LASER, 1).laser_sensed


def test_laser_time_without_a_rest_is_limited(bench: Bench) -> None:
    """The laser goes off after 10 s; a rest of 50 ms restarts the count, a shorter one does not."""
    bench.ask(Request.LASER, 1)
    for _ in range(30):
        bench.now += 0.3
        bench.ask(Request.STATUS)
    bench.ask(Request.LASER, 0)
    bench.now += 0.02
    bench.ask(Request.LASER, 1)
    for _ in range(5):
        bench.now += 0.3
        bench.ask(Request.STATUS)
    status = bench.ask(Request.STATUS)
    assert not bench.board.view().laser_on and status.faults == BoardFault.LASER_TIME
    assert bench.board.switchings()[-1].time == pytest.approx(110.0)
    bench.now += 0.06
    assert not bench.ask(Request.CLEAR_FAULTS, 0xFFFF).faults
    assert bench.ask(Request.LASER, 1).laser_time == 0.0


def test_laser_time_fault_cannot_be_cleared_before_the_rest(bench: Bench) -> None:
    """Clearing at once would defeat the limit."""
    bench.ask(Request.LASER, 1)
    for _ in range(34):
        bench.now += 0.3
        status = bench.ask(Request.STATUS)
        if status.faults:
            break
    bench.now = bench.board.switchings()[-1].time + 0.01
    assert bench.ask(Request.CLEAR_FAULTS, 0xFFFF).faults == BoardFault.LASER_TIME


def test_unplugging_and_replugging_forgets_everything(bench: Bench) -> None:
    """Without power the laser is off at once; after power-up there is no session, home or command."""
    bench.ask(Request.HOME)
    bench.now += 5.0
    bench.ask(Request.LASER, 1)
    bench.board.unplug()
    assert not bench.board.view().laser_on and not bench.board.view().plugged
    bench.now += 1.0
    bench.board.replug()
    status = bench.ask(Request.STATUS)
    assert not status.homed and BoardFlag.SESSION not in status.flags and not status.laser_commanded
    assert status.device_time == 0.0


def test_hello_puts_the_laser_out(bench: Bench) -> None:
    """A new session starts with the laser off."""
    bench.ask(Request.LASER, 1)
    bench.ask(Request.HELLO, HELLO)
    assert not bench.board.view().laser_on


def test_the_past_can_be_asked_for(bench: Bench) -> None:
    """Past exposures can be queried, as a camera with read-out time needs."""
    bench.ask(Request.HOME)
    bench.now += 5.0
    bench.ask(Request.GO_TO, 2197)
    bench.now += 1.0
    rest = bench.now
    bench.ask(Request.LASER, 1)
    bench.now += 0.1
    bench.ask(Request.LASER, 0)
    bench.ask(Request.GO_TO, 5000)
    bench.now += 1.0
    assert bench.board.view(rest + 0.05).laser_on and not bench.board.view(rest - 0.05).laser_on
    assert bench.board.view(rest).mirror_angle == pytest.approx(0.0, abs=1e-9)
    seen = bench.board.exposure(rest + 0.05, rest + 0.15)
    assert seen.laser_fraction == pytest.approx(0.5)
    assert seen.mirror_travel > 0.1
    assert bench.board.exposure(rest, rest + 0.1).mirror_travel == 0.0


def test_unknown_request_is_not_served(bench: Bench) -> None:
    """None stands for a stall."""
    assert bench.board.serve(0x77, 0) is None


def test_fault_strikes_where_and_as_often_as_planned() -> None:
    """`skip` lets transfers pass, `count` repeats the fault, and other commands are unaffected."""
    board = BenchBoard()
    board.inject(Fault(FaultKind.STALL, Request.LASER, skip=2, count=2))
    kinds = (FaultKind.STALL,)
    assert board.plan.strike(Request.STATUS, kinds) is None
    struck = [board.plan.strike(Request.LASER, kinds) is not None for _ in range(6)]
    assert struck == [False, False, True, True, False, False]


def test_fault_without_request_strikes_any_command_but_no_report() -> None:
    """A fault without a request affects commands only."""
    board = BenchBoard()
    board.inject(Fault(FaultKind.STALL))
    assert board.plan.strike("report", (FaultKind.STALL,)) is None
    assert board.plan.strike(Request.HOME, (FaultKind.STALL,)) is not None


def test_a_board_that_reaches_other_angles() -> None:
    """Its travel is the default one, extended to every given angle; steps begin at the same number."""
    usual = EmulatorConfig().identity
    assert EmulatorConfig.reaching([-0.1, 0.3]).identity == usual
    identity = EmulatorConfig.reaching([0.5, -0.3]).identity
    assert identity.min_step == usual.min_step
    assert identity.angle_of(identity.min_step) == pytest.approx(-0.3, abs=1e-4)
    assert identity.angle_of(identity.max_step) == pytest.approx(0.5, abs=1e-4)
