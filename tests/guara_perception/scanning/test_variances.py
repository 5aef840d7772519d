"""Contributions to the variances of a scan, and uncertainty of its vertical."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.terrain.layers.hazard import Hazard
from kinematics import GravityEstimate, RobotModel, Stance


def processor(
    scan: gp.Scan, calibration: gp.Calibration, robot: RobotModel, stance: Stance, **more: object
) -> gp.ScanProcessor:
    made = gp.ScanProcessor(calibration, robot, stance, scan.mode, **more)  # type: ignore[arg-type]
    made.add_all([gp.FramePair(stripe.index, on, off) for stripe, on, off in scan.frames()])
    return made


@pytest.fixture(scope="module")
def terrain(paper_scan: gp.Scan, calibration: gp.Calibration, robot: RobotModel) -> gp.TerrainGrid:
    """The recorded scan, by a calibration without covariance."""
    return processor(paper_scan, calibration, robot, paper_scan.stance).finish()


@pytest.fixture(scope="module")
def without_imu(paper_scan: gp.Scan, calibration: gp.Calibration, robot: RobotModel) -> gp.TerrainGrid:
    """The recorded scan of a robot that has no IMU."""
    stance = dataclasses.replace(paper_scan.stance, gravity_in_base=None)
    return processor(paper_scan, calibration, robot, stance).finish()


@pytest.mark.slow
def test_the_total_has_the_height_and_tilt_of_the_stance(terrain: gp.TerrainGrid) -> None:
    """z + rx y - ry x with the covariance of the pose, and motion that the joints do not show (under 0.5 mm)."""
    pose = terrain.record.pose_covariance
    assert pose is not None
    y, x = (each.ravel() for each in np.meshgrid(*terrain.geometry.centres()[::-1], indexing="ij"))
    by = np.stack((np.ones_like(x), y, -x))
    of_pose = np.einsum("in,ij,jn->n", by, pose[2:5, 2:5], by).reshape(terrain.shape)
    rest = (terrain.variance.astype(np.float64) - terrain.variance_local - of_pose)[np.isfinite(terrain.elevation)]
    assert (rest > -1e-12).all() and (rest < 0.5e-3**2).all()


@pytest.mark.slow
def test_an_error_of_the_calibration_is_shared(
    terrain: gp.TerrainGrid, paper_scan: gp.Scan, calibration: gp.Calibration, robot: RobotModel
) -> None:
    """A common error of 2 mm in the calibration enters the total variance, but neither local variance nor hazards."""
    field = np.zeros((10, 10))
    field[0, 0] = 0.002**2
    covariance = {
        "stripes": [{"index": 0, "plane": np.zeros((4, 4)).tolist()}],
        "height_field": {
            "terms": ["1", "x", "y", "z", "xx", "yy", "zz", "xy", "xz", "yz"],
            "origin_in_base": [0.0, 0.0, 0.0],
            "matrix": field.tolist(),
        },
    }
    unsure = dataclasses.replace(calibration, covariance=covariance)
    other = processor(paper_scan, unsure, robot, paper_scan.stance).finish()
    known = np.isfinite(terrain.elevation)
    np.testing.assert_allclose((other.variance - terrain.variance)[known], 0.002**2, rtol=1e-3)
    for name in ("variance_local", "hazard", "traversability"):
        np.testing.assert_array_equal(other.layer(name), terrain.layer(name))


@pytest.mark.slow
def test_a_scan_level_with_the_feet_says_so(terrain: gp.TerrainGrid, without_imu: gp.TerrainGrid) -> None:
    """In its record and its health; its slopes are as uncertain, and no cell becomes free because of that."""
    record = without_imu.record
    assert record.attitude_source == "support_plane" and record.health is not None
    assert record.attitude_sigma == pytest.approx(0.05, rel=0.01)
    assert any("levelled by the plane of the feet" in reason for reason in record.health.reasons)
    assert terrain.record.attitude_sigma == pytest.approx(0.00175)
    assert terrain.record.health is not None and not terrain.record.health.reasons
    steep = [(grid.hazard & np.uint16(Hazard.STEEP)) != 0 for grid in (terrain, without_imu)]
    assert steep[1].sum() > steep[0].sum()
    assert not ((without_imu.hazard == 0) & (terrain.hazard != 0)).any()


@pytest.mark.slow
def test_gravity_of_the_walk_levels_a_scan(
    terrain: gp.TerrainGrid, paper_scan: gp.Scan, calibration: gp.Calibration, robot: RobotModel
) -> None:
    """As gravity of an IMU would, with the sigma of the walk; a scan that is refined keeps it."""
    gravity = GravityEstimate((0.0, 0.0, -1.0), 0.02)
    stance = dataclasses.replace(paper_scan.stance, gravity_in_base=None)
    made = processor(paper_scan, calibration, robot, stance, gravity=gravity)
    for grid in (made.finish(), made.extended().finish()):
        assert grid.record.attitude_source == "odometry" and grid.record.attitude_sigma == 0.02
    np.testing.assert_array_equal(made.finish().elevation, terrain.elevation)
    assert made.finish().record.health == terrain.record.health
