"""Handshake, bounded retries, reconnection and closing."""

import threading
import time

import pytest

from drivers import BoardConfig, LaserBoard, timing
from drivers.board.protocol import STATUS_SIZE, Request, Result
from drivers.emulator import EmulatedClock
from drivers.errors import (
    BadReply,
    BoardError,
    BoardNotFound,
    BoardNotOpen,
    BoardStalled,
    BoardTimeout,
    BoardUnplugged,
    LaserStuckOn,
    ProtocolMismatch,
)
from testbed.bench_board import BenchBoard, Fault, FaultKind, bench_backend

TRANSIENT = [
    (FaultKind.TIMEOUT, BoardTimeout, r"did not respond within 50 ms \(the command STATUS\)"),
    (FaultKind.TIMEOUT_AFTER, BoardTimeout, r"did not respond within 50 ms \(the command STATUS\)"),
    (FaultKind.STALL, BoardStalled, "stalled the command STATUS"),
    (FaultKind.SHORT_READ, BadReply, "13 bytes; allowed: 26"),
    (FaultKind.GARBAGE, BadReply, "damaged"),
]


def test_handshake_reads_what_the_board_is(board: LaserBoard, emulated: BenchBoard) -> None:
    """The received identity is the one with which the board was created."""
    assert board.identity == emulated.config.identity
    assert board.serial == "EMU0001"


@pytest.mark.parametrize(("kind", "error", "expected_text"), TRANSIENT)
def test_a_transient_fault_is_overcome_by_repeating(
    board: LaserBoard, emulated: BenchBoard, kind: FaultKind, error: type[BoardError], expected_text: str
) -> None:
    """Two consecutive faults are hidden from the caller by the third attempt."""
    emulated.inject(Fault(kind, Request.STATUS, count=2))
    assert board.status().result is Result.OK


@pytest.mark.parametrize(("kind", "error", "expected_text"), TRANSIENT)
def test_a_lasting_fault_is_typed_and_says_how_often_it_was_tried(
    board: LaserBoard, emulated: BenchBoard, kind: FaultKind, error: type[BoardError], expected_text: str
) -> None:
    """The third consecutive failure is raised, with its cause and the number of attempts."""
    emulated.inject(Fault(kind, Request.STATUS, count=3))
    with pytest.raises(error, match=expected_text) as caught:
        board.status()
    assert "3 attempts" in str(caught.value)
    assert board.status().result is Result.OK


def test_a_time_out_names_the_wait_of_its_transfer(board: LaserBoard, emulated: BenchBoard) -> None:
    """Near the end of the watchdog's time, it is shorter than the configured one."""
    emulated.inject(Fault(FaultKind.TIMEOUT, Request.STATUS))
    with pytest.raises(BoardTimeout, match="within 20 ms"):
        board._link.request(Request.STATUS, 0, STATUS_SIZE, 0.02)


def test_a_stalled_report_blames_no_request(board: LaserBoard, emulated: BenchBoard) -> None:
    """The message says what stalled and that reading again helps, which it does."""
    emulated.inject(Fault(FaultKind.STALL, "report"))
    with pytest.raises(BoardStalled, match="stalled its report endpoint.*read again"):
        board._link.read_report(0.1)
    assert board._link.read_report(0.01) is None


def test_repeating_a_command_whose_answer_was_lost_does_it_once(board: LaserBoard, emulated: BenchBoard) -> None:
    """Commands are idempotent: a repeated motion command starts no second motion."""
    board.home()
    emulated.inject(Fault(FaultKind.TIMEOUT_AFTER, Request.GO_TO))
    motions = board.status().motion
    angle = board.go_to_angle(0.1)
    assert board.status().motion == motions + 1
    assert emulated.view().mirror_angle == pytest.approx(angle, abs=1e-9)


@pytest.mark.parametrize("kind", [FaultKind.UNPLUG, FaultKind.UNPLUG_AFTER])
def test_unplugging_is_not_repeated_but_reported(board: LaserBoard, emulated: BenchBoard, kind: FaultKind) -> None:
    """A board that left the bus is not addressed again; the error advises to reconnect."""
    emulated.inject(Fault(kind, Request.STATUS))
    with pytest.raises(BoardUnplugged, match=r"left the bus during the command STATUS.*reconnect"):
        board.status()
    assert emulated.view().laser_on is False


def test_reconnecting_finds_a_board_that_comes_back(board: LaserBoard, emulated: BenchBoard) -> None:
    """A board that is plugged in during `reconnect` works again, with the laser off and not homed."""
    board.home()
    board.laser_on()
    emulated.unplug()
    assert not emulated.view().laser_on
    timer = threading.Timer(0.3, emulated.replug)
    timer.start()
    board.reconnect(timeout=20.0)
    timer.join()
    status = board.status()
    assert not status.homed and not status.laser_commanded


def test_reconnecting_gives_up_in_time(board: LaserBoard, emulated: BenchBoard) -> None:
    """If the board stays away, BoardNotFound is raised after the given time."""
    emulated.unplug()
    before = time.monotonic()
    with pytest.raises(BoardNotFound):
        board.reconnect(timeout=0.2)
    assert time.monotonic() - before >= 0.2
    with pytest.raises(BoardNotOpen):
        board.status()


@pytest.mark.parametrize(
    ("version", "expected_text"),
    [
        (0x0009, r"protocol 0\.9 .*speaks 1\.2.*flash newer firmware"),
        (0x0200, r"protocol 2\.0.*update this software"),
    ],
)
def test_another_version_of_the_protocol_is_refused(version: int, expected_text: str) -> None:
    """An older board needs newer firmware, a newer one a newer driver; nothing is switched."""
    emulated = BenchBoard()
    emulated.inject(Fault(FaultKind.WRONG_VERSION, amount=version))
    board = LaserBoard(backend=bench_backend(emulated))
    with pytest.raises(ProtocolMismatch, match=expected_text):
        board.open()
    assert not board.is_open
    emulated.mend()
    with board:
        assert board.is_open


@pytest.mark.parametrize(("version", "expected_text"), [(0x0100, "without sweeps"), (0x0101, "with sweeps")])
def test_an_older_minor_version_is_accepted_and_logged(
    version: int, expected_text: str, caplog: pytest.LogCaptureFixture
) -> None:
    """A board of protocol 1.0 works; the log contains its version."""
    caplog.set_level("INFO")
    emulated = BenchBoard()
    emulated.inject(Fault(FaultKind.WRONG_VERSION, amount=version))
    with LaserBoard(backend=bench_backend(emulated)) as board:
        assert not board.status().faults
    assert expected_text in caplog.text


def test_repeats_end_before_the_watchdog_does() -> None:
    """For any number of attempts, the driver gives up after half of the watchdog's time."""
    clock = EmulatedClock()
    with timing.on_clock(clock):
        emulated = BenchBoard()
        config = BoardConfig(timeout=0.05, attempts=10, handle_signals=False)
        with LaserBoard(config, backend=bench_backend(emulated)) as board:
            emulated.inject(Fault(FaultKind.TIMEOUT, Request.STATUS, count=10))
            begun = clock.monotonic()
            with pytest.raises(BoardTimeout, match=r"[45] attempts"):
                board.status()
            assert clock.monotonic() - begun <= 0.5 * board.identity.watchdog + 0.002
            emulated.mend()


def test_newer_minor_version_is_accepted() -> None:
    """A board with more commands than the driver uses is accepted."""
    emulated = BenchBoard()
    emulated.inject(Fault(FaultKind.WRONG_VERSION, amount=0x0105))
    with LaserBoard(backend=bench_backend(emulated)) as board:
        assert board.identity.protocol == (1, 5)


@pytest.mark.parametrize("kind", [kind for kind, *_ in TRANSIENT] + [FaultKind.UNPLUG, FaultKind.UNPLUG_AFTER])
@pytest.mark.parametrize("request_", [Request.IDENTIFY, Request.HELLO])
def test_a_fault_in_the_handshake_leaves_the_board_free(kind: FaultKind, request_: Request) -> None:
    """After any failure to open, the device is released and a second attempt works."""
    emulated = BenchBoard()
    emulated.inject(Fault(kind, request_, count=3))
    board = LaserBoard(BoardConfig(timeout=0.01), backend=bench_backend(emulated))
    with pytest.raises(BoardError):
        board.open()
    assert not board.is_open
    emulated.mend()
    emulated.replug()
    with board:
        assert board.status().result is Result.OK


def test_leaving_the_block_puts_the_laser_out(emulated: BenchBoard) -> None:
    """After a normal end and after an exception."""
    backend = bench_backend(emulated)
    with LaserBoard(backend=backend) as board:
        board.laser_on()
        assert emulated.view().laser_on
    assert not emulated.view().laser_on
    with pytest.raises(ZeroDivisionError), LaserBoard(backend=backend) as board:
        board.laser_on()
        raise ZeroDivisionError
    assert not emulated.view().laser_on and not board.is_open


def test_a_failure_while_closing_never_hides_the_error_under_way(emulated: BenchBoard) -> None:
    """The original error is raised."""
    with pytest.raises(ZeroDivisionError), LaserBoard(BoardConfig(timeout=0.01), backend=bench_backend(emulated)):
        emulated.inject(Fault(FaultKind.TIMEOUT, Request.GOODBYE, count=3))
        raise ZeroDivisionError


def test_a_failure_while_closing_is_raised_when_nothing_else_is() -> None:
    """A laser that could not be turned off raises an error."""
    emulated = BenchBoard()
    board = LaserBoard(BoardConfig(timeout=0.01), backend=bench_backend(emulated))
    board.open()
    emulated.inject(Fault(FaultKind.TIMEOUT, Request.GOODBYE, count=3))
    with pytest.raises(BoardTimeout):
        board.close()
    assert not board.is_open


def test_laser_stuck_on_is_reported_while_closing(eventually) -> None:
    """A laser that stays on after GOODBYE is an error, because its power must be cut by hand."""
    emulated = BenchBoard()
    emulated.inject(Fault(FaultKind.LASER_STUCK_ON))
    board = LaserBoard(backend=bench_backend(emulated))
    with pytest.raises(LaserStuckOn, match="did not go off on command"), board:
        board.laser_on()
    eventually(lambda: not emulated.view().laser_on)


def test_closing_an_unplugged_board_is_quiet(board: LaserBoard, emulated: BenchBoard) -> None:
    """Without USB power the laser is off, so no error is raised."""
    emulated.unplug()
    board.close()
    assert not board.is_open


def test_after_an_answer_to_another_request_the_command_is_repeated(
    board: LaserBoard, monkeypatch: pytest.MonkeyPatch, emulated: BenchBoard
) -> None:
    """A valid status that echoes another command is not accepted."""
    real, wrong = emulated.serve, [2]

    def serve(request: int, argument: int) -> bytes | None:
        if wrong[0] > 0:
            wrong[0] -= 1
            return real(Request.HALT, 0)
        return real(request, argument)

    monkeypatch.setattr(emulated, "serve", serve)
    assert board.status().request == Request.STATUS
    wrong[0] = 3
    with pytest.raises(BadReply, match="the reply to STATUS belongs to request 0x22"):
        board.status()


def test_identity_before_opening_is_refused() -> None:
    """There is no default identity."""
    with pytest.raises(BoardNotOpen, match="with LaserBoard"):
        _ = LaserBoard(backend=bench_backend(BenchBoard())).identity
