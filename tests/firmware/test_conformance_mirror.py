"""What PROTOCOL.md demands of a board's mirror, asked of all three boards."""

from __future__ import annotations

from drivers.board.protocol import BoardFault, Request, Result


def test_home_is_found_before_anything_else_moves(session) -> None:
    """Not homed: no GO_TO. While homing: busy. Then at `min_step`, which is where the mirror really is."""
    low = session.identity().min_step
    assert session.ask(Request.GO_TO, low + 10).result is Result.NOT_HOMED
    assert session.ask(Request.HOME).moving
    assert session.ask(Request.HOME).result is Result.BUSY
    assert session.ask(Request.GO_TO, low + 10).result is Result.BUSY
    status = session.until_still()
    assert status.homed and status.step == low and status.home_error == 0 and not status.faults
    assert abs(session.board.position - low) <= 1


def test_a_missing_home_switch_is_reported(session) -> None:
    session.board.inject("no_home")
    status = session.home()
    assert BoardFault.HOME_NOT_FOUND in status.faults and not status.homed
    session.board.mend()
    assert not session.ask(Request.CLEAR_FAULTS, 0xFFFF).faults
    assert session.home().homed


def test_lost_steps_are_counted_at_home(session) -> None:
    """The count goes into `home_error`, the fault stays until it is cleared; afterwards steps are true again."""
    session.home()
    session.board.inject("lost_steps", 40)
    session.ask(Request.GO_TO, session.identity().zero_step)
    session.until_still()
    status = session.home()
    assert status.home_error == 40 and BoardFault.LOST_STEPS in status.faults
    assert not session.ask(Request.CLEAR_FAULTS, 0xFFFF).faults
    session.ask(Request.GO_TO, session.identity().zero_step)
    session.until_still()
    assert abs(session.board.position - session.identity().zero_step) <= 1


def test_go_to_goes_there(session) -> None:
    identity = session.identity()
    session.home()
    for step in (identity.max_step, identity.min_step, identity.zero_step, identity.zero_step + 1):
        session.ask(Request.GO_TO, step)
        status = session.until_still()
        assert status.step == step and abs(session.board.position - step) <= 1


def test_beyond_the_travel_nothing_moves(session) -> None:
    identity = session.identity()
    before = session.home()
    for step in (identity.min_step - 1, identity.max_step + 1, -(2**31), 2**31 - 1):
        status = session.ask(Request.GO_TO, step)
        assert status.result is Result.OUT_OF_RANGE and not status.moving and status.motion == before.motion


def test_the_same_step_again_changes_nothing(session) -> None:
    """So a host may repeat a GO_TO whose answer it lost."""
    session.home()
    step = session.identity().zero_step
    first = session.ask(Request.GO_TO, step)
    assert session.ask(Request.GO_TO, step).motion == first.motion
    session.until_still()
    again = session.ask(Request.GO_TO, step)
    assert again.motion == first.motion and not again.moving


def test_the_last_approach_goes_upwards(session) -> None:
    """A move down passes its end and comes back, so backlash does not show."""
    identity = session.identity()
    session.home()
    session.ask(Request.GO_TO, identity.max_step)
    session.until_still()
    session.ask(Request.GO_TO, identity.zero_step)
    lowest = session.board.position
    for _ in range(2000):
        lowest = min(lowest, session.board.position)
        if not session.ask(Request.STATUS).moving:
            break
        session.board.wait(0.0005)
    assert lowest < identity.zero_step - 2
    assert abs(session.board.position - identity.zero_step) <= 1


def test_a_new_go_to_replaces_one_under_way(session) -> None:
    """Also when it lies behind; and the count of motions distinguishes the two."""
    identity = session.identity()
    session.home()
    first = session.ask(Request.GO_TO, identity.max_step)
    session.board.wait(0.05)
    second = session.ask(Request.GO_TO, identity.min_step + 20)
    assert second.motion == first.motion + 1 and second.moving
    assert session.until_still().step == identity.min_step + 20
    assert abs(session.board.position - identity.min_step - 20) <= 1


def test_halt_stops_on_the_way_and_loses_no_step(session) -> None:
    identity = session.identity()
    session.home()
    motion = session.ask(Request.GO_TO, identity.max_step).motion
    session.board.wait(0.03)
    session.ask(Request.HALT)
    status = session.until_still(0.2)
    assert identity.min_step < status.step < identity.max_step
    assert abs(session.board.position - status.step) <= 1
    assert session.ask(Request.GO_TO, identity.max_step).motion == motion + 1
    assert session.until_still().step == identity.max_step


def test_a_report_tells_when_the_motion_ended(session) -> None:
    """Made when the mirror had settled, however late it is fetched; and once only."""
    session.home()
    session.forget_reports()
    begun = session.ask(Request.GO_TO, session.identity().zero_step)
    session.board.wait(1.0)
    report = session.status_report()
    assert report is not None and report.request == 0 and report.motion == begun.motion
    assert not report.moving and report.step == session.identity().zero_step
    now = session.ask(Request.STATUS)
    assert begun.device_time < report.device_time < now.device_time - 0.5
    assert session.status_report() is None
