"""Laser-off images of analytic ground, including moving parts, rendered with the camera of a specimen.

They show only the texture of the ground, without shadows and without the robot.
"""

from __future__ import annotations

import cv2
import numpy as np

from guara_perception.arrays import Float
from guara_perception.ground_picture import GroundPicture
from guara_perception.simulation import World, specimen
from guara_perception.simulation.relief import Relief
from kinematics import RobotModel
from testbed.analytic_walk import Ground, Pause

SIZE = (640, 512)
# Spacing of the pixels whose rays are intersected with the ground; points between them are interpolated.
EVERY = 2
# Grey level of the ground, standard deviation of its texture relative to this level, and noise as in `Light`.
LEVEL, CONTRAST, READ_NOISE, SHOT_NOISE = 90.0, 0.10, 0.5, 0.011
ROUNDS = 5


def ground_picture(robot: RobotModel, ground: Ground, pause: Pause, seed: int) -> GroundPicture:
    """Render the image of a pause with new noise; its camera pose is computed from the measured stance."""
    calibration, ground = specimen(robot, SIZE, seed), ground.at(pause.step)
    pose = robot.stance_pose(pause.stance).transform_base_to_footprint @ calibration.transform_camera_to_base
    transform = pause.transform_base_to_world @ calibration.transform_camera_to_base
    pixels = np.stack(np.meshgrid(np.arange(0, SIZE[0], EVERY), np.arange(0, SIZE[1], EVERY)), axis=-1)
    rays = calibration.camera.rays(pixels.reshape(-1, 2)) @ transform[:3, :3].T
    origin, down = transform[:3, 3], np.minimum(rays[:, 2], -1e-3)
    height = np.zeros(len(rays))
    for _ in range(ROUNDS):
        x, y = (origin[:2] + rays[:, :2] * ((height - origin[2]) / down)[:, None]).T
        height = np.asarray(ground.height_at(x, y), np.float64)
    full = [_at_all_pixels(each.reshape(pixels.shape[:2])) for each in ground.own(x, y)]
    texture = Relief.of(World((0.0, 1.0), (0.0, 1.0), seed=seed)).sample_texture(*full)
    rng = np.random.default_rng(6000 + 100 * seed + pause.step)
    grey = cv2.GaussianBlur(LEVEL * (1 + CONTRAST * texture), (0, 0), 0.55)
    noisy = grey + rng.normal(0.0, np.sqrt(READ_NOISE**2 + SHOT_NOISE * np.maximum(grey, 0.0)))
    return GroundPicture(np.clip(np.rint(noisy), 0, 255).astype(np.uint8), calibration.camera, pose)


def _at_all_pixels(values: Float) -> np.ndarray:
    """Interpolate values (h / 2, w / 2) at every second pixel to all pixels (h, w)."""
    v, u = np.indices((SIZE[1], SIZE[0]), dtype=np.float32) / EVERY
    return cv2.remap(values.astype(np.float32), u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
