"""Simulated workshop for `guara record --simulated`: robot, devices, and operator with board, crosses and plates."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from guara_perception.app.node.rangefinder import Rangefinder
from guara_perception.app.targets.drawings import cross_points
from guara_perception.arrays import Float, Image
from guara_perception.calibration.board import CHARUCO, BoardSpec
from guara_perception.settings import Settings
from guara_perception.simulation.features import Box
from guara_perception.simulation.rangefinder import SimulatedRangefinder
from guara_perception.simulation.simulated_camera import NOMINAL_EXPOSURE_S, renderer
from guara_perception.simulation.specimen import rotation, specimen
from guara_perception.simulation.target_pictures import TargetCamera
from guara_perception.simulation.world import World
from kinematics import RobotModel, Stance, load_robot

if TYPE_CHECKING:
    from drivers.cameras.camera import CameraSettings
    from drivers.emulator.views import ExposureView

Scene = Callable[["ExposureView", "CameraSettings"], Image]
LATENCY_S = 0.001
FRAMES_PER_SECOND = 60.0
# Distance by which a plate extends beyond the scanned area on each side.
PLATE_MARGIN_M = 0.06
# Poses of the board, which cover every part of the image and every tilt: position of the board's centre in the image
# (fractions of width and height), depth [m], tilts about the axes of the image and rotation in the board's plane [rad].
BOARD_POSES = (
    (0.50, 0.50, 0.42, 0.00, 0.00, 0.0),
    (0.36, 0.38, 0.50, 0.50, 0.00, 0.1),
    (0.64, 0.38, 0.50, -0.50, 0.10, -0.1),
    (0.36, 0.62, 0.50, 0.10, 0.55, 0.2),
    (0.64, 0.62, 0.50, 0.00, -0.55, 0.1),
    (0.50, 0.50, 0.45, 0.45, 0.45, 0.5),
    (0.50, 0.50, 0.45, -0.45, -0.45, -0.5),
    (0.32, 0.50, 0.55, 0.00, 0.45, 1.5),
    (0.68, 0.50, 0.55, 0.20, -0.50, 1.5),
    (0.50, 0.34, 0.55, 0.55, 0.00, 0.0),
    (0.50, 0.66, 0.55, -0.55, 0.20, 0.0),
    (0.30, 0.30, 0.62, 0.30, -0.30, 0.3),
    (0.70, 0.30, 0.62, -0.30, 0.30, -0.3),
    (0.30, 0.70, 0.62, -0.35, -0.30, 0.2),
    (0.70, 0.70, 0.62, 0.35, 0.35, 0.1),
)
# Factor by which a ChArUco board is held farther from the centre of the image, so that only part of it is visible.
CHARUCO_REACH = 1.5
# Material of the floor. Exposure metering and the measurement of the camera's lag use the stripe on it.
FLOOR_MATERIAL = "soil"


class SimulatedWorkshop:
    """Simulated devices and operator. The camera sees what the operator is asked to show.

    The devices run on their own clock, so that no frame is lost on a busy machine.

    Attributes:
        robot: model of the robot.
        stance: stance of the robot during the whole session.
        rangefinder: emulated laser board with the real driver, and a camera that sees the current scene.
        truth: true geometry of the rangefinder.
    """

    def __init__(self, robot: str | Path = "guara", size: tuple[int, int] = (640, 512), seed: int = 1) -> None:
        """Place a robot in its scan posture on a flat floor.

        Args:
            robot: name or folder of the robot.
            size: width and height of the camera images [px].
            seed: random seed of the simulated device and its noise.
        """
        from drivers import LaserBoard
        from drivers.emulator import EmulatedBoard, EmulatedClock, EmulatorConfig, emulated_backend
        from drivers.emulator.emulated_camera import EmulatedCamera

        self.robot: RobotModel = load_robot(robot)
        self.truth = specimen(self.robot, size, seed)
        self._seed, self._poses = seed, 0
        posture = self.robot.posture(self.robot.config.scan_posture)
        self.stance = Stance(posture, self.robot.legs, None)
        self._base = self.robot.stance_pose(self.stance).transform_base_to_footprint
        self._targets = TargetCamera.of(self.truth.camera, seed=seed)
        self._board = BoardSpec(9, 7, 0.03)
        self._floor: Scene = renderer(self._over(0.0))
        self._scene = self._floor
        clock = EmulatedClock()
        travel = EmulatorConfig.reaching(stripe.mirror_angle for stripe in self.truth.stripes)
        board = EmulatedBoard(travel, clock=clock.monotonic)
        camera = EmulatedCamera(
            board,
            lambda seen, settings: self._scene(seen, settings),
            fps=FRAMES_PER_SECOND,
            exposure=NOMINAL_EXPOSURE_S,
            latency=LATENCY_S,
            name="simulated camera",
        )
        self.rangefinder = Rangefinder(LaserBoard(backend=emulated_backend(board)), camera, clock=clock)

    def use_board(self, board: BoardSpec) -> None:
        """Set the board that the operator shows and lays on the floor."""
        self._board = board

    def show_board(self, advice: str) -> None:
        """Hold up the board in the next pose."""
        u, v, distance, about_x, about_y, turn = BOARD_POSES[self._poses % len(BOARD_POSES)]
        self._poses += 1
        reach = CHARUCO_REACH if self._board.pattern == CHARUCO else 1.0
        pixel = (0.5 + reach * (np.array([[u, v]]) - 0.5)) * self.truth.camera.size
        ray = self.truth.camera.rays(pixel)[0]
        lean = rotation([about_x, 0, 0]) @ rotation([0, about_y, 0]) @ rotation([0, 0, turn])
        self._still(self._targets.board(self._board, self._board_pose(ray / ray[2] * distance, lean)))

    def lay_board(self, board: BoardSpec, why_again: str) -> None:
        """Lay the board on the floor at the centre of the image."""
        to_camera = np.linalg.inv(self._camera_to_footprint)
        ray = self._camera_to_footprint[:3, :3] @ np.array([0.0, 0.0, 1.0])
        start = self._camera_to_footprint[:3, 3]
        centre = to_camera @ np.append(start - ray * start[2] / ray[2], 1.0)
        # The z axis of a board points into it, so it points down if the board faces up.
        flat = to_camera[:3, :3] @ rotation([np.pi, 0, 0]) @ rotation([0, 0, np.pi / 2])
        self._still(self._targets.board(self._board, self._board_pose(centre[:3], flat)))

    def lay_crosses(self, points: str, why_again: str) -> None:
        """Lay out the mat with the crosses."""
        self._still(self._targets.crosses(cross_points(self.robot), self._camera_to_footprint))

    def lay_plate(self, height: float) -> None:
        """Show a plate with its top at this height [m], or the bare floor at 0, with the current laser stripe."""
        self._scene = renderer(self._over(height))

    def clear(self) -> None:
        """Show the bare floor."""
        self._scene = self._floor

    @property
    def _camera_to_footprint(self) -> Float:
        return np.asarray(self._base @ self.truth.transform_camera_to_base)

    def _board_pose(self, centre_in_camera: Float, turn: Float) -> Float:
        board = self._board
        centre = np.array([(board.columns - 1) / 2, (board.rows - 1) / 2, 0]) * board.square
        pose = np.eye(4)
        pose[:3, :3] = turn
        pose[:3, 3] = centre_in_camera - turn @ centre
        return pose

    def _over(self, height: float) -> SimulatedRangefinder:
        settings = Settings.of(self.robot)
        (x0, x1), (y0, y1) = settings.footprint_x, settings.footprint_y
        size = (x1 - x0 + 2 * PLATE_MARGIN_M, y1 - y0 + 2 * PLATE_MARGIN_M)
        centre = ((x0 + x1) / 2, (y0 + y1) / 2)
        features = (Box(x=centre[0], y=centre[1], size=size, height=height),) if height > 0 else ()
        world = World(features=features, material=FLOOR_MATERIAL)
        rangefinder = SimulatedRangefinder(world, self.truth, self.robot, self._seed)
        rangefinder.set_pose(self._base, self.stance.joint_positions)
        return rangefinder

    def _still(self, picture: Image) -> None:
        self._scene = lambda seen, settings: picture
