"""Simulated images of calibration targets: a board in any pose, and crosses on the floor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from guara_perception.arrays import Float, Image, Mask
from guara_perception.calibration.board import BoardSpec
from guara_perception.calibration.calibration import CameraModel
from guara_perception.calibration.crosses import ARM_M, BAR_M
from guara_perception.calibration.find_board import board_ink
from guara_perception.simulation.light import Light
from guara_perception.simulation.sensor import Sensor
from kinematics.transforms import inverse

# Grey levels at nominal exposure under the ambient light of a room.
INK, PAPER, GROUND = 22.0, 190.0, 95.0
# Standard deviation of the ground's texture [grey levels], and the length over which the texture changes [m].
TEXTURE, TEXTURE_M = 5.0, 0.02
# Width of the white border around the squares, relative to a square.
BORDER = 0.6


@dataclass(frozen=True, slots=True)
class TargetCamera:
    """Simulated camera for images of targets, with precomputed rays.

    Attributes:
        camera: true intrinsic model.
        rays: (h, w, 3) directions in camera_optical_frame, z = 1.
        light: light and sensor; settings of ambient level, laser and surfaces have no effect.
        seed: seed of noise and texture.
    """

    camera: CameraModel
    rays: Float
    light: Light
    seed: int

    @classmethod
    def of(cls, camera: CameraModel, light: Light | None = None, seed: int = 0) -> TargetCamera:
        """Create the camera and compute the ray of every pixel."""
        width, height = camera.size
        pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).reshape(-1, 2)
        rays = camera.rays(pixels).reshape(height, width, 3)
        return cls(camera, rays / rays[..., 2:], light or Light(), seed)

    def board(self, board: BoardSpec, transform_board_to_camera: Float) -> Image:
        """Image (h, w, 3) of a board, BGR; the origin of the board's frame is its first inner corner."""
        x, y, size = self._on_plane(transform_board_to_camera)
        s = board.square
        b = 1 + BORDER
        paper = _inside(x / s, -b, board.columns + BORDER, size / s) * _inside(y / s, -b, board.rows + BORDER, size / s)
        ink = _ink(board_ink(board), x / s + 1, y / s + 1, size / s, board.columns + 1)
        return self._picture(GROUND + paper * (PAPER - GROUND) + ink * (INK - PAPER))

    def crosses(self, points_in_footprint: Float, transform_camera_to_footprint: Float) -> Image:
        """Render crosses on white cards on the floor, (h, w, 3) BGR."""
        x, y, size = self._on_plane(inverse(transform_camera_to_footprint))
        level: Float = GROUND + _texture(x, y, self.seed)
        for px, py in points_in_footprint:
            u, v = x - px, y - py
            card = _inside(u, -2 * ARM_M, 2 * ARM_M, size) * _inside(v, -2 * ARM_M, 2 * ARM_M, size)
            one = _inside(u, -ARM_M, ARM_M, size) * _inside(v, -BAR_M, BAR_M, size)
            other = _inside(v, -ARM_M, ARM_M, size) * _inside(u, -BAR_M, BAR_M, size)
            ink = 1 - (1 - one) * (1 - other)
            level += card * (PAPER - level)
            level += ink * (INK - level)
        return self._picture(level)

    def _on_plane(self, transform_plane_to_camera: Float) -> tuple[Float, Float, Float]:
        """Coordinates x and y at which the pixels' rays meet the plane z = 0, and effective pixel widths there [m]."""
        rotation, origin = transform_plane_to_camera[:3, :3], transform_plane_to_camera[:3, 3]
        into = self.rays @ rotation
        start = -origin @ rotation
        depth = np.where(np.abs(into[..., 2]) > 1e-9, -start[2] / into[..., 2], np.inf)
        depth = np.where(depth > 0, depth, 1e3)
        x, y = start[0] + depth * into[..., 0], start[1] + depth * into[..., 1]
        # A pixel integrates over its own area and, due to the blur of the lens, over parts of its neighbours.
        slant = np.abs(into[..., 2]) / np.linalg.norm(into, axis=-1)
        focal = float(self.camera.matrix[0, 0])
        size = depth / focal * np.hypot(1.0, np.sqrt(12) * self.light.blur) / np.sqrt(np.clip(slant, 0.05, 1))
        return x, y, size

    def _picture(self, level: Float) -> Image:
        falling = self.rays[..., 2] / np.linalg.norm(self.rays, axis=-1)
        shaded = level * falling**self.light.vignetting
        ambient = np.asarray(shaded[..., None] * np.array([0.94, 1.0, 1.04]), np.float32)
        sensor = Sensor(self.light, level.shape, self.seed)
        sensor.set_scene(np.ascontiguousarray(ambient))
        return sensor.dark_picture(1.0)


def _ink(cells: Mask, column: Float, row: Float, width: Float, columns: int) -> Float:
    """Fraction of ink in a square window around each position, from a summed-area table.

    Args:
        cells: cells of the board, True where there is ink.
        column, row: positions on the board [squares].
        width: edges of the windows [squares].
        columns: number of squares along a row of the board.
    """
    per_square = cells.shape[1] // columns
    whole = np.pad(cells.astype(np.float64).cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))

    def integral(u: Float, v: Float) -> Float:
        u, v = np.clip(u, 0, cells.shape[1]), np.clip(v, 0, cells.shape[0])
        i, j = np.minimum(u.astype(int), cells.shape[1] - 1), np.minimum(v.astype(int), cells.shape[0] - 1)
        right, down = u - i, v - j
        above = whole[j, i] * (1 - right) + whole[j, i + 1] * right
        below = whole[j + 1, i] * (1 - right) + whole[j + 1, i + 1] * right
        return np.asarray(above * (1 - down) + below * down)

    u, v, half = column * per_square, row * per_square, width * per_square / 2
    corners = integral(u + half, v + half) - integral(u - half, v + half)
    corners -= integral(u + half, v - half) - integral(u - half, v - half)
    return np.asarray(corners / (2 * half) ** 2)


def _inside(position: Float, low: float, high: float, width: Float) -> Float:
    """Fraction of the window of `width` around each position that lies between `low` and `high`."""
    covered = np.minimum(position + width / 2, high) - np.maximum(position - width / 2, low)
    return np.asarray(np.clip(covered / width, 0.0, 1.0))


def _texture(x: Float, y: Float, seed: int) -> Float:
    """Smooth texture of the floor [grey levels]."""
    waves = np.random.default_rng(seed).standard_normal((12, 3))
    total = np.zeros(x.shape)
    x, y = np.clip(x, -5, 5), np.clip(y, -5, 5)
    for kx, ky, phase in waves:
        total += np.sin((kx * x + ky * y) / TEXTURE_M + 6 * phase)
    return np.asarray(TEXTURE * total / np.sqrt(6))
