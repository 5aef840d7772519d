"""Safety of whole recorded scans: lost stripes never make another cell safe, and unseen cells are unknown."""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import guara_perception as gp
from guara_perception.ranging.scan_geometry import in_groups
from kinematics import PoseInOdom
from testbed.grid_truth import figures, load_truth
from tests.guara_perception.recordings import DATA, guara, recorded_scan, truth
from tests.thorough import IS_THOROUGH, examples, further

pytestmark = pytest.mark.slow

SCANS = ("paper", "dark", "tilt")


def process(name: str, lost: frozenset[int] = frozenset(), unusable: frozenset[int] = frozenset()) -> gp.TerrainGrid:
    """The terrain of a recorded scan without the lost stripes and with blank frames for the unusable ones."""
    scan, frames = recorded_scan(name)
    processor = gp.ScanProcessor(truth(), guara(), scan.stance, scan.mode)
    kept = [
        gp.FramePair(index, np.zeros_like(on) if index in unusable else on, off)
        for index, on, off in frames
        if index not in lost
    ]
    for group in in_groups(kept):
        processor.add_all(group)
    return processor.finish()


@functools.cache
def whole(name: str) -> gp.TerrainGrid:
    return process(name)


@pytest.mark.parametrize("name", SCANS)
@given(data=st.data())
@settings(max_examples=examples(6), deadline=None, derandomize=True)
def test_losing_stripes_or_frames_never_makes_another_cell_safe(name: str, data: st.DataObject) -> None:
    """Whichever stripes were not fired, whichever frames are blank: safe cells are among those of the whole scan."""
    indices = [index for index, _, _ in recorded_scan(name)[1]]
    lost = data.draw(st.frozensets(st.sampled_from(indices), max_size=12))
    unusable = data.draw(st.frozensets(st.sampled_from(indices), max_size=6)) - lost
    terrain = process(name, lost, unusable)
    assert not ((terrain.traversability > 0) & ~(whole(name).traversability > 0)).any()


@pytest.mark.parametrize("name", SCANS)
def test_losing_any_single_stripe_never_makes_another_cell_safe_or_known(name: str) -> None:
    """Every sixth stripe alone, others in each scan (every one in thorough runs): no cell becomes safe or known."""
    frames = recorded_scan(name)[1]
    for index, _, _ in frames if IS_THOROUGH else frames[2 * SCANS.index(name) :: 6]:
        terrain = process(name, frozenset({index}))
        assert not ((terrain.traversability > 0) & ~(whole(name).traversability > 0)).any(), index
        assert not (np.isfinite(terrain.elevation) & ~np.isfinite(whole(name).elevation)).any(), index


@pytest.mark.parametrize(
    ("name", "lost", "unusable", "at"),
    [
        ("tilt", {62}, set(), (0.0, 0.0)),
        ("tilt", set(), {60}, (0.0, 0.0)),
        ("paper", {48}, {16, 24}, (0.0033025, 0.00465732)),
    ],
)
def test_losing_stripes_never_makes_a_cell_of_the_map_safe(
    name: str, lost: set[int], unusable: set[int], at: tuple[float, float]
) -> None:
    """For a map of one scan, with any offset between the cells of the map and those of the scan."""
    pose = np.eye(4)
    pose[:2, 3] = at
    whole_map, map_of_less = (
        gp.TerrainMap("guara").update(scan, PoseInOdom(pose, np.zeros((6, 6))))
        for scan in (whole(name), process(name, frozenset(lost), frozenset(unusable)))
    )
    assert (whole_map.hazard == 0).sum() > 50
    assert not ((map_of_less.hazard == 0) & (whole_map.hazard != 0)).any()


@pytest.mark.parametrize("name", SCANS)
def test_cells_that_nobody_saw_are_not_known(name: str) -> None:
    """Unseen cells: at most 1 % known, none of those wrong; dark cells: at most 0.5 %; none of either traversable."""
    found = figures(whole(name), load_truth(DATA / "scans" / name / "truth.npz", 5))
    assert found.unseen_known <= 1.0
    assert found.unseen_wrong == 0
    assert found.dark_known <= 0.5
    assert found.unsafe == 0


@pytest.mark.parametrize("name", SCANS)
def test_interior_cells_are_known_and_right(name: str) -> None:
    """Interior cells: 98.5 % known, mean error at most 0.14 mm, bias at most 0.03 mm near and 0.05 mm far."""
    found = figures(whole(name), load_truth(DATA / "scans" / name / "truth.npz", 5))
    assert found.known >= 98.5
    assert found.mean <= 0.14
    assert abs(found.bias_near) <= 0.03
    assert abs(found.bias_far) <= 0.05


def test_the_order_of_the_stripes_does_not_matter() -> None:
    """Frames in any order, and `finish` called in between, give the same grid bit for bit."""
    scan, frames = recorded_scan("paper")
    processor = gp.ScanProcessor(truth(), guara(), scan.stance, scan.mode)
    shuffled = np.random.default_rng(3).permutation(len(frames))
    for done, entry in enumerate(shuffled):
        index, on, off = frames[entry]
        processor.add(index, on, off)
        if done % 10 == 0:
            processor.finish()
    terrain = processor.finish()
    for name in ("elevation", "variance", "hazard", "traversability", "elevation_min", "elevation_max"):
        np.testing.assert_array_equal(terrain.layer(name), whole("paper").layer(name), err_msg=name)


def with_off_pictures(name: str, off_of: Callable[[int], np.ndarray | None]) -> gp.TerrainGrid:
    """The terrain of a recorded scan with other laser-off pictures, each by the number of its stripe in the sweep."""
    scan, frames = recorded_scan(name)
    processor = gp.ScanProcessor(truth(), guara(), scan.stance, scan.mode)
    for number, (index, on, _) in enumerate(frames):
        processor.add(index, on, off_of(number))
    return processor.finish()


@pytest.mark.parametrize("name", ["dark", *further("paper")])
@pytest.mark.parametrize("lost", [{9}, {0, 1, 8, 15, 16, 30}, set(range(99))], ids=["one", "some", "all"])
def test_losing_laser_off_pictures_never_makes_another_cell_safe(name: str, lost: set[int]) -> None:
    """Stripes without one are served by other frames or by their own: safe cells are among those of the whole scan."""
    frames = recorded_scan(name)[1]
    terrain = with_off_pictures(name, lambda number: None if number in lost else frames[number][2])
    assert not ((terrain.traversability > 0) & ~(whole(name).traversability > 0)).any()


@pytest.mark.parametrize("name", ["dark", *further("paper")])
@pytest.mark.parametrize("gain", [0.7, 1.3, None])
def test_foreign_laser_off_pictures_make_nothing_safe_that_is_not(name: str, gain: float | None) -> None:
    """Exposed differently, or those of another scan (None): no unseen and no dark cell becomes traversable."""
    frames, other = recorded_scan(name)[1], recorded_scan("tilt")[1][0][2]

    def off_of(number: int) -> np.ndarray | None:
        own = frames[number][2]
        if number % 3 or own is None:
            return own
        return other if gain is None else np.clip(gain * own, 0, 255).astype(np.uint8)

    found = figures(with_off_pictures(name, off_of), load_truth(DATA / "scans" / name / "truth.npz", 5))
    assert found.unsafe == 0
