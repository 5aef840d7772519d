"""Whole scans in every mode with an emulated board and camera, and causes that put them out of step."""

import numpy as np
import pytest

from drivers import (
    AcquireOptions,
    LaserBoard,
    OffFrames,
    ReplayCamera,
    StripeVerdict,
    acquire,
    prepare,
    timing,
)
from drivers.board.protocol import BoardFault, Request
from drivers.errors import AcquisitionNotEntered, BadFiringOrder, CameraEnded, MirrorOutOfRange
from testbed.bench_board import BenchBoard, BenchCamera, Fault, FaultKind, bench_backend
from tests.drivers.sweep.scan_options import ALL_MODES, options

pytestmark = pytest.mark.usefixtures("emulated_time")


@pytest.mark.slow
@pytest.mark.parametrize("off", ALL_MODES)
def test_a_scan_brings_every_stripe_in_step(
    board: LaserBoard, camera: BenchCamera, emulated: BenchBoard, scene, firing_order: list, off: OffFrames
) -> None:
    """Each index occurs once and in order, and each image shows the stripe at its own mirror angle."""
    rows = []
    with acquire(
        board, camera, firing_order, options(off), band=lambda index: band_of(scene, firing_order[index][1])
    ) as stripes:
        for stripe in stripes:
            assert stripe.on is not None
            excess = stripe.on[:, :, 2].astype(int) - stripe.on[:, :, 1]
            rows.append(int(excess.mean(axis=1).argmax()))
            assert rows[-1] == pytest.approx(scene.row_of(stripe.mirror_angle), abs=2)
            assert stripe.mirror_angle_reached == pytest.approx(stripe.mirror_angle, abs=7e-5)
            assert (stripe.off is None) == (off is OffFrames.NONE)
            if stripe.off is not None:
                assert stripe.off[:, :, 2].max() < 60
        report = stripes.report
    assert report.planned == report.fired == tuple(index for index, _ in report.verdicts) == tuple(range(70))
    kinds = [verdict for _, verdict in report.verdicts]
    assert kinds[1:] == [StripeVerdict.OK] * 69
    assert kinds[0] is (StripeVerdict.UNPROVED if off is OffFrames.NONE else StripeVerdict.OK)
    assert report.in_step and not report.problems and not report.missing and not report.stopped_early
    assert report.frames_used == {OffFrames.PER_STRIPE: 140, OffFrames.ONE: 71, OffFrames.NONE: 70}[off]
    assert not emulated.view().laser_on


def band_of(scene, angle: float) -> tuple[int, int]:
    row = round(scene.row_of(angle))
    return row - 6, row + 7


def test_shared_off_frame_is_one_array(board: LaserBoard, camera: BenchCamera, firing_order: list) -> None:
    """With one off frame, all stripes have the same array, stamped before them."""
    with acquire(board, camera, firing_order[:5], options(OffFrames.ONE)) as stripes:
        taken = list(stripes)
    assert all(stripe.off is taken[0].off and stripe.off_stamp < stripe.on_stamp for stripe in taken)
    assert not taken[0].on.flags.writeable


@pytest.mark.slow
def test_even_stripes_first_stay_in_step(board: LaserBoard, camera: BenchCamera, firing_order: list) -> None:
    """Even stripes, then those in between: all in step, in the requested order."""
    order = sorted(firing_order, key=lambda stripe: stripe[0] % 2)
    with acquire(board, camera, order, options(OffFrames.ONE)) as stripes:
        taken = [stripe.index for stripe in stripes]
        assert stripes.report.in_step
    assert taken == [index for index, _ in order]


def test_replayed_frames_go_to_their_stripes(board: LaserBoard, scene, firing_order: list) -> None:
    """Frames are replayed in scan order; if there are too few, the scan fails and keeps its stripes."""
    frames = []
    for _, angle in firing_order[:4]:
        for lit in (1.0, 0.0):
            view = type("View", (), {"laser_fraction": lit, "mirror_angle": angle})()
            frames.append(scene(view, type("Settings", (), {"exposure": 0.002})()))
    with ReplayCamera(frames) as tape, acquire(board, tape, firing_order[:4], options(OffFrames.PER_STRIPE)) as stripes:
        for index, stripe in enumerate(stripes):
            np.testing.assert_array_equal(stripe.on, frames[2 * index])
            np.testing.assert_array_equal(stripe.off, frames[2 * index + 1])
        assert stripes.report.in_step
    with (
        ReplayCamera(frames[:5]) as tape,
        acquire(board, tape, firing_order[:4], options(OffFrames.PER_STRIPE)) as stripes,
    ):
        with pytest.raises(CameraEnded, match=r"no frames left \(5 were played\)"):
            list(stripes)
        assert [index for index, _ in stripes.report.verdicts] == [0, 1]
        assert "no frames left" in (stripes.report.failure or "")


def test_a_camera_of_unknown_lag_is_in_step_too(board: LaserBoard, camera: BenchCamera, firing_order: list) -> None:
    """Frames are dropped after every change instead."""
    camera.lag = None
    with acquire(board, camera, firing_order[:10], options(OffFrames.PER_STRIPE)) as stripes:
        assert len(list(stripes)) == 10
        report = stripes.report
    assert report.in_step and report.frames_skipped >= 2 * 20


@pytest.mark.slow
def test_a_lag_set_too_short_is_found_out(emulated: BenchBoard, board: LaserBoard, scene, firing_order: list) -> None:
    """If the camera is slower than its `lag`, frames belong to earlier commands, which the proof detects."""
    with BenchCamera(emulated, scene, fps=100.0, exposure=0.002, latency=0.015) as camera:
        camera.lag = 0.0
        with acquire(board, camera, firing_order[:20], options(OffFrames.PER_STRIPE)) as stripes:
            list(stripes)
        assert not stripes.report.in_step
        assert any("lag" in problem for problem in stripes.report.problems)


def test_prepare_counts_the_steps_lost_in_a_scan(
    board: LaserBoard, camera: BenchCamera, emulated: BenchBoard, firing_order: list
) -> None:
    """Homing between scans detects what images cannot: a few steps lost during a scan."""
    assert prepare(board, firing_order) == 0
    emulated.inject(Fault(FaultKind.LOST_STEP, Request.GO_TO, skip=10, amount=12))
    with acquire(board, camera, firing_order[:20], options(OffFrames.ONE)) as stripes:
        list(stripes)
    assert prepare(board, firing_order) == 12
    assert emulated.view().mirror_angle == pytest.approx(firing_order[0][1], abs=1e-4)
    assert not board.status().faults
    assert prepare(board, firing_order) == 0


def test_a_large_loss_of_steps_shows_in_the_band(
    board: LaserBoard, camera: BenchCamera, emulated: BenchBoard, scene, firing_order: list
) -> None:
    """If the steps of two stripes are lost, stripes leave their possible rows."""
    emulated.inject(Fault(FaultKind.LOST_STEP, Request.GO_TO, skip=10, amount=160))
    bands = {index: band_of(scene, angle) for index, angle in firing_order}
    with acquire(board, camera, firing_order[:20], options(OffFrames.ONE), band=bands.__getitem__) as stripes:
        verdicts = {stripe.index: stripe.verdict for stripe in stripes}
    assert not stripes.report.in_step
    assert verdicts[5] is StripeVerdict.OK and verdicts[15] is StripeVerdict.OUT_OF_BAND


def test_a_scan_finds_home_and_clears_faults_by_itself(
    board: LaserBoard, camera: BenchCamera, emulated: BenchBoard, firing_order: list
) -> None:
    """A board scans directly after power-up."""
    emulated.unplug()
    emulated.replug()
    with acquire(board, camera, firing_order[:5], options(OffFrames.ONE)) as stripes:
        assert len(list(stripes)) == 5
        assert stripes.report.in_step


@pytest.mark.slow
def test_a_watchdog_that_bit_in_mid_scan_is_reported(emulated: BenchBoard, scene, firing_order: list) -> None:
    """After the host slept for 0.8 s, the scan goes on and reports that the laser was off meanwhile."""
    short = BenchBoard()
    with (
        LaserBoard(backend=bench_backend(short)) as board,
        BenchCamera(short, scene, fps=100.0, exposure=0.002) as camera,
    ):
        real, slept = camera.grab, []

        def grab(timeout: float):
            if len(slept) == 0 and short.view().laser_on:
                slept.append(timing.sleep(0.8))
            return real(timeout)

        camera.grab = grab  # type: ignore[method-assign]
        with acquire(board, camera, firing_order[:6], options(OffFrames.ONE)) as stripes:
            verdicts = [stripe.verdict for stripe in stripes]
        assert len(verdicts) == 6 and verdicts[0] is StripeVerdict.DARK
        assert any(
            "refused to switch the laser on because of a fault: 1" in problem for problem in stripes.report.problems
        )
        assert BoardFault.WATCHDOG not in board.status().faults


def test_misuse_is_refused_in_words(board: LaserBoard, camera: BenchCamera, firing_order: list) -> None:
    """A missing `with` block, no stripes, and an angle beyond the travel are rejected before anything moves."""
    with pytest.raises(AcquisitionNotEntered, match=r"with acquire\(\.\.\.\) as stripes"):
        list(acquire(board, camera, firing_order))
    with pytest.raises(AcquisitionNotEntered, match=r"with acquire\(\.\.\.\) as stripes"):
        list(acquire(board, camera, firing_order).groups())
    with pytest.raises(BadFiringOrder, match="the firing order is empty"):
        acquire(board, camera, [])
    with pytest.raises(MirrorOutOfRange, match="outside the board's travel"), acquire(board, camera, [(0, 1.0)]):
        pytest.fail("a firing order beyond the travel must not begin")


@pytest.mark.parametrize(
    ("changes", "expected_text"),
    [
        ({"frame_timeout": 0.0}, "frame_timeout is 0.0 s"),
        ({"max_lost": 0}, "max_lost is 0; it must be 1 or more"),
        ({"flush_frames": -1}, "flush_frames is -1; it must be 0 or more"),
        ({"queue_size": 0}, "queue_size is 0"),
        ({"together": 0}, "together is 0; it must be 1 or more"),
    ],
)
def test_bad_options_are_refused(changes: dict, expected_text: str) -> None:
    """Each field is checked, and the message contains the value."""
    with pytest.raises(ValueError, match=expected_text):
        AcquireOptions(**changes)
