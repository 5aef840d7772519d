"""What PROTOCOL.md 1.2 demands of a board that sweeps by itself, asked of all three."""

from __future__ import annotations

import pytest

from drivers.board.board_records import BoardStatus
from drivers.board.protocol import BoardFault, BoardFlag, Request, Result, Shot, SweepOffFrames
from drivers.board.sweep_records import MotionProfile, StripeRecord
from tests.firmware.boards import HELLO

FLASH_US = 2000
STRIPES = 6


def motion(bench) -> MotionProfile:
    data = bench.board.raw(Request.MOTION)
    assert data is not None
    return MotionProfile.unpack(data)


def prepare(bench, stripes: int = STRIPES, off: SweepOffFrames = SweepOffFrames.NONE, waits=()) -> list[int]:
    """Home, and a table of steps going upwards; return the steps."""
    identity = bench.identity()
    bench.home()
    pitch = round(0.0068 / identity.step_angle)
    steps = [identity.zero_step + pitch * place for place in range(stripes)]
    for place, step in enumerate(steps):
        wait = waits[place] if place < len(waits) else 0
        argument = wait << 25 | place << 16 | step
        assert bench.ask(Request.SWEEP_STEP, argument).result is Result.OK
    assert bench.ask(Request.SWEEP_FLASH, FLASH_US).result is Result.OK
    assert bench.ask(Request.SWEEP_OFF_FRAMES, int(off)).result is Result.OK
    bench.ask(Request.GO_TO, steps[0])
    bench.until_still()
    bench.forget_reports()
    return steps


def sweep(bench, stripes: int = STRIPES, number: int = 1, first: int = 0) -> BoardStatus:
    return bench.ask(Request.SWEEP, number << 25 | first << 16 | stripes)


def finish(bench, patience: float = 2.0) -> tuple[list[StripeRecord], list[BoardStatus]]:
    """Ask for the status until the sweep is over; return its records and the status reports."""
    records, reports = [], []
    for _ in range(round(patience / 0.05)):
        status = bench.ask(Request.STATUS)
        while (data := bench.board.report()) is not None:
            if len(data) == 32:
                records.append(StripeRecord.unpack(data))
            else:
                reports.append(BoardStatus.unpack(data))
        if BoardFlag.SWEEPING not in status.flags and not status.moving:
            return records, reports
        bench.board.wait(0.05)
    pytest.fail("the sweep does not end")


def test_a_sweep_reports_every_stripe(session) -> None:
    """In order, with its step and the time lit; then a status. The mirror ends at the last step, in the dark."""
    steps = prepare(session)
    begun = sweep(session)
    assert begun.result is Result.OK and begun.moving and BoardFlag.SWEEPING in begun.flags
    records, reports = finish(session)
    assert [record.place for record in records] == list(range(STRIPES))
    assert [record.step for record in records] == steps
    assert [record.left for record in records] == list(reversed(range(STRIPES)))
    assert all(record.shot is Shot.STRIPE and record.motion == begun.motion for record in records)
    assert all(record.lit == pytest.approx(FLASH_US * 1e-6, abs=1e-4) and not record.faults for record in records)
    assert not session.board.lit and abs(session.board.position - steps[-1]) <= 1
    assert reports and reports[-1].motion == begun.motion and not reports[-1].moving


def test_the_time_between_triggers_is_move_settle_and_flash(session) -> None:
    """As the board's own motion record has it, to a tenth."""
    steps = prepare(session)
    motion_profile = motion(session)
    sweep(session)
    records, _ = finish(session)
    for before, after in zip(records, records[1:], strict=False):
        bound = motion_profile.time(after.step - before.step) + motion_profile.settle + FLASH_US * 1e-6
        assert bound * 0.95 <= after.clock - before.clock <= 1.1 * bound
    assert steps == sorted(steps)


@pytest.mark.parametrize("off", list(SweepOffFrames))
def test_off_frames_are_taken_in_the_dark(session, off: SweepOffFrames) -> None:
    """One before, or one after each stripe, or none."""
    prepare(session, off=off)
    sweep(session)
    records, _ = finish(session)
    kinds = [record.shot for record in records]
    stripe, dark = Shot.STRIPE, Shot.OFF
    wanted = {
        SweepOffFrames.NONE: [stripe] * STRIPES,
        SweepOffFrames.ONE: [dark, *[stripe] * STRIPES],
        SweepOffFrames.PER_STRIPE: [stripe, dark] * STRIPES,
    }
    assert kinds == wanted[off]
    to_come = STRIPES
    for record in records:
        to_come -= record.shot is Shot.STRIPE
        assert record.left == to_come
    assert all((record.lit > 0) == (record.shot is Shot.STRIPE) for record in records)


@pytest.mark.parametrize("off", list(SweepOffFrames))
def test_dark_flashes_follow_the_stripes_named(session, off: SweepOffFrames) -> None:
    """Besides the other off frames; they can be taken back, and a new session knows none."""
    prepare(session, off=off)
    for place in (1, 2, STRIPES - 1):
        assert session.ask(Request.SWEEP_DARK, 1 << 16 | place).result is Result.OK
    assert session.ask(Request.SWEEP_DARK, 2).result is Result.OK
    assert session.ask(Request.SWEEP_DARK, 1 << 16 | 512).result is Result.OUT_OF_RANGE
    assert session.ask(Request.SWEEP_DARK, 2 << 16).result is Result.OUT_OF_RANGE
    sweep(session)
    assert session.ask(Request.SWEEP_DARK, 1 << 16).result is Result.BUSY
    records, _ = finish(session)
    wanted = [Shot.OFF] if off is SweepOffFrames.ONE else []
    for place in range(STRIPES):
        wanted += [Shot.STRIPE, *[Shot.OFF] * ((off is SweepOffFrames.PER_STRIPE) + (place in (1, STRIPES - 1)))]
    assert [record.shot for record in records] == wanted
    assert all((record.lit > 0) == (record.shot is Shot.STRIPE) for record in records)
    assert [record.place for record in records if record.shot is Shot.STRIPE] == list(range(STRIPES))
    session.ask(Request.HELLO, HELLO)
    prepare(session)
    sweep(session, number=2)
    assert [record.shot for record in finish(session)[0]] == [Shot.STRIPE] * STRIPES


def test_a_period_and_waits_hold_triggers_back(session) -> None:
    """The camera's shortest period, and the waits of single places, in half milliseconds."""
    prepare(session, waits=(0, 0, 6, 0, 20, 0))
    sweep(session)
    plain, _ = finish(session)
    gaps = [after.clock - before.clock for before, after in zip(plain, plain[1:], strict=False)]
    assert gaps[1] - gaps[0] == pytest.approx(0.003, abs=2e-4)
    assert gaps[3] - gaps[2] == pytest.approx(0.010, abs=2e-4)
    assert session.ask(Request.SWEEP_PERIOD, 30_000).result is Result.OK
    session.ask(Request.GO_TO, plain[0].step)
    session.until_still()
    session.forget_reports()
    sweep(session, number=2)
    slow, _ = finish(session)
    gaps = [after.clock - before.clock for before, after in zip(slow, slow[1:], strict=False)]
    assert all(gap == pytest.approx(0.030, abs=2e-4) for gap in gaps)


def test_a_sweep_may_be_repeated_by_its_number(session) -> None:
    """The same number changes nothing, while it runs and after it; another begins a new one."""
    prepare(session)
    first = sweep(session, number=5)
    assert sweep(session, number=5).motion == first.motion
    finish(session)
    again = sweep(session, number=5)
    assert again.result is Result.OK and again.motion == first.motion and not again.moving
    assert sweep(session, number=6, first=2, stripes=3).motion == first.motion + 1
    records, _ = finish(session)
    assert [record.place for record in records] == [2, 3, 4]


def test_what_cannot_be_swept_is_refused(session) -> None:
    identity = session.identity()
    session.until_still()
    assert sweep(session).result is Result.NOT_HOMED
    prepare(session)
    for argument in (0, identity.min_step - 1, identity.max_step + 1, 0xFFFF):
        assert session.ask(Request.SWEEP_STEP, argument).result is Result.OUT_OF_RANGE
    for microseconds in (0, 199, 20_001, -1):
        assert session.ask(Request.SWEEP_FLASH, microseconds).result is Result.OUT_OF_RANGE
    assert session.ask(Request.SWEEP_OFF_FRAMES, 3).result is Result.OUT_OF_RANGE
    assert session.ask(Request.SWEEP_PERIOD, -1).result is Result.OUT_OF_RANGE
    assert sweep(session, stripes=0).result is Result.OUT_OF_RANGE
    assert sweep(session, stripes=STRIPES + 1).result is Result.OUT_OF_RANGE
    assert sweep(session, first=510, stripes=3).result is Result.OUT_OF_RANGE
    session.ask(Request.GO_TO, identity.max_step)
    assert sweep(session).result is Result.BUSY
    session.until_still()
    session.board.inject("hot", 70)
    session.board.wait(0.01)
    assert sweep(session).result is Result.LASER_REFUSED


def test_nothing_else_is_done_meanwhile(session) -> None:
    """Commands that would disturb a sweep are refused; STATUS is not."""
    prepare(session)
    sweep(session)
    for request, argument in (
        (Request.LASER, 1),
        (Request.HOME, 0),
        (Request.GO_TO, session.identity().max_step),
        (Request.SWEEP_STEP, session.identity().zero_step),
        (Request.SWEEP_FLASH, 3000),
        (Request.TOP_SPEED, 1000),
    ):
        assert session.ask(request, argument).result is Result.BUSY
    assert sweep(session, number=9).result is Result.BUSY
    records, _ = finish(session)
    assert len(records) == STRIPES


@pytest.mark.parametrize(
    "request_", [(Request.HALT, 0), (Request.LASER, 0), (Request.GOODBYE, 0), (Request.HELLO, HELLO)]
)
def test_one_command_ends_it_in_the_dark(session, request_: tuple[Request, int]) -> None:
    prepare(session, stripes=20)
    sweep(session, stripes=20)
    session.board.wait(0.06)
    status = session.ask(*request_)
    assert BoardFlag.SWEEPING not in status.flags and not session.board.lit
    session.board.wait(0.1)
    assert not session.board.lit
    records = []
    while (data := session.board.report()) is not None:
        records += [StripeRecord.unpack(data)] if len(data) == 32 else []
    assert len(records) < 20


def test_a_silent_host_ends_it(session) -> None:
    """Flashes feed no watchdog."""
    prepare(session, stripes=30)
    session.ask(Request.SWEEP_PERIOD, 20_000)
    sweep(session, stripes=30)
    session.board.wait(session.identity().watchdog + 0.002)
    assert not session.board.lit
    session.board.wait(0.05)
    assert not session.board.lit
    status = session.ask(Request.STATUS)
    assert status.faults == BoardFault.WATCHDOG and BoardFlag.SWEEPING not in status.flags


def test_a_dead_laser_ends_it(session) -> None:
    prepare(session)
    session.board.inject("dead")
    sweep(session)
    records, _ = finish(session)
    assert len(records) == 1 and BoardFault.LASER_DEAD in session.ask(Request.STATUS).faults


def test_flashes_add_up_to_the_time_limit(session) -> None:
    """10 s of light in sweeps that follow each other without a rest; the time between flashes does not count."""
    prepare(session, stripes=2)
    session.ask(Request.SWEEP_FLASH, 20_000)
    session.ask(Request.SETTLE, 60_000)
    for number in range(3):
        session.ask(Request.GO_TO, session.identity().zero_step)
        session.until_still()
        session.forget_reports()
        assert sweep(session, stripes=2, number=number).result is Result.OK
        records, _ = finish(session)
        assert [record.lit for record in records] == pytest.approx([0.02, 0.02], abs=2e-4)
    assert not session.ask(Request.STATUS).faults


def wire(bench, **shutter: object) -> None:
    bench.board.wire(**shutter)


def test_with_exposures_counted_the_laser_shines_only_while_the_camera_exposes(session) -> None:
    """A flash longer than the exposure ends with it."""
    prepare(session)
    wire(session, exposure=0.0012)
    assert BoardFlag.COUNTS_EXPOSURES in session.ask(Request.STATUS).flags
    sweep(session)
    records, _ = finish(session)
    assert [record.exposures for record in records] == [1] * STRIPES
    for record in records:
        assert record.exposure == pytest.approx(0.0012, abs=1e-4) and record.delay == pytest.approx(5e-5, abs=5e-5)
        assert record.lit == pytest.approx(0.0012, abs=1e-4)


def test_a_missed_trigger_is_counted_as_no_exposure(session) -> None:
    """The laser stays dark for it, and the sweep goes on."""
    prepare(session)
    wire(session, miss_from=2, exposure=0.001)
    sweep(session)
    records, _ = finish(session)
    assert [record.exposures for record in records] == [1, 1, 0, 0, 0, 0]
    assert [record.lit > 0 for record in records] == [True, True, False, False, False, False]


def test_without_the_wire_exposures_are_not_counted(session) -> None:
    prepare(session)
    assert BoardFlag.COUNTS_EXPOSURES not in session.ask(Request.STATUS).flags
    sweep(session)
    records, _ = finish(session)
    assert [record.exposures for record in records] == [0] * STRIPES


def test_settling_and_speed_can_be_set(session) -> None:
    """For the session: HELLO brings back what the board was built with."""
    session.until_still()
    built = motion(session)
    assert session.ask(Request.SETTLE, 5000).result is Result.OK
    assert session.ask(Request.TOP_SPEED, round(built.top_speed) - 1000).result is Result.OK
    changed = motion(session)
    assert changed.settle == pytest.approx(0.005) and changed.top_speed == round(built.top_speed) - 1000
    for request, value in ((Request.SETTLE, 0), (Request.TOP_SPEED, -5), (Request.TOP_SPEED, 0)):
        assert session.ask(request, value).result is Result.OUT_OF_RANGE
    session.ask(Request.HELLO, HELLO)
    assert motion(session) == built
