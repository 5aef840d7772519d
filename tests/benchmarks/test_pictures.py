"""Tests of the drift of walks with pictures: what is told as drift, and the sigmas that a map claims for it."""

from __future__ import annotations

import numpy as np
import pytest

import guara_perception as gp
from benchmarks.fused_walk import SEEN_AT, drift_aside
from benchmarks.pictures import claimed
from guara_perception.arrays import Float
from guara_perception.terrain.map.walk_correction import SidewaysDrift
from kinematics import Stance
from testbed.scanned_walk import WalkedPause


def placed(x: float, y: float, yaw: float) -> Float:
    """A pose (4, 4) on the ground."""
    pose = np.eye(4)
    pose[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    pose[:2, 3] = x, y
    return pose


def test_drift_is_told_by_axis_where_the_ground_was_seen(paper_terrain: gp.TerrainGrid) -> None:
    """True poses do not drift; one turned by 1 mrad finds ground half a metre ahead 0.5 mm to the right."""
    true = [placed(0.035 * step, 0.0, 0.01 * step) for step in range(4)]
    pauses = [WalkedPause(Stance({}, ()), paper_terrain, to_world) for to_world in true]
    np.testing.assert_allclose(drift_aside(pauses, true, 3), 0.0, atol=1e-9)
    x, y, yaw = drift_aside(pauses, [*true[:3], true[3] @ placed(0.0, 0.0, 0.001)], 3).T
    ahead, aside, *_ = np.mean(np.linalg.inv(true[3]) @ true[0] @ SEEN_AT.T, axis=1)
    np.testing.assert_allclose([x.mean(), y.mean()], [aside, -ahead], atol=1e-3)
    np.testing.assert_allclose(yaw, -1.0, atol=1e-9)


def test_the_claimed_sigmas_are_those_since_the_pause() -> None:
    """Three pauses of 1 mm, 2 mm and 1 mrad each, and what each pause errs by itself."""
    drift, growth, own = SidewaysDrift(), np.diag([1e-6, 4e-6, 1e-6]), np.diag([0.0, 0.0, 1e-6])
    for pause in range(1, 5):
        drift = drift.after(pause, growth, np.zeros(2), own, np.zeros(2))
    first, second = claimed(drift, 1, [np.eye(4)] * 5, 3)
    # Own errors turn the cells about the robot: 2 + 3 mrad^2 over arms of 0.5 m and 0.18 m.
    np.testing.assert_allclose(first, [np.sqrt(3 + 5 * 0.18**2), np.sqrt(12 + 5 * 0.5**2), np.sqrt(5)], rtol=1e-9)
    assert second == pytest.approx(first)
