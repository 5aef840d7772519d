"""Reports of the board contain the time of their event, which the driver uses even if it fetches them late."""

import time
from collections.abc import Iterator

import pytest

from drivers import BoardConfig, LaserBoard
from drivers.board.board_records import BoardStatus
from drivers.board.protocol import PROTOCOL_MAJOR, BoardFault, Request
from drivers.emulator import EmulatorConfig
from testbed.bench_board import BenchBoard, Fault, FaultKind, bench_backend
from testbed.remote_board import remote_backend

SETTLE = 0.003
FAR = 3000  # [steps]
MILLISECOND = 0.001


class Bench:
    """Homed board with the laser on and no report waiting, whose time is set by the test."""

    def __init__(self, mirror_speed: float = 7.0) -> None:
        self.now = 100.0
        config = EmulatorConfig(settle=SETTLE, mirror_speed=mirror_speed)
        self.board = BenchBoard(config, clock=lambda: self.now)
        self.ask(Request.HELLO, PROTOCOL_MAJOR << 8)
        self.ask(Request.HOME)
        self.now += 5.0
        self.ask(Request.LASER, 1)
        while self.board.next_report() is not None:
            pass

    def ask(self, request: Request, argument: int = 0) -> BoardStatus:
        data = self.board.serve(request, argument)
        assert data is not None
        return BoardStatus.unpack(data)

    def fetch(self) -> BoardStatus | None:
        data = self.board.next_report()
        return None if data is None else BoardStatus.unpack(data)

    @property
    def travel_time(self) -> float:
        """Time from home to FAR [s]."""
        config = self.board.config
        return (FAR - config.identity.min_step) * config.identity.step_angle / config.mirror_speed


def test_report_of_a_motion_holds_the_time_at_which_it_had_settled() -> None:
    """Not the time at which it is fetched; and no report before that time."""
    bench = Bench()
    begun = bench.ask(Request.GO_TO, FAR)
    bench.now += bench.travel_time + 0.5 * SETTLE
    assert bench.fetch() is None
    bench.now += 0.3
    report = bench.fetch()
    assert report is not None and report.motion == begun.motion and not report.moving and report.step == FAR
    assert report.device_time - begun.device_time == pytest.approx(bench.travel_time + SETTLE, abs=MILLISECOND)
    assert bench.fetch() is None


@pytest.mark.parametrize("seconds", [0.1, 0.8])
def test_report_of_a_motion_holds_the_laser_as_it_was_then(seconds: float) -> None:
    """A later action of the watchdog has its own report."""
    bench = Bench()
    bench.ask(Request.GO_TO, FAR)
    assert bench.travel_time + SETTLE < 0.5
    bench.now += seconds
    report, later = bench.fetch(), bench.fetch()
    assert report is not None and report.laser_commanded and report.laser_sensed and not report.faults
    if seconds < 0.5:
        assert later is None
    else:
        assert later is not None and not later.laser_commanded and later.faults == BoardFault.WATCHDOG


def test_report_of_a_motion_longer_than_the_watchdog_says_that_the_laser_was_off() -> None:
    """The report includes what happened before the end of the motion, even without a request in between."""
    bench = Bench(mirror_speed=0.3)
    begun = bench.ask(Request.GO_TO, FAR)
    assert bench.travel_time > 1.0
    bench.now += 3.0
    report = bench.fetch()
    assert report is not None and not report.moving and not report.laser_commanded
    assert report.faults == BoardFault.WATCHDOG
    assert report.device_time - begun.device_time == pytest.approx(bench.travel_time + SETTLE, abs=MILLISECOND)
    assert bench.fetch() is None


def test_oldest_reports_are_dropped() -> None:
    """A host that fetched none gets the newest reports; a motion that another one replaced has none."""
    bench = Bench()
    for index in range(9):
        bench.ask(Request.GO_TO, 100 + 10 * index)
        bench.ask(Request.GO_TO, 105 + 10 * index)
        bench.now += 0.1
        bench.ask(Request.STATUS)
    reports = list(iter(bench.fetch, None))
    newest = bench.ask(Request.STATUS).motion
    assert 1 <= len(reports) < 9 and [report.step for report in reports][-1] == 185
    assert [report.motion for report in reports] == list(range(newest - 2 * len(reports) + 2, newest + 1, 2))


def test_halted_motion_is_reported_and_a_board_without_power_forgets() -> None:
    """A halt ends a motion; power-up discards all reports."""
    bench = Bench()
    bench.ask(Request.GO_TO, FAR)
    bench.now += 0.01
    halted = bench.ask(Request.HALT)
    bench.now += 1.0
    report = bench.fetch()
    assert report is not None and report.step < FAR and not report.moving
    assert report.device_time - halted.device_time == pytest.approx(SETTLE, abs=MILLISECOND)
    bench.ask(Request.GO_TO, FAR)
    bench.now += 1.0
    bench.board.unplug()
    bench.board.replug()
    bench.now += 1.0
    assert bench.fetch() is None


class Skewed:
    """Clock of the board, with an origin and a rate that may differ from those of the host."""

    def __init__(self, offset: float = 0.0, rate: float = 1.0) -> None:
        self.offset, self.rate = offset, rate
        self._begin = time.monotonic()

    def __call__(self) -> float:
        return self._begin + self.offset + self.rate * (time.monotonic() - self._begin)

    def on_host(self, instant: float) -> float:
        """Host time at an instant of this clock [s]."""
        return self._begin + (instant - self._begin - self.offset) / self.rate


@pytest.fixture(params=["same", "wraps", "slow", "fast"])
def skewed(request: pytest.FixtureRequest) -> Iterator[tuple[LaserBoard, BenchBoard, Skewed]]:
    clock = Skewed(rate={"slow": 0.991, "fast": 1.05}.get(request.param, 1.0))
    emulated = BenchBoard(EmulatorConfig(mirror_speed=2.0), clock=clock)
    with LaserBoard(backend=bench_backend(emulated)) as board:
        board.home()
        if request.param == "wraps":
            # The next motion, of 0.2 s, begins before the wrap and ends after it.
            clock.offset = (1 << 32) * MILLISECOND - board.status().device_time - 0.1
        yield board, emulated, clock


@pytest.mark.slow
@pytest.mark.parametrize("asleep", [0.0, 0.35])
def test_end_of_a_motion_is_known_also_when_asked_late(
    skewed: tuple[LaserBoard, BenchBoard, Skewed], asleep: float
) -> None:
    """The reported time is never too early and hardly late, for clocks of any origin and rate."""
    board, emulated, clock = skewed
    board.go_to_angle(board.identity.angle_of(board.identity.min_step) + 0.4, wait=False)
    time.sleep(asleep)
    status, since = board.still_since()
    truth = clock.on_host(emulated.still_at())
    assert not status.moving and status.laser_commanded is False
    assert truth <= since <= time.monotonic()
    if asleep:
        assert since == pytest.approx(truth, abs=0.03), "it does not count from when one asked"


@pytest.mark.parametrize("kind", [FaultKind.GARBAGE, FaultKind.SHORT_READ, FaultKind.STALL, FaultKind.TIMEOUT])
def test_status_stands_in_for_a_report_that_is_lost(kind: FaultKind) -> None:
    """The time of the status is then the only time at which the mirror is known to be at rest."""
    emulated = BenchBoard(EmulatorConfig())
    with LaserBoard(backend=bench_backend(emulated)) as board:
        board.home()
        board.go_to_angle(0.1, wait=False)
        time.sleep(0.2)
        emulated.inject(Fault(kind, "report"))
        asked = time.monotonic()
        status, since = board.still_since()
        assert not status.moving and asked - 0.002 <= since <= time.monotonic()


def test_clock_that_went_back_is_not_believed(board: LaserBoard, emulated: BenchBoard) -> None:
    """A report older than its command is not used; the mirror counts as at rest from now on."""
    board.home()
    board.go_to_angle(0.1, wait=False)
    time.sleep(0.1)
    board._board_time += 5.0
    asked = time.monotonic()
    assert asked <= board.still_since()[1] <= time.monotonic()


def test_reports_of_earlier_motions_are_passed_over(board: LaserBoard, emulated: BenchBoard) -> None:
    """Reports that were not fetched, as in a scan that lost frames, are skipped."""
    board.home()
    for angle in (0.1, 0.12, 0.14):
        board.go_to_angle(angle, wait=False)
        time.sleep(0.05)
    begun = time.monotonic()
    board.go_to_angle(0.3, wait=False)
    assert board.still_since()[1] >= begun
    assert not emulated.view().moving


def test_mirror_that_stands_is_still_now(board: LaserBoard) -> None:
    """Without a motion, the status is read."""
    board.home()
    sequence = board.status().sequence
    status, since = board.still_since()
    assert status.sequence == sequence + 1 and since <= time.monotonic() and not status.moving


def test_reports_of_another_process_hold_their_own_time(emulator_process) -> None:
    """A board reached over the socket behaves in the same way."""
    with LaserBoard(BoardConfig(), backend=remote_backend(emulator_process.address)) as board:
        board.ensure_ready()
        board.go_to_angle(0.0)
        begun = time.monotonic()
        board.go_to_angle(0.1, wait=False)
        time.sleep(0.4)
        status, since = board.still_since()
        assert not status.moving
        assert begun + 0.1 / 7.0 < since < begun + 0.2
