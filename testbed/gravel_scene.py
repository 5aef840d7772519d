"""Boxes on gravel ahead of a standing robot, seen by a camera without distortion, and true heights of the cells."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np

import guara_perception as gp
from guara_perception.arrays import Array, Float, Image, Mask
from guara_perception.settings import Settings
from guara_perception.simulation import SimulatedRangefinder, World, specimen
from guara_perception.simulation.features import Box
from guara_perception.terrain.layers.geometry import GridGeometry
from kinematics import Stance, load_robot
from testbed.true_ground import TrueGround

# Height difference in the neighbourhood of a cell above which the cell is an edge.
JUMP_M = 0.003
BOXES = ((0.60, 0.17, 0.02), (0.60, 0.0, 0.03), (0.60, -0.17, 0.04), (0.80, 0.09, 0.06), (0.80, -0.09, 0.08))
SIZES = {(640, 512): "coarse", (1280, 1024): "standard"}


class Scene:
    """Five boxes on gravel ahead of a standing robot, and a camera without distortion."""

    def __init__(self, size: tuple[int, int]) -> None:
        """Create the scene; `size` is the width and height of the images [px]."""
        self.robot, self.mode = load_robot("guara"), SIZES[size]
        exact = specimen(self.robot, size)
        camera = dataclasses.replace(exact.camera, distortion=np.zeros(5))
        self.calibration = dataclasses.replace(exact, camera=camera)
        boxes = tuple(Box(x=x, y=y, size=(0.05, 0.05), height=height) for x, y, height in BOXES)
        self.world = World(features=boxes, material="gravel")
        self.stance = Stance(self.robot.posture(self.robot.config.scan_posture), self.robot.legs, (0.0, 0.0, -1.0))
        self._base = self.robot.stance_pose(self.stance).transform_base_to_footprint
        self._rangefinder = SimulatedRangefinder(self.world, self.calibration, self.robot, seed=0)
        self.camera = self._base @ self.calibration.transform_camera_to_base
        settings = Settings.of(self.robot)
        self.grid = GridGeometry.over(settings.footprint_x, settings.footprint_y, settings.resolution)

    def frames(self, offset: Float, indices: range) -> list[tuple[int, Image, Image | None]]:
        """Render frames with the body moved by `offset` (3,) [m]."""
        moved = self._base.copy()
        moved[:3, 3] += offset
        self._rangefinder.set_pose(moved, self.stance.joint_positions)
        return list(self._rangefinder.frames(indices))

    def picture(self, offset: Float) -> Image:
        """Render a greyscale image without the laser."""
        ((_, on, off),) = self.frames(offset, range(1))
        return cv2.cvtColor(on if off is None else off, cv2.COLOR_BGR2GRAY)

    def heights(self, points_in_camera: Float) -> Float:
        """Median height of the points (n, 3) in each cell (ny, nx) [m], NaN for a cell without points."""
        points = points_in_camera @ self.camera[:3, :3].T + self.camera[:3, 3]
        iy, ix = self.grid.indices(points[:, 0], points[:, 1])
        inside = self.grid.contains(iy, ix) & (np.abs(points[:, 2]) < 0.2)
        cell, z = (iy * self.grid.shape[1] + ix)[inside], points[inside, 2]
        order = np.lexsort((z, cell))
        cells, first, count = np.unique(cell[order], return_index=True, return_counts=True)
        heights = np.full(self.grid.size, np.nan)
        heights[cells] = z[order][first + count // 2]
        return heights.reshape(self.grid.shape)


def rays(scene: Scene, columns: Array, rows: Array) -> Float:
    """Viewing rays (n, 3) of pixels, with z = 1."""
    matrix = scene.calibration.camera.matrix
    x, y = (columns - matrix[0, 2]) / matrix[0, 0], (rows - matrix[1, 2]) / matrix[1, 1]
    return np.column_stack((x, y, np.ones(len(x))))


def truth(scene: Scene) -> tuple[gp.TerrainGrid, Mask]:
    """True grid, and mask of its cells that are not at edges."""
    grid, _ = TrueGround.of(scene.world).grid(np.eye(4), scene.grid, scene.robot)
    around = np.ones((5, 5), np.uint8)
    height = np.asarray(grid.elevation, np.float32)
    return grid, cv2.dilate(height, around) - cv2.erode(height, around) < JUMP_M
