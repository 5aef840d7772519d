"""The band of a stripe holds every row in which its plane can be seen between the heights asked for, and no more."""

from __future__ import annotations

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.calibration.height_rows import plane_in_frame, row_bands
from kinematics import RobotModel

MARGIN = 8
HEIGHTS = np.array([-0.085, 0.145])


@pytest.fixture(scope="module")
def transform(calibration: gp.Calibration, robot: RobotModel, paper_scan: gp.Scan) -> np.ndarray:
    """Camera to footprint."""
    pose = robot.stance_pose(paper_scan.stance).transform_base_to_footprint
    return np.asarray(pose @ calibration.transform_camera_to_base)


@pytest.mark.parametrize("index", [0, 9, 20, 34])
def test_a_band_holds_all_rows_of_its_laser_plane(
    calibration: gp.Calibration, transform: np.ndarray, index: int
) -> None:
    """Against points set densely on the lines in which the laser plane crosses each height."""
    plane = calibration.stripes[index].plane
    (first, end), *_ = row_bands(calibration.camera, transform, plane[None], HEIGHTS, MARGIN)
    a, b, c, d = plane_in_frame(plane, transform)
    y = np.linspace(-0.6, 0.6, 40_001)
    rows = []
    for height in HEIGHTS:
        points = np.column_stack((-(b * y + c * height + d) / a, y, np.full(y.size, height)))
        u, v = calibration.camera.project((points - transform[:3, 3]) @ transform[:3, :3]).T
        rows.append(v[(u >= 0) & (u <= calibration.camera.size[0] - 1)])
    lowest, highest = min(map(np.min, rows)), max(map(np.max, rows))
    # Lines bend between the samples that the band is made from by no more than a tenth of a pixel.
    assert first == max(np.floor(lowest) - MARGIN, 0) or abs(lowest - round(lowest)) < 0.1
    assert end == min(np.ceil(highest) + MARGIN + 1, calibration.camera.size[1]) or abs(highest - round(highest)) < 0.1


def test_a_band_does_not_depend_on_the_other_laser_planes(calibration: gp.Calibration, transform: np.ndarray) -> None:
    """Asked for together or one by one; every laser plane of the pattern has a band."""
    planes = np.array([stripe.plane for stripe in calibration.stripes])
    together = row_bands(calibration.camera, transform, planes, HEIGHTS, MARGIN)
    assert together == [row_bands(calibration.camera, transform, p[None], HEIGHTS, MARGIN)[0] for p in planes]
    assert all(end - first > 2 * MARGIN for first, end in together)


def test_a_laser_plane_out_of_view_has_no_band(calibration: gp.Calibration, transform: np.ndarray) -> None:
    """Far ahead of the picture, and behind the camera."""
    to_camera = np.linalg.inv(transform)
    upright = np.array([[1.0, 0.0, 0.0, -far] for far in (5.0, -5.0)])
    planes = plane_in_frame(upright, to_camera)
    assert row_bands(calibration.camera, transform, planes, HEIGHTS, MARGIN) == [(0, 0), (0, 0)]
    assert row_bands(calibration.camera, transform, planes[:0], HEIGHTS, MARGIN) == []
