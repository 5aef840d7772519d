"""Swings: over obstacles, around unknown ground, and reasons if there is none."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import guara_perception as gp
from guara_perception.terrain.layers.record import ScanRecord
from kinematics import RobotModel, Stance
from tests.thorough import examples

PROPERTY = settings(max_examples=examples(40), deadline=None, derandomize=True)


def ground(seed: int, unknown: float = 0.0005) -> gp.TerrainGrid:
    """0.5 x 0.5 m of measured ground with boxes and unknown cells."""
    rng = np.random.default_rng(seed)
    heights = rng.normal(0, 0.0005, (100, 100))
    for _ in range(4):
        iy, ix = rng.integers(0, 90, 2)
        heights[iy : iy + 8, ix : ix + 8] += rng.choice([0.01, 0.03, 0.06])
    heights[rng.random(heights.shape) < unknown] = np.nan
    return gp.assess_terrain(heights, 0.005, variance=np.full(heights.shape, 0.0005**2))


coordinate = st.floats(0.04, 0.46)


@pytest.mark.slow
@PROPERTY
@given(st.integers(0, 300), coordinate, coordinate, coordinate, coordinate, st.floats(0.005, 0.03))
def test_a_swing_is_a_path_that_is_accepted(
    seed: int, x0: float, y0: float, x1: float, y1: float, clearance: float
) -> None:
    """Exactly from start to end, finite, accepted by `check_path`; otherwise none, with reasons."""
    terrain = ground(seed)
    start, end = ([x, y, np.nan_to_num(terrain.height_at(x, y))] for x, y in ((x0, y0), (x1, y1)))
    swing = terrain.swing(start, end, clearance)
    assert bool(swing) == swing.ok == (not swing.reasons)
    if swing.ok:
        np.testing.assert_array_equal(swing.points[[0, -1]], [start, end])
        verdict = terrain.check_path(swing.points, clearance)
        assert verdict.ok
        assert swing.clearance == verdict.clearance or np.isnan(verdict.clearance)
        assert len(swing.points) <= 20
    else:
        assert swing.points.shape == (0, 3)


def test_over_a_box_it_goes_as_high_as_it_must() -> None:
    """A box of 30 mm half way, with 20 mm of clearance: 50 mm at the box, less before and after."""
    heights = np.zeros((100, 100))
    heights[40:60, 45:55] = 0.03
    swing = gp.assess_terrain(heights, 0.005).swing([0.1, 0.25, 0], [0.4, 0.25, 0], 0.02)
    assert swing.points[:, 2].max() == pytest.approx(0.051)
    assert swing.points[1] == pytest.approx([0.1, 0.25, 0.021])
    assert swing.clearance >= 0.02


@pytest.mark.parametrize("variance", [1e3, 1e6, 1e38])
def test_over_ground_of_any_uncertainty_it_ends_in_words(variance: float) -> None:
    """A wall whose height is unsure by kilometres is too high; the search for a way over it took all memory."""
    heights, unsure = np.zeros((100, 100)), np.zeros((100, 100))
    heights[:, 45:55], unsure[:, 45:55] = 0.15, variance
    found = gp.assess_terrain(heights, 0.005, variance=unsure).swing([0.15, 0.25, 0.0], [0.35, 0.25, 0.0], 0.02)
    assert not found.ok and "height of a swing over such uncertain ground" in str(found.reasons[0])


def test_around_unknown_ground_it_goes_aside() -> None:
    """The swing goes around a patch without returns; there is none if the patch extends across."""
    heights = np.zeros((100, 100))
    heights[42:58, 45:55] = np.nan
    terrain = gp.assess_terrain(heights, 0.005)
    assert not terrain.check_path([[0.15, 0.25, 0.2], [0.35, 0.25, 0.2]], 0.02).ok
    swing = terrain.swing([0.15, 0.25, 0], [0.35, 0.25, 0], 0.02)
    assert swing.ok
    assert np.abs(swing.points[:, 1] - 0.25).max() >= 0.06
    heights[:, 45:55] = np.nan
    (reason,) = gp.assess_terrain(heights, 0.005).swing([0.15, 0.25, 0], [0.35, 0.25, 0], 0.02).reasons
    assert reason.test == "unknown"
    assert "UNSCANNED" in reason.detail


def test_up_a_step_and_down_again() -> None:
    """Between two levels, the path keeps its clearance at the edge of the step."""
    heights = np.zeros((100, 100))
    heights[:, 50:] = 0.03
    terrain = gp.assess_terrain(heights, 0.005)
    for ends in ([[0.15, 0.25, 0.0], [0.35, 0.25, 0.03]], [[0.35, 0.25, 0.03], [0.15, 0.25, 0.0]]):
        swing = terrain.swing(*ends, 0.02)
        assert swing.ok
        assert 0.05 <= swing.points[:, 2].max() < 0.06


@pytest.mark.slow
def test_reach_of_a_leg(robot: RobotModel) -> None:
    """With a leg, a path beyond its reach is rejected, with the excess."""
    terrain = gp.assess_terrain(np.zeros((140, 320)), 0.005, origin=(-0.6, -0.35))
    stance = Stance(robot.posture("scan"), robot.legs, (0, 0, -1))
    to_footprint = robot.stance_pose(stance).transform_base_to_footprint.tolist()
    metadata = {
        **terrain.metadata,
        "robot": robot.name,
        "stance": stance.to_dict(),
        "transform_base_to_footprint": to_footprint,
    }
    terrain = dataclasses.replace(terrain, record=ScanRecord.from_json(metadata))
    assert terrain.swing([0.30, 0.18, 0], [0.37, 0.18, 0], 0.03, leg="lf", robot=robot).ok
    far = terrain.swing([0.30, 0.18, 0], [0.70, 0.18, 0], 0.03, leg="lf", robot=robot)
    assert {reason.test for reason in far.reasons} == {"reach"}
    assert "joints of lf beyond their limits" in str(far.reasons[0])


@pytest.mark.parametrize(
    ("start", "end", "clearance", "message"),
    [
        ([0.1, 0.1], [0.2, 0.2, 0.0], 0.02, "start and end of a swing: an array of numbers"),
        ([0.1, 0.1, np.nan], [0.2, 0.2, 0.0], 0.02, "finite points"),
        ("here", "there", 0.02, "start and end of a swing: an array of numbers"),
        ([0.1, 0.1, 0.0], [0.2, 0.2, 0.0], -1.0, "clearance is -1.0; it must be 0 ... 1 m"),
    ],
)
def test_what_is_no_swing_is_refused(start: object, end: object, clearance: float, message: str) -> None:
    """Two points with z and a clearance are needed."""
    with pytest.raises(gp.InvalidInput, match=message):
        ground(0).swing(start, end, clearance)  # type: ignore[arg-type]
