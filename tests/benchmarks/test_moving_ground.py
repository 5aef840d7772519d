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
            assert record.registration_refused.startswith("few things show the motion")
