"""Stripes handed over several at a time give what they give one by one, bit for bit."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import guara_perception as gp
from guara_perception.ranging.scan_geometry import StripeRanger
from tests.guara_perception.recordings import Frames, guara, recorded_scan, truth
from tests.thorough import examples, further


def processor(name: str, mode: str | None = None, method: str = "precise") -> gp.ScanProcessor:
    scan = recorded_scan(name)[0]
    return gp.ScanProcessor(truth(), guara(), scan.stance, mode or scan.mode, method=method)


def same_result(first: gp.ScanProcessor, second: gp.ScanProcessor) -> None:
    """Assert that grids, points, profiles and reports on frames are equal bit for bit."""
    grids = first.finish(), second.finish()
    for name, layer in grids[0].layers.items():
        assert layer.tobytes() == grids[1].layer(name).tobytes(), name
    for key in ("stripes_used", "stripes_missing", "frames_bad", "health", "lost_cells"):
        assert grids[0].metadata[key] == grids[1].metadata[key], key
    assert list(first.points) == list(second.points)
    for each, other in zip(first.points.values(), second.points.values(), strict=True):
        for name in ("points", "variance", "strength", "status"):
            np.testing.assert_array_equal(getattr(each, name), getattr(other, name))
        for name in ("out_of_range", "doubtful"):
            np.testing.assert_array_equal(getattr(each, name).columns, getattr(other, name).columns)
            np.testing.assert_array_equal(getattr(each, name).points, getattr(other, name).points)


def pairs(frames: Sequence[Frames]) -> list[gp.FramePair]:
    return [gp.FramePair(*each) for each in frames]


def grouped(frames: Sequence[Frames], sizes: Sequence[int]) -> Iterator[list[gp.FramePair]]:
    """Frames in groups of these sizes, which are repeated."""
    begin, number = 0, 0
    while begin < len(frames):
        size = sizes[number % len(sizes)]
        yield pairs(frames[begin : begin + size])
        begin, number = begin + size, number + 1


@pytest.mark.slow
@pytest.mark.parametrize("name", ["tilt", *further("paper", "dark")])
@given(data=st.data())
@settings(max_examples=examples(4), deadline=None, derandomize=True)
def test_any_order_and_grouping_gives_the_same_bits(name: str, data: st.DataObject) -> None:
    """Lost stripes, blank frames and frames of another size among them; the reference: stripes one by one in order."""
    frames = recorded_scan(name)[1]
    indices = [index for index, _, _ in frames]
    lost = data.draw(st.frozensets(st.sampled_from(indices), max_size=6))
    blank = data.draw(st.frozensets(st.sampled_from(indices), max_size=4))
    cut = data.draw(st.frozensets(st.sampled_from(indices), max_size=2))
    given_frames = [
        (index, on[:-1] if index in cut else np.zeros_like(on) if index in blank else on, off)
        for index, on, off in frames
        if index not in lost
    ]
    single, several = processor(name), processor(name)
    for index, on, off in given_frames:
        single.add(index, on, off)
    shuffled = data.draw(st.permutations(given_frames) if data.draw(st.booleans()) else st.just(given_frames))
    sizes = data.draw(st.lists(st.integers(1, 12), min_size=1, max_size=6))
    groups = list(grouped(shuffled, sizes))
    ahead = data.draw(st.frozensets(st.integers(0, len(groups) - 1), max_size=4))
    for number, group in enumerate(groups):
        if number in ahead:
            several.work_ahead()
        profiles = several.add_all(group)
        assert [profile.reason for profile in profiles] == [single.profiles[pair.index].reason for pair in group]
    same_result(several, single)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["paper", *further("dark", "tilt")])
@pytest.mark.parametrize("late", [(), (-1,), (12, -1), (0, 20, 21)])
def test_work_ahead_changes_no_bit_whichever_stripes_are_late(name: str, late: tuple[int, ...]) -> None:
    """The last three stripes, repeated ones, one lost for good: the grid equals that of all at once."""
    frames = list(recorded_scan(name)[1])
    lost = frames.pop(9)[0]
    again = [frames[index] for index in late]
    in_time = [each for index, each in enumerate(frames) if index not in {late_one % len(frames) for late_one in late}]
    direct, ahead = processor(name), processor(name)
    for index, on, off in frames:
        direct.add(index, on, off)
    for group in grouped(in_time[:-3], [8]):
        ahead.add_all(group)
    ahead.work_ahead()
    for group in grouped([*in_time[-3:], *again], [1]):
        ahead.add_all(group)
    for each in (direct, ahead):
        each.mark_bad(lost, "frame lost")
    same_result(ahead, direct)
    # And once more, with nothing new.
    same_result(ahead, direct)
    wide = ahead.finish("wide"), direct.finish("wide")
    assert all(layer.tobytes() == wide[1].layer(layer_name).tobytes() for layer_name, layer in wide[0].layers.items())


@pytest.mark.slow
def test_work_ahead_on_a_grid_of_coarser_cells() -> None:
    """Cells of 10 mm, each the worst of four fine ones."""
    frames = recorded_scan("paper")[1]
    direct, ahead = (
        gp.ScanProcessor(truth(), guara(), recorded_scan("paper")[0].stance, "coarse", resolution=0.01)
        for _ in range(2)
    )
    direct.add_all(pairs(frames))
    ahead.add_all(pairs(frames[:-2]))
    ahead.work_ahead()
    ahead.add_all(pairs(frames[-2:]))
    same_result(ahead, direct)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["precise", "paper", "paper-literal-ortho"])
def test_every_method_takes_groups(method: str) -> None:
    """The paper's chain, too, and frames without a laser-off picture, which each serve later ones of their group."""
    frames = [(index, on, None) for index, on, _ in recorded_scan("paper")[1]]
    single, several = processor("paper", method=method), processor("paper", method=method)
    for index, on, off in frames:
        single.add(index, on, off)
    for group in grouped(frames, [8, 1, 5]):
        several.add_all(group)
    same_result(several, single)


@pytest.mark.slow
def test_groups_of_a_coarse_scan_that_is_extended() -> None:
    """Coarse stripes in groups and the first missing ones alone after it: the standard scan of the same stripes."""
    scan, frames = recorded_scan("paper")
    coarse, direct = processor("paper", "coarse"), processor("paper", "standard")
    for group in grouped(frames, [8]):
        coarse.add_all(group)
    for index, on, off in frames:
        direct.add(index, on, off)
    assert scan.mode == "coarse"
    same_result(coarse.extended(), direct)


def test_group_with_a_wrong_index_is_refused_whole() -> None:
    """Not of the pattern, given before, given twice: the message of `add`, and no stripe of the group was taken."""
    frames = recorded_scan("paper")[1]
    scan = processor("paper")
    scan.add(*frames[2])
    for wrong, message in (
        ((1, *frames[0][1:]), "stripe index 1 is not in the coarse pattern"),
        (frames[2], "stripe index 4 was added before; a scan takes each stripe once"),
        (frames[0], "stripe index 0 was added before; a scan takes each stripe once"),
    ):
        with pytest.raises(gp.InvalidInput, match=message):
            scan.add_all(pairs([frames[0], frames[1], wrong]))
    assert list(scan.points) == list(scan.profiles) == [4]
    assert len(scan.add_all(pairs(frames[:2]))) == 2


def test_group_with_an_uncalibrated_index_is_refused_whole() -> None:
    """A stripe without a plane cannot be located: nothing of its group is taken."""
    scan, frames = recorded_scan("paper")
    full = truth()
    partial = gp.Calibration(
        robot=full.robot,
        camera=full.camera,
        transform_camera_to_base=full.transform_camera_to_base,
        stripes=tuple(stripe for stripe in full.stripes if stripe.index != 4),
        quality=full.quality,
    )
    processor = gp.ScanProcessor(partial, guara(), scan.stance, scan.mode)
    with pytest.raises(gp.CalibrationMismatch, match="stripe index 4 is not in the calibration"):
        processor.add_all(pairs(frames[:3]))
    assert not processor.profiles
    processor.add_all(pairs(frames[:2]))
    assert list(processor.profiles) == [0, 2]


def test_group_that_fails_half_way_is_not_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    """If there is no memory for its points, no stripe counts as added, and the group can be added again."""
    frames = recorded_scan("paper")[1][:4]
    undisturbed, scan = processor("paper"), processor("paper")
    for each in (undisturbed, scan):
        each.add_all(pairs(frames[:2]))

    def fail(*_: object) -> None:
        raise MemoryError

    with monkeypatch.context() as patch, pytest.raises(MemoryError):
        patch.setattr(StripeRanger, "points", fail)
        scan.add_all(pairs(frames[2:]))
    assert list(scan.profiles) == list(scan.points) == [0, 2]
    for each in (undisturbed, scan):
        each.add_all(pairs(frames[2:]))
    same_result(scan, undisturbed)


def test_empty_group_does_nothing() -> None:
    """No frame, no stripe."""
    scan = processor("paper")
    assert scan.add_all([]) == [] and not scan.profiles
