"""Moving ground: a thing that moves alone on level ground takes no pause of the map along."""

from __future__ import annotations

import numpy as np
import pytest

import guara_perception as gp
from kinematics import LegOdometry, RobotModel
from testbed.moving_ground import pauses_of


@pytest.mark.slow
def test_a_board_alone_in_view_corrects_nothing(robot: RobotModel) -> None:
    """A board is pushed 5 mm a pause beside the tracks; each scan is left out, with its reason."""
    terrain_map, odometry = gp.TerrainMap(robot), LegOdometry(robot)
    for pause in pauses_of(robot, "board pushed", 0, 1):
        record = terrain_map.update(pause.scan, odometry.update(pause.stance)).record
        assert isinstance(record, gp.MapRecord)
        assert record.sideways_correction is not None
        np.testing.assert_allclose(record.sideways_correction, 0.0, atol=1e-9)
        if pause.scan.step:
            assert record.registration_refused is not None
            assert record.registration_refused.startswith("few objects show the motion")


@pytest.mark.slow
def test_what_texture_held_stays_when_a_carpet_fills_the_view(robot: RobotModel) -> None:
    """Texture of the still ground holds the map until a pulled carpet covers it; those pauses are not taken back."""
    terrain_map, odometry, errors = gp.TerrainMap(robot), LegOdometry(robot), []
    pauses = list(pauses_of(robot, "carpet, 7 mm", 12, 4, pictures=True))
    for pause in pauses:
        pose = odometry.update(pause.stance)
        record = terrain_map.update(pause.scan, pose, picture=pause.picture).record
        assert isinstance(record, gp.MapRecord)
        assert record.transform_footprint_to_odom is not None
        error = np.linalg.inv(pause.to_world) @ pauses[0].to_world @ record.transform_footprint_to_odom
        errors.append(abs(float(np.arctan2(error[1, 0], error[0, 0]))))
    assert max(errors[:12]) < 1e-3
    # Odometry turns by 18 mrad in the pauses that texture holds, and by 5 in those that follow.
    assert max(errors[12:]) < 8e-3
