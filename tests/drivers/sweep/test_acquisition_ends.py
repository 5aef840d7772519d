"""Every way in which a scan can end: complete, with the pause, by an error, by a hung camera; the laser is off."""

import time

import pytest

from drivers import (
    LaserBoard,
    OffFrames,
    StripeStream,
    acquire,
    timing,
)
from testbed.bench_board import BenchBoard, BenchCamera
from tests.drivers.sweep.scan_options import ALL_MODES, options

pytestmark = pytest.mark.usefixtures("emulated_time")


@pytest.mark.slow
@pytest.mark.parametrize("off", ALL_MODES)
@pytest.mark.parametrize("last", [0, 1, 34, 35, 69])
def test_a_pause_that_ends_leaves_a_partial_scan(
    board: LaserBoard, camera: BenchCamera, emulated: BenchBoard, firing_order: list, off: OffFrames, last: int
) -> None:
    """A scan stopped at stripe `last` has the stripes before it; the others are missing, the laser is off."""
    streams: list[StripeStream] = []

    def pause_is_over() -> bool:
        return bool(streams) and len(streams[0]._worker.fired) > last

    scan = acquire(board, camera, firing_order, options(off, queue_size=80), should_stop=pause_is_over)
    streams.append(scan)
    with scan as stream:
        taken = [stripe.index for stripe in stream]
        report = stream.report
    assert report.stopped_early and report.failure is None
    assert taken == list(range(last))
    assert report.fired == tuple(range(last + 1)), "a stripe that was lit but has no frame counts as fired"
    assert report.missing == tuple(range(last, 70))
    assert not emulated.view().laser_on
    with acquire(board, camera, firing_order[:3], options(off)) as again:
        assert len(list(again)) == 3


@pytest.mark.parametrize("together", [1, 5])
@pytest.mark.parametrize("off", ALL_MODES)
def test_a_stopped_scan_ends_with_a_dark_flash(
    board: LaserBoard,
    camera: BenchCamera,
    emulated: BenchBoard,
    firing_order: list,
    off: OffFrames,
    together: int,
) -> None:
    """The dark flash proves the stripes since the previous one, and its stripe is marked."""
    streams: list[StripeStream] = []
    choices = options(off, queue_size=80, together=together, dark_after=frozenset({2, 69}))
    scan = acquire(
        board,
        camera,
        firing_order,
        choices,
        should_stop=lambda: bool(streams) and len(streams[0]._worker.fired) > 10,
    )
    streams.append(scan)
    with scan as stream:
        taken = list(stream)
    assert [stripe.index for stripe in taken] == list(range(10)) and stream.report.failure is None
    assert [stripe.index for stripe in taken if stripe.dark is not None] == [2, 9]
    assert [stripe.index for stripe in taken if stripe.is_dark_due] == [2, 9]
    lit, dark = taken[-1].on, taken[-1].dark
    assert lit is not None and dark is not None and int(lit.max()) - int(dark.max()) > 50
    assert not emulated.view().laser_on


def test_a_scan_that_may_not_begin_is_empty(board: LaserBoard, camera: BenchCamera, firing_order: list) -> None:
    """In a pause that is already over, no stripe is fired."""
    with acquire(board, camera, firing_order, should_stop=lambda: True) as stripes:
        assert list(stripes) == []
        assert stripes.report.fired == () and not stripes.report.in_step


@pytest.mark.parametrize("off", ALL_MODES)
def test_an_exception_in_the_loop_puts_the_laser_out(
    board: LaserBoard, camera: BenchCamera, emulated: BenchBoard, firing_order: list, off: OffFrames
) -> None:
    """After any exception of the caller, the laser is off when the block is left, and stays off."""
    with pytest.raises(ZeroDivisionError), acquire(board, camera, firing_order, options(off)) as stripes:
        for stripe in stripes:
            if stripe.index == 5:
                raise ZeroDivisionError
    assert not emulated.view().laser_on
    events = len(emulated.switchings())
    timing.sleep(0.1)
    assert len(emulated.switchings()) == events


def test_laser_is_out_as_soon_as_the_scan_has_ended(
    board: LaserBoard, camera: BenchCamera, emulated: BenchBoard, firing_order: list
) -> None:
    """Not only when the block is left: the caller may still be processing the last stripe."""
    streams: list[StripeStream] = []
    scan = acquire(
        board,
        camera,
        firing_order,
        options(OffFrames.ONE),
        should_stop=lambda: bool(streams) and len(streams[0]._worker.fired) > 3,
    )
    streams.append(scan)
    with scan as stripes:
        assert len(list(stripes)) == 3
        assert not emulated.view().laser_on


def test_laser_goes_off_although_the_camera_hangs(
    board: LaserBoard, camera: BenchCamera, emulated: BenchBoard, firing_order: list
) -> None:
    """Leaving the block turns the laser off without waiting for the scan thread, which hangs in a grab."""
    real, outcome = camera.grab, []

    def grab(timeout: float):
        if not outcome and emulated.view().laser_on:
            deadline = time.monotonic() + 10.0
            while emulated.view().laser_on and time.monotonic() < deadline:
                time.sleep(0.002)
            outcome.append(not emulated.view().laser_on)
        return real(timeout)

    camera.grab = grab  # type: ignore[method-assign]
    with pytest.raises(ZeroDivisionError), acquire(board, camera, firing_order, options(OffFrames.ONE)):
        while not emulated.view().laser_on:
            time.sleep(0.002)
        raise ZeroDivisionError
    assert not emulated.view().laser_on
    assert outcome == [True]


def test_leaving_the_loop_early_ends_the_scan(
    board: LaserBoard, camera: BenchCamera, emulated: BenchBoard, firing_order: list
) -> None:
    """`break` suffices; the report lists the stripes that the caller received."""
    with acquire(board, camera, firing_order, options(OffFrames.ONE)) as stripes:
        for stripe in stripes:
            if stripe.index == 3:
                break
    assert not emulated.view().laser_on
    assert [index for index, _ in stripes.report.verdicts] == [0, 1, 2, 3]
    assert not stripes._worker.is_alive()


@pytest.mark.parametrize("off", [OffFrames.ONE, OffFrames.PER_STRIPE])
def test_a_slow_caller_makes_the_scan_wait_with_the_laser_off(
    board: LaserBoard, camera: BenchCamera, emulated: BenchBoard, firing_order: list, off: OffFrames, eventually
) -> None:
    """A full queue interrupts the scan, which then continues in step without dropped frames."""
    with acquire(board, camera, firing_order[:12], options(off, queue_size=2)) as stripes:
        iterator = iter(stripes)
        taken = [next(iterator)]
        eventually(lambda: stripes._worker.items.full() and not emulated.view().laser_on)
        timing.sleep(0.05)
        assert not emulated.view().laser_on
        taken += list(iterator)
        report = stripes.report
    assert [stripe.index for stripe in taken] == list(range(12))
    assert report.in_step and report.frames_dropped == 0
