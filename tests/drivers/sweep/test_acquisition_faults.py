"""Faults of board and camera at every phase of a scan: no wrong stripe is handed over; the next scan is complete."""

import pytest

from drivers import AcquireOptions, BoardConfig, DriverError, LaserBoard, OffFrames, StripeVerdict, acquire
from drivers.board.protocol import Request
from drivers.errors import BoardError, CameraTimeout, LaserDead, LaserRefused, LaserStuckOn
from testbed.bench_board import BenchBoard, BenchCamera, CameraFault, Fault, FaultKind, bench_backend

FIRING_ORDER = [(index, -0.1 + 0.02 * index) for index in range(12)]
PHASES = {  # Place in the scan at which a transfer fails: command, and number of transfers that pass first.
    "before the first stripe": (Request.GO_TO, 0),
    "laser on": (Request.LASER, 1),
    "turning in mid scan": (Request.GO_TO, 6),
    "last stripe": (Request.GO_TO, 11),
}
TRANSFER_FAULTS = [
    FaultKind.UNPLUG,
    FaultKind.UNPLUG_AFTER,
    FaultKind.STALL,
    FaultKind.TIMEOUT,
    FaultKind.TIMEOUT_AFTER,
    FaultKind.SHORT_READ,
    FaultKind.GARBAGE,
]

pytestmark = pytest.mark.usefixtures("emulated_time")


def scan(board: LaserBoard, camera: BenchCamera, off: OffFrames = OffFrames.ONE):
    """Run a scan; return its stripes, its report and the error that ended it."""
    taken, failure = [], None
    choices = AcquireOptions(off=off, frame_timeout=0.5)
    with acquire(board, camera, FIRING_ORDER, choices) as stripes:
        try:
            for stripe in stripes:
                taken.append(stripe)
        except DriverError as error:
            failure = error
    return taken, stripes.report, failure


@pytest.fixture
def quick_board(emulated: BenchBoard):
    device = LaserBoard(BoardConfig(timeout=0.02), backend=bench_backend(emulated))
    device.open()
    yield device
    emulated.mend()
    emulated.replug()
    device.close()


def next_scan_is_whole(board: LaserBoard, camera: BenchCamera, emulated: BenchBoard) -> None:
    emulated.mend()
    emulated.replug()
    camera.faults.clear()
    taken, report, failure = scan(board, camera)
    assert failure is None and len(taken) == len(FIRING_ORDER) and report.in_step and not report.problems


@pytest.mark.slow
@pytest.mark.parametrize("phase", PHASES)
@pytest.mark.parametrize("kind", TRANSFER_FAULTS)
def test_single_transfer_faults(
    quick_board: LaserBoard, camera: BenchCamera, emulated: BenchBoard, kind: FaultKind, phase: str
) -> None:
    """A retry hides a transient fault; an unplugged board ends the scan with the stripes so far."""
    request, skip = PHASES[phase]
    quick_board.ensure_ready()
    emulated.inject(Fault(kind, request, skip=skip))
    taken, report, failure = scan(quick_board, camera)
    if kind in (FaultKind.UNPLUG, FaultKind.UNPLUG_AFTER):
        assert isinstance(failure, BoardError) and "left the bus" in str(failure)
        assert report.failure == str(failure) and report.missing
    else:
        assert failure is None and report.in_step and not report.missing
    assert all(stripe.verdict is StripeVerdict.OK for stripe in taken)
    assert not emulated.view().laser_on
    next_scan_is_whole(quick_board, camera, emulated)


@pytest.mark.parametrize("kind", TRANSFER_FAULTS[2:])
def test_lasting_transfer_faults_end_the_scan(
    quick_board: LaserBoard, camera: BenchCamera, emulated: BenchBoard, kind: FaultKind
) -> None:
    """If all attempts fail, the scan ends with the typed error, the laser off, and the stripes so far."""
    quick_board.ensure_ready()
    emulated.inject(Fault(kind, Request.GO_TO, skip=6, count=3))
    taken, report, failure = scan(quick_board, camera)
    assert isinstance(failure, BoardError) and "3 attempts" in str(failure)
    assert 0 < len(taken) < len(FIRING_ORDER) and report.missing
    assert not emulated.view().laser_on
    next_scan_is_whole(quick_board, camera, emulated)


@pytest.mark.parametrize("off", list(OffFrames))
def test_dead_laser_ends_the_scan(
    quick_board: LaserBoard, camera: BenchCamera, emulated: BenchBoard, off: OffFrames
) -> None:
    """If the photodiode senses no light, the scan ends before a frame is taken for a stripe."""
    emulated.inject(Fault(FaultKind.LASER_STUCK_OFF))
    taken, report, failure = scan(quick_board, camera, off)
    assert isinstance(failure, LaserDead) and taken == [] and not report.in_step
    next_scan_is_whole(quick_board, camera, emulated)


@pytest.mark.parametrize("off", list(OffFrames))
def test_stuck_laser_ends_the_scan(
    quick_board: LaserBoard, camera: BenchCamera, emulated: BenchBoard, off: OffFrames, eventually
) -> None:
    """A laser that stays on ends the scan with an error, and the board's relay turns it off."""
    emulated.inject(Fault(FaultKind.LASER_STUCK_ON))
    _, _, failure = scan(quick_board, camera, off)
    assert isinstance(failure, LaserStuckOn)
    eventually(lambda: not emulated.view().laser_on)
    with pytest.raises(LaserRefused), acquire(quick_board, camera, FIRING_ORDER):
        pytest.fail("a board with a stuck laser must not begin")
    next_scan_is_whole(quick_board, camera, emulated)


def test_dead_laser_behind_a_blind_sensor_shows_in_the_pictures(
    quick_board: LaserBoard, camera: BenchCamera, emulated: BenchBoard
) -> None:
    """Every stripe is dark, nothing is proved, and the report gives the reason."""
    emulated.inject(Fault(FaultKind.BLIND_SENSOR))
    emulated.inject(Fault(FaultKind.LASER_STUCK_OFF))
    taken, report, failure = scan(quick_board, camera, OffFrames.PER_STRIPE)
    assert failure is None and {stripe.verdict for stripe in taken} == {StripeVerdict.DARK}
    assert not report.in_step and any("no stripe shows the laser" in problem for problem in report.problems)
    next_scan_is_whole(quick_board, camera, emulated)


def test_stuck_laser_behind_a_blind_sensor_shows_in_the_pictures(
    quick_board: LaserBoard, camera: BenchCamera, emulated: BenchBoard
) -> None:
    """Off frames that show a stripe are leaks, or hide the stripe before the mirror turned: none is in step."""
    emulated.inject(Fault(FaultKind.BLIND_SENSOR))
    emulated.inject(Fault(FaultKind.LASER_STUCK_ON))
    taken, report, _ = scan(quick_board, camera, OffFrames.PER_STRIPE)
    kinds = [stripe.verdict for stripe in taken]
    assert StripeVerdict.LEAK in kinds and set(kinds) <= {StripeVerdict.LEAK, StripeVerdict.DARK}
    assert not report.in_step and any("light in the off frame" in problem for problem in report.problems)


def test_hot_board_ends_the_scan(quick_board: LaserBoard, camera: BenchCamera, emulated: BenchBoard) -> None:
    """Over-temperature ends the scan with a message and the laser off; once cool, the board scans again."""
    stop_at = 4
    choices = AcquireOptions(off=OffFrames.PER_STRIPE, queue_size=1)
    with pytest.raises(LaserRefused, match="too hot"), acquire(quick_board, camera, FIRING_ORDER, choices) as stripes:
        for stripe in stripes:
            if stripe.index == stop_at:
                emulated.inject(Fault(FaultKind.HOT, amount=65))
    assert not emulated.view().laser_on
    next_scan_is_whole(quick_board, camera, emulated)


@pytest.mark.parametrize("off", list(OffFrames))
@pytest.mark.parametrize("kind", ["drop", "repeat"])
def test_dropped_and_repeated_frames_cost_time_but_no_truth(
    quick_board: LaserBoard, camera: BenchCamera, emulated: BenchBoard, kind: str, off: OffFrames
) -> None:
    """The counter reveals them; the scan uses the next frame instead, and counts them."""
    quick_board.ensure_ready()
    camera.faults += [CameraFault(kind, number) for number in range(0, 4000, 5)]
    taken, report, failure = scan(quick_board, camera, off)
    assert failure is None and report.in_step and not report.missing
    counted = report.frames_dropped if kind == "drop" else report.frames_repeated
    assert counted > 0
    assert any("dropped" in problem or "twice" in problem for problem in report.problems)
    assert all(stripe.verdict.in_step for stripe in taken)


@pytest.mark.parametrize("off", list(OffFrames))
def test_frozen_camera_is_found_out(
    quick_board: LaserBoard, camera: BenchCamera, emulated: BenchBoard, off: OffFrames
) -> None:
    """New numbers with an old image: no stripe taken meanwhile counts as in step."""
    quick_board.ensure_ready()
    first = camera.grab(5.0)
    camera.faults.append(CameraFault("freeze", first.counter + 1, 10**6))
    taken, report, _ = scan(quick_board, camera, off)
    assert not report.in_step
    kinds = {stripe.verdict for stripe in taken}
    assert kinds <= {StripeVerdict.REPEATED, StripeVerdict.UNPROVED} and StripeVerdict.REPEATED in kinds
    assert any("frozen" in problem for problem in report.problems)
    next_scan_is_whole(quick_board, camera, emulated)


def test_silent_camera_ends_the_scan(quick_board: LaserBoard, camera: BenchCamera, emulated: BenchBoard) -> None:
    """After two stripes in a row without a frame the scan ends; a fired stripe without a frame is lost."""
    camera.faults.append(CameraFault("silence", 0, 10**6))
    taken, report, failure = scan(quick_board, camera, OffFrames.NONE)
    assert isinstance(failure, CameraTimeout) and "2 stripes in a row" in str(failure)
    assert [stripe.verdict for stripe in taken] == [StripeVerdict.LOST] and taken[0].on is None
    assert report.fired == (0, 1) and not emulated.view().laser_on
    next_scan_is_whole(quick_board, camera, emulated)


@pytest.mark.parametrize("off", [OffFrames.ONE, OffFrames.PER_STRIPE])
def test_lost_off_frame_is_reported(
    quick_board: LaserBoard, camera: BenchCamera, emulated: BenchBoard, off: OffFrames
) -> None:
    """A stripe without its off frame is compared with the previous one, and the loss is reported."""
    quick_board.ensure_ready()
    real, lost = camera.grab, []

    def grab(timeout: float):
        frame = real(timeout)
        fired = stream._worker.fired
        dark = not emulated.view().laser_on
        if dark and len(fired) == (0 if off is OffFrames.ONE else 3):
            lost.append(frame.counter)
            raise CameraTimeout("nothing")
        return frame

    camera.grab = grab  # type: ignore[method-assign]
    stream = acquire(quick_board, camera, FIRING_ORDER, AcquireOptions(off=off, frame_timeout=0.1))
    with stream as stripes:
        taken = list(stripes)
    assert lost and any("off frames that did not arrive: 1" in problem for problem in stripes.report.problems)
    without = [stripe.index for stripe in taken if stripe.off is None]
    assert without == (list(range(12)) if off is OffFrames.ONE else [2])
    assert all(stripe.verdict.in_step for stripe in taken)


@pytest.mark.parametrize("off", list(OffFrames))
def test_changed_size_is_not_handed_out(
    quick_board: LaserBoard, camera: BenchCamera, emulated: BenchBoard, off: OffFrames
) -> None:
    """An image of another size is not used: its stripe has no frame."""
    quick_board.ensure_ready()
    seen: list[int] = []
    real = camera.grab

    def grab(timeout: float):
        frame = real(timeout)
        if len(seen) == 8 and not camera.faults:
            camera.faults.append(CameraFault("resize", frame.counter + 1, 10**6))
        seen.append(frame.counter)
        return frame

    camera.grab = grab  # type: ignore[method-assign]
    taken, report, _ = scan(quick_board, camera, off)
    camera.grab = real  # type: ignore[method-assign]
    resized = [stripe for stripe in taken if stripe.verdict is StripeVerdict.RESIZED]
    assert resized and all(stripe.on is None for stripe in resized) and not report.in_step
    shapes = {stripe.on.shape for stripe in taken if stripe.on is not None}
    assert len(shapes) == 1
    next_scan_is_whole(quick_board, camera, emulated)


def test_changed_exposure_is_reported(quick_board: LaserBoard, camera: BenchCamera, emulated: BenchBoard) -> None:
    """A camera that doubles its exposure after the off frame changes the whole image."""
    quick_board.ensure_ready()
    first = camera.grab(5.0)
    camera.faults.append(CameraFault("brighten", first.counter + 40, 10**6))
    many = [(index, -0.1 + 0.004 * index) for index in range(60)]
    with acquire(quick_board, camera, many, AcquireOptions(off=OffFrames.ONE, frame_timeout=20.0)) as stripes:
        kinds = [stripe.verdict for stripe in stripes]
    assert kinds[-1] is StripeVerdict.AMBIENT_CHANGED
    assert any("exposure changed" in problem for problem in stripes.report.problems)


@pytest.mark.parametrize("kind", [FaultKind.NO_HOME_SWITCH, FaultKind.JAMMED])
def test_a_mirror_that_cannot_move_prevents_the_scan(
    camera: BenchCamera, another_board: BenchBoard, kind: FaultKind
) -> None:
    """Mechanical faults end the scan before the first stripe, with the laser off."""
    another_board.inject(Fault(kind))
    config = BoardConfig(home_timeout=0.3, motion_timeout=0.3)
    with LaserBoard(config, backend=bench_backend(another_board)) as board:
        with pytest.raises(BoardError), acquire(board, camera, FIRING_ORDER):
            pytest.fail("the scan must not begin")
        assert not another_board.view().laser_on
