"""Height scans: heights where they are known, a mask elsewhere, never a filled value."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import guara_perception as gp
from kinematics import RobotModel, Stance
from tests.thorough import examples


@pytest.mark.slow
@settings(max_examples=examples(40), deadline=None, derandomize=True)
@given(st.integers(0, 1000), st.integers(0, 60))
def test_what_is_known_is_the_grids_height_and_nothing_else(seed: int, count: int) -> None:
    """Known exactly where the cell under the point is, with its height and sigma; NaN off the grid and over holes."""
    rng = np.random.default_rng(seed)
    heights = rng.normal(0, 0.01, (40, 50))
    heights[rng.random(heights.shape) < 0.3] = np.nan
    terrain = gp.assess_terrain(heights, 0.01, variance=np.full(heights.shape, 0.002**2))
    points = rng.uniform(-0.1, 0.6, (count, 2))
    scan = terrain.height_scan(points)
    assert len(scan) == count
    np.testing.assert_array_equal(scan.heights, terrain.height_at(points[:, 0], points[:, 1]))
    np.testing.assert_array_equal(scan.known, np.isfinite(scan.heights))
    np.testing.assert_array_equal(np.isfinite(scan.sigma), scan.known)
    np.testing.assert_allclose(scan.sigma[scan.known], 0.002, rtol=1e-5)
    np.testing.assert_allclose(scan.below, -scan.heights)


def test_points_of_the_body_are_moved_by_its_pose(robot: RobotModel) -> None:
    """In base_link a point 0.1 m below a body that stands 0.36 m high is 0.26 m above level ground."""
    stance = Stance(robot.posture("scan"), robot.legs, (0, 0, -1))
    pose = robot.stance_pose(stance)
    terrain = gp.assess_terrain(np.zeros((140, 320)), 0.005, origin=(-0.6, -0.35))
    pose_metadata = {"transform_base_to_footprint": pose.transform_base_to_footprint.tolist()}
    terrain = dataclasses.replace(terrain, metadata={**terrain.metadata, **pose_metadata})
    scan = terrain.height_scan([[0.2, 0.1, -0.1], [5.0, 0.0, 0.0]], frame="base_link")
    assert scan.known.tolist() == [True, False]
    assert scan.below[0] == pytest.approx(pose.height - 0.1, abs=1e-6)
    assert np.isnan(scan.below[1])
    with pytest.raises(ValueError, match="read-only"):
        scan.heights[0] = 0.0


@pytest.mark.parametrize(
    ("points", "frame", "message"),
    [
        ([0.1, 0.2], "base_footprint", r"shape \(2,\), \(n, 2\) or \(n, 3\) is needed"),
        ("here", "base_footprint", "no array of numbers"),
        ([[0.1, 0.2]], "map", "frame is 'map', allowed: base_footprint, base_link"),
        ([[0.1, 0.2]], "base_link", "holds no transform_base_to_footprint"),
    ],
)
def test_bad_questions_are_refused(points: object, frame: str, message: str) -> None:
    """Points of another shape, an unknown frame, a body whose pose the grid does not know."""
    with pytest.raises(gp.InvalidInput, match=message):
        gp.assess_terrain(np.zeros((4, 4)), 0.1).height_scan(points, frame)  # type: ignore[arg-type]
