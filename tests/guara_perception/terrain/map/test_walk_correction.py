"""Possible drift of cells: sums of motions equal each cell's own displacement along each axis."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import guara_perception as gp
from guara_perception.fields import Fields
from guara_perception.terrain.map.walk_correction import MOST_PAUSES, SidewaysDrift, kept_growth
from kinematics import PoseInOdom, RobotModel
from tests.thorough import examples


def plain(drift: SidewaysDrift) -> dict[str, Any]:
    """Sums as JSON values."""
    fields = {"pauses": drift.pauses, "total": drift.total, "own": drift.own, "slip": drift.slip}
    return {name: array.tolist() for name, array in fields.items()}


def covariance(rng: np.random.Generator) -> np.ndarray:
    """Covariance of x, y and heading with random correlations."""
    root = rng.normal(0, 1, (3, 3)) * [0.002, 0.002, 0.004]
    return root.T @ root


@settings(max_examples=examples(50), deadline=None)
@given(st.integers(0, 10_000))
def test_variance_is_that_of_all_motions_since_the_cell_was_seen(seed: int) -> None:
    """Each motion, and the errors of both pauses, shift a cell and rotate it about the robot at that time."""
    rng = np.random.default_rng(seed)
    positions, growths = np.cumsum(rng.normal(0, 0.1, (12, 2)), axis=0) + 30.0, [covariance(rng) for _ in range(12)]
    own, slips = [covariance(rng) for _ in range(12)], np.cumsum(rng.normal(0, 0.002, (12, 2)), axis=0)
    drift = SidewaysDrift()
    for pause, each in enumerate(zip(growths, positions, own, slips, strict=True)):
        drift = drift.after(3 * pause, *each)
    drift = SidewaysDrift.of_fields(Fields(plain(drift), "test"))
    yaw, seen, cell = rng.uniform(-3, 3), int(rng.integers(0, 12)), positions[-1] + rng.normal(0, 0.4, 2)
    rotation = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    expected = rotation.T @ np.outer(slips[-1] - slips[seen], slips[-1] - slips[seen]) @ rotation
    terms = list(zip(growths[seen + 1 :], positions[seen + 1 :], strict=True))
    terms += [(own[end], positions[end]) for end in (seen, -1) if seen < 11]
    for growth, position in terms:
        (x, y) = cell - position
        jacobian = rotation.T @ [[1, 0, -y], [0, 1, x]]
        expected += jacobian @ growth @ jacobian.T
    transform = np.eye(4)
    transform[:2, :2] = rotation
    # Between two known pauses, the earlier one counts.
    for pause in (3 * seen, 3 * seen + 2):
        found = drift.variances(np.array([pause]), cell[:1], cell[1:], transform)
        np.testing.assert_allclose(found[:, 0], np.diag(expected), rtol=1e-6, atol=1e-12)


def test_memory_is_bounded_and_what_is_older_has_drifted_as_much_as_the_oldest() -> None:
    """An endless walk keeps MOST_PAUSES pauses."""
    drift = SidewaysDrift()
    for pause in range(MOST_PAUSES + 50):
        drift = drift.after(pause, np.diag([1e-6, 1e-6, 0.0]), np.zeros(2), np.zeros((3, 3)), np.zeros(2))
    assert len(drift.pauses) == MOST_PAUSES
    found = drift.variances(np.array([0, 50, MOST_PAUSES + 49]), np.zeros(3), np.zeros(3), np.eye(4))
    np.testing.assert_allclose(found[0], [(MOST_PAUSES - 1) * 1e-6, (MOST_PAUSES - 1) * 1e-6, 0.0], atol=1e-15)
    again = SidewaysDrift.of_fields(Fields(plain(drift), "test"))
    np.testing.assert_array_equal(again.total, drift.total)
    nothing = SidewaysDrift.of_fields(Fields(plain(SidewaysDrift()), "test"))
    assert nothing.variances(np.array([3]), np.zeros(1), np.zeros(1), np.eye(4)).tolist() == [[0.0], [0.0]]


@settings(max_examples=examples(50), deadline=None)
@given(st.integers(0, 10_000))
def test_an_overlap_takes_off_only_what_it_shows(seed: int) -> None:
    """Without overlap all growth is kept, along exactly observed directions none; never more, never below zero."""
    rng = np.random.default_rng(seed)
    prior = covariance(rng) + np.diag([1e-8, 1e-8, 1e-9])
    added = covariance(rng)
    np.testing.assert_allclose(kept_growth(added, prior, prior), added, rtol=1e-5, atol=1e-13)
    row = rng.normal(0, 1, (1, 3))
    gain = prior @ row.T / (row @ prior @ row.T + 1e-6)
    posterior = prior - gain @ row @ prior
    kept = kept_growth(added, prior, posterior)
    assert np.linalg.eigvalsh(kept)[0] > -1e-12
    whitened = np.linalg.inv(np.linalg.cholesky(prior))
    assert np.trace(whitened @ kept @ whitened.T) <= np.trace(whitened @ added @ whitened.T) * (1 + 1e-6)
    scalar = kept_growth(np.diag([4e-6, 1e-6, 1e-6]), np.eye(3) * 8e-6, np.diag([2e-6, 8e-6, 8e-6]))
    np.testing.assert_allclose(scalar, np.diag([1e-6, 1e-6, 1e-6]), atol=1e-15)


@pytest.mark.parametrize("is_first_given", [True, False])
def test_a_walk_is_laid_onto_the_map_at_every_pause_or_at_none(
    robot: RobotModel, make_scan: Callable[..., Any], *, is_first_given: bool
) -> None:
    """A pause of the other kind is rejected without any change, and the walk continues as it began."""
    since = 1e-6 * np.eye(6)
    kinds = [{"covariance_since_last": since}, {}] if is_first_given else [{}, {"covariance_since_last": since}]
    terrain_map = gp.TerrainMap(robot)
    terrain_map.update(make_scan(0.0), PoseInOdom(np.eye(4), since, **kinds[0]))
    expected_text = "is not given at step 1 and was given" if is_first_given else "is given at step 1 and was not given"
    with pytest.raises(
        gp.InvalidInput, match=f"covariance_since_last {expected_text} at earlier pauses: give it at every"
    ):
        terrain_map.update(make_scan(0.0, step=1), PoseInOdom(np.eye(4), 2 * since, **kinds[1]))
    assert terrain_map.pause == 1
    terrain_map.update(make_scan(0.0, step=1), PoseInOdom(np.eye(4), 2 * since, **kinds[0]))
    assert terrain_map.pause == 2 and len(terrain_map.sideways_drift.pauses) == 2


@pytest.mark.parametrize("change", [{"pauses": [2, 1]}, {"total": [np.eye(3).tolist(), np.zeros((3, 3)).tolist()]}])
def test_drift_that_shrinks_is_refused(change: dict[str, Any]) -> None:
    """Such a file would remove safety margins of the map."""
    drift = SidewaysDrift(
        np.array([1, 2]), np.array([np.zeros((3, 3)), np.eye(3)]), np.zeros((2, 3, 3)), np.zeros((2, 2))
    )
    kept = SidewaysDrift.of_fields(Fields(plain(drift), "map.npz"))
    np.testing.assert_array_equal(kept.total, drift.total)
    with pytest.raises(gp.FileFormatError, match="total decreases or pauses do not ascend: the file is damaged"):
        SidewaysDrift.of_fields(Fields({**plain(drift), **change}, "map.npz"))
