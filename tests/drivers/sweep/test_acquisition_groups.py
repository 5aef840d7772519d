"""Stripes handed over in groups: composition of the groups, and no loss however a scan ends."""

import threading

import pytest

from drivers import AcquireOptions, LaserBoard, OffFrames, StripeStream, acquire, timing
from drivers.board.protocol import Request
from drivers.errors import BoardUnplugged
from testbed.bench_board import BenchBoard, BenchCamera, Fault, FaultKind

pytestmark = pytest.mark.usefixtures("emulated_time")


def options(**more: object) -> AcquireOptions:
    return AcquireOptions(off=OffFrames.ONE, frame_timeout=20.0, **more)


SIZES = {1: [1] * 11, 3: [3, 3, 3, 1, 1], 4: [4, 4, 2, 1], 100: [7, 2, 1, 1]}
"""Sizes of the groups of eleven stripes, by `together`."""


@pytest.mark.parametrize("together", SIZES)
def test_stripes_together_arrive_in_order_and_the_last_alone(
    board: LaserBoard, camera: BenchCamera, firing_order: list, together: int
) -> None:
    """A group is handed over after its last stripe was fired; the last stripe of the scan is alone."""
    with acquire(board, camera, firing_order[:11], options(together=together, queue_size=80)) as stream:
        fired_before = [(stripe.index, len(stream.report.fired)) for stripe in stream]
        assert stream.report.in_step
    assert [index for index, _ in fired_before] == list(range(11))
    begin = 0
    for size in SIZES[together]:
        assert fired_before[begin][1] >= begin + size
        begin += size
    assert fired_before[-1][1] == 11


def test_stripes_that_wait_for_their_group_are_handed_over_when_the_scan_is_stopped(
    board: LaserBoard, camera: BenchCamera, firing_order: list
) -> None:
    """Stripes of an incomplete group are not lost when a pause ends."""
    streams: list[StripeStream] = []
    is_there = threading.Event()

    def pause_is_over() -> bool:
        # Called from the scan thread, which may be ahead of this one.
        assert is_there.wait(180.0)
        return len(streams[0]._worker.fired) > 6

    choices = options(together=5, queue_size=80)
    with acquire(board, camera, firing_order, choices, should_stop=pause_is_over) as stream:
        streams.append(stream)
        is_there.set()
        taken = [stripe.index for stripe in stream]
    assert taken == list(range(6)) and stream.report.stopped_early


@pytest.mark.parametrize("together", SIZES)
def test_groups_hold_the_stripes_that_are_handed_over_together(
    board: LaserBoard, camera: BenchCamera, firing_order: list, together: int
) -> None:
    """Groups have the requested size, at most twice the remaining number, and the last stripe alone."""
    with acquire(board, camera, firing_order[:11], options(together=together)) as stream:
        groups = [[stripe.index for stripe in group] for group in stream.groups()]
        assert stream.report.in_step
    assert [len(group) for group in groups] == SIZES[together]
    assert [index for group in groups for index in group] == list(range(11))


def test_a_scan_of_one_stripe_is_one_group(board: LaserBoard, camera: BenchCamera, firing_order: list) -> None:
    """The first stripe is the last one."""
    with acquire(board, camera, firing_order[:1], options(together=8)) as stream:
        assert [len(group) for group in stream.groups()] == [1]


def test_what_is_left_of_a_group_comes_next(board: LaserBoard, camera: BenchCamera, firing_order: list) -> None:
    """A caller that leaves its loop and starts another loses nothing; the report has only handed-over stripes."""
    with acquire(board, camera, firing_order[:9], options(together=4)) as stream:
        for stripe in stream:
            if stripe.index == 1:
                break
        assert [index for index, _ in stream.report.verdicts] == [0, 1]
        groups = [[stripe.index for stripe in group] for group in stream.groups()]
    assert groups == [[2, 3], [4, 5, 6], [7], [8]]


def test_stripes_that_wait_for_their_group_are_handed_over_when_the_scan_fails(
    board: LaserBoard, camera: BenchCamera, emulated: BenchBoard, firing_order: list
) -> None:
    """If the board is unplugged within a group, only later stripes are lost."""
    board.ensure_ready()
    emulated.inject(Fault(FaultKind.UNPLUG, Request.GO_TO, skip=7))
    taken: list[int] = []
    with acquire(board, camera, firing_order, options(together=5)) as stream:
        with pytest.raises(BoardUnplugged):
            for group in stream.groups():
                taken += [stripe.index for stripe in group]
        assert taken == list(range(6))
        assert stream.report.fired == tuple(range(7))


def test_a_board_lost_while_the_scan_waits_for_the_caller_costs_no_stripe_that_was_taken(
    board: LaserBoard, camera: BenchCamera, emulated: BenchBoard, firing_order: list, eventually
) -> None:
    """The laser cannot be turned off for the wait, which ends the scan; the waiting group is handed over."""
    board.ensure_ready()
    emulated.inject(Fault(FaultKind.UNPLUG, Request.LASER, skip=2))
    with acquire(board, camera, firing_order, options(together=2, queue_size=2)) as stream:
        eventually(lambda: not emulated.plugged)
        taken = []
        with pytest.raises(BoardUnplugged):
            for stripe in stream:
                taken.append(stripe.index)
    assert taken == list(range(4))


def test_a_slow_caller_of_groups_makes_the_scan_wait_in_the_dark(
    board: LaserBoard, camera: BenchCamera, emulated: BenchBoard, firing_order: list, eventually
) -> None:
    """The size of the queue is rounded up to whole groups."""
    with acquire(board, camera, firing_order[:20], options(together=3, queue_size=4)) as stream:
        groups = stream.groups()
        taken = [stripe.index for stripe in next(groups)]
        eventually(lambda: len(stream.report.fired) == 12 and not emulated.view().laser_on)
        timing.sleep(0.05)
        assert len(stream.report.fired) == 12 and not emulated.view().laser_on
        taken += [stripe.index for group in groups for stripe in group]
        assert stream.report.in_step and stream.report.frames_dropped == 0
    assert taken == list(range(20))
