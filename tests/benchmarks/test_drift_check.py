"""The benchmark of the drift check: what it injects, and that it counts."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.drift_check import tally
from guara_perception.calibration.drift import DRIFTING, HOLDS
from guara_perception.simulation.rangefinder import LaserPlanes
from guara_perception.simulation.specimen import specimen
from testbed.moved_mount import Injected, guara


def test_what_is_injected_moves_one_thing() -> None:
    """A turned camera leaves the laser planes where they are on the robot; a turned laser leaves the camera."""
    robot = guara()
    known = specimen(robot)
    planes = LaserPlanes.of(known).planes_in_base
    camera = Injected.of("camera", 0.5, np.random.default_rng(1)).apply(known, robot)
    np.testing.assert_allclose(LaserPlanes.of(camera).planes_in_base, planes, atol=1e-12)
    turned = camera.transform_camera_to_base[:3, :3] @ known.transform_camera_to_base[:3, :3].T
    assert np.degrees(np.arccos((np.trace(turned) - 1) / 2)) == pytest.approx(0.5, rel=1e-6)
    laser = Injected.of("laser", 0.2, np.random.default_rng(1)).apply(known, robot)
    np.testing.assert_array_equal(laser.transform_camera_to_base, known.transform_camera_to_base)
    moved = LaserPlanes.of(laser).planes_in_base
    angles = np.degrees(np.arccos(np.clip((moved[:, :3] * planes[:, :3]).sum(axis=1), -1, 1)))
    assert 0.001 < angles.max() < 0.2 + 1e-6
    centre = np.append(robot.transform_laser_to_base[:3, 3], 1.0)
    np.testing.assert_allclose(moved @ centre, planes @ centre, atol=1e-12)


@pytest.mark.heavy
def test_drifts_are_found_and_true_scans_are_not() -> None:
    """A true walk holds throughout; one whose mirror lost 16 steps in the first scan is warned of."""
    true, found = tally(1, 0), tally(1, 1000, "steps", 16.0)
    assert (true.scans[HOLDS], true.warned) == (3, 0)
    assert found.warned == 1 and found.scans[DRIFTING] >= 2, found.reasons
