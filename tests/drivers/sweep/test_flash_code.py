"""Flash code of a sweep: places of its dark flashes, and their execution by each kind of scan."""

from __future__ import annotations

from collections import Counter

import pytest

from drivers import AcquireOptions, LaserBoard, OffFrames, acquire, draw_code
from drivers.errors import CameraTimeout
from testbed.bench_board import BenchCamera, CameraFault
from tests.drivers.sweep.scan_options import ALL_MODES, options

CODE = frozenset({3, 31, 60, 69})


def test_one_lies_in_each_part_and_the_last_is_always_dark() -> None:
    """At most 6 % more frames in whole sweeps; all places but the last are equally likely."""
    counts: Counter[int] = Counter()
    for _ in range(400):
        code = sorted(draw_code(range(70)))
        assert len(code) == 4 and code[-1] == 69
        assert code[0] < 23 <= code[1] < 46 <= code[2] < 69
        counts.update(code[:-1])
    assert set(counts) == set(range(69)) and max(counts.values()) < 60
    coarse = draw_code(range(0, 70, 2))
    assert len(coarse) == 2 and 68 in coarse


@pytest.mark.parametrize(("count", "darks"), [(0, 0), (1, 1), (7, 1), (8, 2), (35, 2), (47, 3), (70, 4)])
def test_short_sweeps_have_fewer(count: int, darks: int) -> None:
    assert len(draw_code(range(count))) == darks


@pytest.mark.usefixtures("emulated_time")
@pytest.mark.parametrize("off", ALL_MODES)
def test_a_scan_step_by_step_takes_them(
    board: LaserBoard, camera: BenchCamera, firing_order: list, off: OffFrames
) -> None:
    """Dark frames follow the given stripes, at the cost of these frames only."""
    with acquire(board, camera, firing_order, options(off)) as plain:
        before = list(plain)
    with acquire(board, camera, firing_order, options(off, dark_after=CODE)) as stripes:
        taken = list(stripes)
    assert stripes.report.in_step and not stripes.report.problems
    assert [stripe.index for stripe in taken] == [stripe.index for stripe in before]
    assert {stripe.index for stripe in taken if stripe.dark is not None} == CODE
    assert {stripe.index for stripe in taken if stripe.is_dark_due} == CODE == stripes.dark_after
    for stripe in taken:
        if stripe.dark is not None:
            assert stripe.on is not None and stripe.dark.max() < stripe.on.max()
            assert stripe.dark_stamp > stripe.on_stamp
    of_a_frame = plain.report.duration / plain.report.frames_used
    assert stripes.report.frames_used == plain.report.frames_used + len(CODE)
    # At 300 frames per second, switching the laser takes a considerable part of a frame period.
    assert stripes.report.duration - plain.report.duration <= 2 * len(CODE) * of_a_frame


@pytest.mark.usefixtures("emulated_time")
def test_a_dark_frame_that_is_lost_is_taken_again(board: LaserBoard, camera: BenchCamera, firing_order: list) -> None:
    """With a free-running camera, the next frame serves; without any, the stripe is lost."""
    given = AcquireOptions(off=OffFrames.NONE, frame_timeout=0.2, dark_after=frozenset({0, 2}))
    camera.faults.append(CameraFault("drop", 2))
    with acquire(board, camera, firing_order[:3], given) as stripes:
        taken = list(stripes)
    assert [stripe.dark is not None for stripe in taken] == [True, False, True]
    camera.faults.append(CameraFault("silence", 0, 10**6))
    with camera, acquire(board, camera, firing_order[:3], given) as stripes, pytest.raises(CameraTimeout):
        list(stripes)
