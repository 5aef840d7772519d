"""The driver's connection to a board in this process: reports, refusals and time limits as over USB."""

from collections.abc import Iterator

import pytest

from drivers import BoardConfig, timing
from drivers.board.board_records import BoardStatus
from drivers.board.protocol import IDENTITY_SIZE, PROTOCOL_MAJOR, STATUS_SIZE, Request
from drivers.emulator import EmulatedBoard, EmulatedClock, emulated_backend
from drivers.emulator.link import EmulatedLink
from drivers.errors import BoardInUse, BoardNotOpen, BoardStalled


@pytest.fixture
def link() -> Iterator[EmulatedLink]:
    """Open, in emulated time, with a session."""
    with timing.on_clock(EmulatedClock()):
        link = emulated_backend(EmulatedBoard())(BoardConfig())
        link.open()
        link.request(Request.HELLO, PROTOCOL_MAJOR << 8, STATUS_SIZE)
        yield link
        link.close()


def test_the_report_at_the_end_of_a_motion_is_awaited(link: EmulatedLink) -> None:
    """It arrives when the motion ends, not before; nothing follows."""
    link.request(Request.HOME, 0, STATUS_SIZE)
    begun = timing.monotonic()
    report = link.read_report(10.0)
    assert report is not None
    status = BoardStatus.unpack(report)
    assert status.homed and not status.moving and 0.0 < timing.monotonic() - begun < 10.0
    assert link.read_report(0.05) is None


def test_a_silent_board_takes_as_long_as_is_allowed(link: EmulatedLink) -> None:
    """None after the time-out, and the time has passed."""
    begun = timing.monotonic()
    assert link.read_report(0.25) is None
    assert timing.monotonic() - begun == pytest.approx(0.25)


def test_unknown_requests_stall(link: EmulatedLink) -> None:
    """As firmware of protocol 1.0 does; the link stays open."""
    with pytest.raises(BoardStalled, match="the command SWEEP: its firmware does not know the request"):
        link.request(Request.SWEEP, 0, STATUS_SIZE)
    assert len(link.request(Request.IDENTIFY, 0, IDENTITY_SIZE)) == IDENTITY_SIZE


def test_a_closed_link_is_refused(link: EmulatedLink) -> None:
    """Closing twice is fine; asking afterwards is not, and the board is free."""
    board = link._board
    link.close()
    link.close()
    for ask in (lambda: link.request(Request.STATUS, 0, STATUS_SIZE), lambda: link.read_report(0.0)):
        with pytest.raises(BoardNotOpen):
            ask()
    other = EmulatedLink(board, BoardConfig())
    other.open()
    with pytest.raises(BoardInUse, match="another program uses the laser board"):
        link.open()
    other.close()
    link.open()
