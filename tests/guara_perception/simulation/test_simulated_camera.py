"""Tests of the simulated camera on the emulated board."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.board.laser_board import LaserBoard
from drivers.cameras.camera import CameraSettings
from drivers.emulator import EmulatedBoard, emulated_backend
from guara_perception.simulation.rangefinder import SimulatedRangefinder
from guara_perception.simulation.simulated_camera import NOMINAL_EXPOSURE_S, simulated_camera
from guara_perception.simulation.specimen import specimen
from guara_perception.simulation.world import World
from kinematics import load_robot


@pytest.mark.slow
def test_board_decides_what_the_camera_sees() -> None:
    """Laser off: no stripe; laser on: the stripe of the mirror's angle, where the calibration says."""
    robot = load_robot("guara")
    calibration = specimen(robot, seed=2)
    rangefinder = SimulatedRangefinder(World(), calibration, robot)
    transform = np.eye(4)
    transform[2, 3] = 0.36
    rangefinder.set_pose(transform)
    emulated = EmulatedBoard()
    with LaserBoard(backend=emulated_backend(emulated)) as board, simulated_camera(rangefinder, emulated) as camera:
        assert camera.lock(CameraSettings(exposure=NOMINAL_EXPOSURE_S)).exposure == NOMINAL_EXPOSURE_S
        board.home()
        rows = []
        for index in (10, 60):
            stripe = calibration.stripe(index)
            board.laser_off()
            reached = board.go_to_angle(stripe.mirror_angle)
            assert abs(reached - stripe.mirror_angle) < 1e-6
            camera.flush()
            camera.grab(5.0)
            off = camera.grab(5.0).image.astype(float)
            board.laser_on()
            camera.flush()
            camera.grab(5.0)
            # The watchdog allows half a second of silence.
            board.status()
            on = camera.grab(5.0).image.astype(float)
            board.laser_off()
            light = (on - off)[..., 2]
            assert light.max() > 20
            rows.append(int(np.median(light[:, 200:440].argmax(axis=0))))
            floor = np.array([[320, rows[-1]]])
            ray = calibration.camera.rays(floor)[0]
            point = (
                calibration.transform_camera_to_base[:3, :3] @ (ray * -stripe.plane[3] / (stripe.plane[:3] @ ray))
                + calibration.transform_camera_to_base[:3, 3]
            )
            assert abs(point[2] + 0.36) < 0.004
        # Image v grows forward: a later stripe lies further down in the picture.
        assert rows[1] > rows[0] + 100
