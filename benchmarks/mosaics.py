"""Scans of Bayer mosaics (as they are, red pixels, red filled in, demosaiced) beside grey and colour pictures.

`python -m benchmarks light mosaics`: one rendered scan of the demo's world in each form, its errors against that world.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable

import cv2
import numpy as np

import guara_perception as gp
from benchmarks.command import Table
from drivers.cameras.bayer import mosaic, red_pixels
from guara_perception.app.node.simulated import DEMO_WORLD
from guara_perception.arrays import Image
from guara_perception.calibration.calibration import Calibration
from guara_perception.simulation.rangefinder import SimulatedRangefinder
from guara_perception.simulation.specimen import specimen
from guara_perception.simulation.walk import WalkPause, simulate_walk
from guara_perception.simulation.world import load_world

SIZE = (1280, 1024)
PATTERN = "BayerRG8"
RED = 2
# Bilinear interpolation between red pixels, which lie two pixels apart.
TENT = np.array([0.5, 1.0, 0.5], np.float32)
REPEATS = 3


def forms() -> dict[str, Callable[[Image], Image]]:
    """Functions by name, each of which makes from a colour picture what a camera or a driver could deliver."""
    return {
        "colour, three whole channels": lambda picture: picture,
        "grey camera (red plane)": lambda picture: np.ascontiguousarray(picture[:, :, RED]),
        "mosaic as it is": lambda picture: mosaic(picture, PATTERN),
        "mosaic, red pixels only": lambda picture: red_pixels(mosaic(picture, PATTERN), PATTERN),
        "mosaic, red filled in": lambda picture: fill_red(mosaic(picture, PATTERN)),
        "mosaic, demosaiced": lambda picture: cv2.cvtColor(mosaic(picture, PATTERN), cv2.COLOR_BayerRGGB2BGR),
    }


def fill_red(mosaic_picture: Image) -> Image:
    """The red channel of a mosaic at every pixel, interpolated bilinearly between red pixels."""
    red = np.zeros_like(mosaic_picture)
    red[::2, ::2] = mosaic_picture[::2, ::2]
    filled: Image = cv2.sepFilter2D(red, -1, TENT, TENT, borderType=cv2.BORDER_REFLECT_101)
    return filled


def halved(calibration: Calibration) -> Calibration:
    """The calibration for pictures of every second row and column, beginning with the first."""
    camera = calibration.camera
    matrix = camera.matrix.copy()
    matrix[:2] *= 0.5
    small = dataclasses.replace(camera, size=(camera.size[0] // 2, camera.size[1] // 2), matrix=matrix)
    return dataclasses.replace(calibration, camera=small)


def errors_of(terrain: gp.TerrainGrid, rig: SimulatedRangefinder, pause: WalkPause) -> np.ndarray:
    """Errors of the known heights against the world [m]."""
    transform_base_to_footprint = rig.robot.stance_pose(pause.stance).transform_base_to_footprint
    transform_footprint_to_world = pause.transform_base_to_world @ np.linalg.inv(transform_base_to_footprint)
    x, y = np.meshgrid(*terrain.geometry.centres())
    cells = np.stack([x, y, terrain.elevation, np.ones_like(x)], axis=-1)[np.isfinite(terrain.elevation)]
    points = cells @ transform_footprint_to_world.T
    return np.asarray(points[:, 2] - rig.world.height(points[:, 0], points[:, 1]))


def main() -> None:
    """Scans of Bayer mosaics, grey and colour pictures beside the truth."""
    robot, world = gp.load_robot("guara"), load_world(DEMO_WORLD)
    calibration = specimen(robot, SIZE)
    rig = SimulatedRangefinder(world, calibration, robot)
    pause = next(simulate_walk(world, robot, cycles=0))
    rig.set_pose(pause.transform_base_to_world, pause.joint_positions)
    pictures = list(rig.frames(range(70)))
    off = pictures[0][2]
    print(f"{SIZE[0]} x {SIZE[1]} px, 70 stripes, one off frame; processor time without drawing and making mosaics")
    head = "frames: | known cells:.4f | rms of the better 99 % mm:.3f | 99th percentile mm:.2f | ms a stripe:.2f"
    table = Table(head, markdown=True)
    for name, form in forms().items():
        dark = form(off)
        frames = [gp.FramePair(index, form(on), dark) for index, on, _ in pictures]
        used = halved(calibration) if dark.shape[0] == SIZE[1] // 2 else calibration
        spent = []
        for _ in range(REPEATS):
            processor = gp.ScanProcessor(used, robot, pause.stance, "standard")
            begun = time.thread_time()
            for first in range(0, len(frames), 16):
                processor.add_all(frames[first : first + 16])
            spent.append((time.thread_time() - begun) / len(frames))
        terrain = processor.finish()
        errors = 1e3 * np.abs(errors_of(terrain, rig, pause))
        # Without known cells there are no errors.
        errors = errors if errors.size else np.array([np.nan])
        rms = np.sqrt(np.mean(np.sort(errors)[: int(np.ceil(0.99 * errors.size))] ** 2))
        known = np.isfinite(terrain.elevation).mean()
        table.row(name, known, rms, np.percentile(errors, 99), 1e3 * min(spent))
