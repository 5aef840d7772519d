"""What PROTOCOL.md demands of a board's session, light and reports, asked of all three boards."""

from __future__ import annotations

import pytest

from drivers.board.protocol import PROTOCOL_MAJOR, REQUESTS, BoardFault, BoardFlag, Request, Result

HELLO = PROTOCOL_MAJOR << 8


def test_it_says_what_it_is_to_anybody(bench) -> None:
    """IDENTIFY needs no session, and gives the limits that the protocol allows."""
    identity = bench.identity()
    assert identity.protocol[0] == PROTOCOL_MAJOR
    assert identity.min_step < identity.zero_step < identity.max_step
    assert 0.2 <= identity.watchdog <= 0.4
    assert identity.laser_limit == 10.0 and identity.laser_rest == pytest.approx(0.05)
    assert bench.identity() == identity


def test_nothing_but_off_and_status_works_without_a_session(bench) -> None:
    """Before HELLO the laser cannot be switched on nor the mirror moved; off always works."""
    for request, argument in [(Request.LASER, 1), (Request.HOME, 0), (Request.GO_TO, 100), (Request.HALT, 0)]:
        assert bench.ask(request, argument).result is Result.NO_SESSION
    assert bench.ask(Request.CLEAR_FAULTS, 0x7F).result is Result.NO_SESSION
    assert bench.ask(Request.LASER, 0).result is Result.OK
    assert bench.ask(Request.STATUS).result is Result.OK
    assert not bench.board.lit


def test_another_major_version_gets_no_session(bench) -> None:
    status = bench.ask(Request.HELLO, (PROTOCOL_MAJOR + 1) << 8)
    assert status.result is Result.VERSION and BoardFlag.SESSION not in status.flags


def test_an_unknown_request_stalls(session) -> None:
    """The next one is answered as if nothing had happened."""
    unknown = [number for number in range(256) if number not in REQUESTS]
    for number in (unknown[0], unknown[len(unknown) // 2], unknown[-1]):
        assert session.board.raw(number, 1) is None
        assert session.ask(Request.STATUS).result is Result.OK


def test_the_answer_to_laser_holds_what_the_photodiode_sees(session) -> None:
    on = session.ask(Request.LASER, 1)
    assert on.laser_commanded and on.laser_sensed and session.board.lit
    off = session.ask(Request.LASER, 0)
    assert not off.laser_commanded and not off.laser_sensed and not session.board.lit


def test_hello_puts_the_laser_out_and_halts_the_mirror(session) -> None:
    """A new host begins in the dark, with a mirror at rest."""
    session.home()
    session.ask(Request.GO_TO, session.identity().max_step)
    session.ask(Request.LASER, 1)
    session.board.wait(0.02)
    session.ask(Request.HELLO, HELLO)
    assert not session.board.lit
    status = session.until_still(0.5)
    assert status.step < session.identity().max_step


def test_goodbye_ends_the_session_in_the_dark(session) -> None:
    session.ask(Request.LASER, 1)
    status = session.ask(Request.GOODBYE)
    assert not session.board.lit and BoardFlag.SESSION not in status.flags
    assert session.ask(Request.LASER, 1).result is Result.NO_SESSION


def test_a_silent_host_goes_dark_with_the_fault_latched(session) -> None:
    """Within the time that the board names, and not much earlier; then the laser is refused."""
    session.ask(Request.LASER, 1)
    limit = session.identity().watchdog
    assert limit - 0.02 <= session.until_dark(1.0) <= limit + 0.001
    assert session.ask(Request.STATUS).faults == BoardFault.WATCHDOG
    assert session.ask(Request.LASER, 1).result is Result.LASER_REFUSED
    assert not session.board.lit
    session.ask(Request.CLEAR_FAULTS, int(BoardFault.WATCHDOG))
    assert session.ask(Request.LASER, 1).laser_sensed
    session.until_dark(1.0)
    assert not session.ask(Request.HELLO, HELLO).faults


def test_requests_of_the_session_feed_the_watchdog_and_nothing_else_does(session) -> None:
    session.ask(Request.LASER, 1)
    for _ in range(4):
        session.board.wait(0.3)
        session.ask(Request.STATUS)
    assert session.board.lit
    session.board.wait(0.3)
    session.identity()
    session.board.raw(0x77, 0)
    session.board.wait(0.15)
    assert not session.board.lit


def test_silence_in_the_dark_is_no_fault(session) -> None:
    session.board.wait(2.0)
    assert not session.ask(Request.STATUS).faults
    assert session.ask(Request.LASER, 1).laser_sensed


def keep_lit(bench, seconds: float):
    """Ask often for this long; return the last answer."""
    for _ in range(round(seconds / 0.3)):
        bench.board.wait(0.3)
        status = bench.ask(Request.STATUS)
    return status


def test_the_laser_shines_at_most_ten_seconds_without_a_rest(session) -> None:
    """A rest too short begins no new count; the fault cannot be cleared before the rest is over."""
    session.ask(Request.LASER, 1)
    assert keep_lit(session, 9.0).laser_time == pytest.approx(9.0, abs=0.1)
    session.ask(Request.LASER, 0)
    session.board.wait(0.02)
    session.ask(Request.LASER, 1)
    assert keep_lit(session, 1.5).faults == BoardFault.LASER_TIME and not session.board.lit
    assert session.ask(Request.LASER, 1).result is Result.LASER_REFUSED
    session.board.wait(0.06)
    assert not session.ask(Request.CLEAR_FAULTS, 0xFFFF).faults
    assert session.ask(Request.LASER, 1).laser_time < 0.01


def test_the_time_limit_cannot_be_cleared_at_once(session) -> None:
    session.ask(Request.LASER, 1)
    keep_lit(session, 9.9)
    for _ in range(30):
        session.board.wait(0.01)
        if session.ask(Request.STATUS).faults:
            break
    assert session.ask(Request.CLEAR_FAULTS, 0xFFFF).faults == BoardFault.LASER_TIME


def test_heat_forbids_the_laser(session) -> None:
    """Off at 60 degrees Celsius, and refused until it is below 55."""
    session.ask(Request.LASER, 1)
    session.board.inject("hot", 61)
    session.board.wait(0.01)
    status = session.ask(Request.STATUS)
    assert status.faults == BoardFault.OVER_TEMPERATURE and not session.board.lit
    assert status.temperature == pytest.approx(61, abs=0.5)
    session.board.inject("hot", 57)
    session.board.wait(0.01)
    assert session.ask(Request.CLEAR_FAULTS, 0xFFFF).faults == BoardFault.OVER_TEMPERATURE
    session.board.inject("hot", 50)
    session.board.wait(0.01)
    assert not session.ask(Request.CLEAR_FAULTS, 0xFFFF).faults
    assert session.ask(Request.LASER, 1).laser_sensed


def test_a_stuck_laser_loses_its_supply(session) -> None:
    """Dark although its transistor conducts; cleared only when it stays dark with the supply closed."""
    session.ask(Request.LASER, 1)
    session.board.inject("stuck_on")
    session.ask(Request.LASER, 1)
    session.ask(Request.LASER, 0)
    session.board.wait(0.01)
    assert not session.board.lit
    assert BoardFault.LASER_STUCK_ON in session.ask(Request.STATUS).faults
    assert BoardFault.LASER_STUCK_ON in session.ask(Request.CLEAR_FAULTS, 0xFFFF).faults
    session.board.wait(0.01)
    assert not session.board.lit
    assert session.ask(Request.LASER, 1).result is Result.LASER_REFUSED
    session.board.mend()
    assert not session.ask(Request.CLEAR_FAULTS, 0xFFFF).faults
    assert session.ask(Request.LASER, 1).laser_sensed


def test_a_dead_laser_is_reported(session) -> None:
    session.board.inject("dead")
    status = session.ask(Request.LASER, 1)
    assert not status.laser_sensed and BoardFault.LASER_DEAD in status.faults and not status.laser_commanded
    session.board.mend()
    session.ask(Request.CLEAR_FAULTS, 0xFFFF)
    assert session.ask(Request.LASER, 1).laser_sensed


def test_a_fault_is_reported(session) -> None:
    session.forget_reports()
    session.ask(Request.LASER, 1)
    session.board.wait(0.5)
    report = session.status_report()
    assert report is not None and report.faults == BoardFault.WATCHDOG and not report.laser_commanded


def test_the_newest_reports_are_kept(session) -> None:
    """When nobody fetches them, old reports are dropped; the last motion's report is there."""
    identity = session.identity()
    session.home()
    for round_ in range(8):
        last = session.ask(Request.GO_TO, identity.zero_step + 10 * (round_ + 1))
        session.until_still()
    motions = []
    while (report := session.status_report()) is not None:
        motions.append(report.motion)
    assert motions == sorted(motions) and motions[-1] == last.motion and 1 <= len(motions) <= 8


def test_the_clock_runs_as_time_does(session) -> None:
    first = session.ask(Request.STATUS)
    session.board.wait(2.0)
    second = session.ask(Request.STATUS)
    assert second.device_time - first.device_time == pytest.approx(2.0, abs=0.01)
    assert second.sequence == first.sequence + 1


def test_power_up_forgets_everything(session) -> None:
    session.home()
    session.ask(Request.LASER, 1)
    session.board.replug()
    status = session.ask(Request.STATUS)
    assert not session.board.lit and not status.homed and not status.faults
    assert BoardFlag.SESSION not in status.flags and status.sequence == 1 and status.motion == 0
