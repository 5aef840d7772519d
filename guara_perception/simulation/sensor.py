"""The simulated camera's sensor: exposure, noise, saturation, eight bits, and what the camera makes of them."""

from __future__ import annotations

import numpy as np

from guara_perception.arrays import Float32, Image
from guara_perception.exceptions import InvalidInput
from guara_perception.simulation.light import Light
from guara_perception.simulation.picture_effects import Blotches, delivered, rows_reached, scattered

# Noisy pictures without laser that are kept for a scene and an exposure, and used in turn.
DARK_PICTURES = 4
POOL_SIZE = 1 << 22


class Sensor:
    """Turns light into pictures; all noise comes from one seeded generator."""

    def __init__(self, light: Light, shape: tuple[int, int], seed: int) -> None:
        """Draw the noise.

        Args:
            light: light and sensor.
            shape: height and width of the picture.
            seed: seed of the noise.
        """
        self._light, self._shape = light, shape
        self._rng = np.random.default_rng(seed)
        size = max(POOL_SIZE, 2 * shape[0] * shape[1] * 3)
        self._pool = self._rng.standard_normal(size, dtype=np.float32)
        self._ambient: Float32 = np.zeros((*shape, 3), np.float32)
        self._blotches: Blotches | None = None
        if light.blotches:
            noise = self._rng.standard_normal((2 * shape[0], 2 * shape[1], 3), dtype=np.float32)
            self._blotches = Blotches(noise, light.blotches)
        self._dark: dict[float, list[Image]] = {}
        self._turn = 0

    def set_scene(self, ambient: Float32) -> None:
        """Take in the levels (h, w, 3) without laser at nominal exposure."""
        self._ambient = ambient
        self._dark.clear()

    def dark_picture(self, exposure: float) -> Image:
        """A picture without laser, (h, w, 3) uint8."""
        return self._next_dark(exposure).copy()

    def picture(self, light: Float32, rows: tuple[int, int], laser: float, exposure: float) -> Image:
        """A picture with laser light.

        Args:
            light: (rows, w) levels of the red laser at nominal exposure.
            rows: first and end row that it covers.
            laser: share of the exposure during which the laser shone.
            exposure: exposure time relative to the nominal one.
        """
        if not self._light.is_even:
            return self._uneven_picture(light, rows, laser, exposure)
        picture = self._next_dark(exposure).copy()
        first, end = rows
        if end <= first:
            return picture
        lit_columns = np.flatnonzero(light.max(axis=0) > 0.01)
        if not lit_columns.size:
            return picture
        left, right = int(lit_columns[0]), int(lit_columns[-1]) + 1
        leakage = np.array(self._light.leakage, dtype=np.float32) * np.float32(laser)
        level = light[:, left:right, None] * leakage
        level += self._ambient[first:end, left:right]
        picture[first:end, left:right] = self._expose(level, exposure)
        return picture

    def speckle(self, count: int) -> Float32:
        """Factors (count,) of mean 1 by which laser light varies from pixel to pixel."""
        factors = 1 + np.float32(self._light.speckle) * self._noise(count)
        return np.asarray(np.maximum(factors, 0))

    def _next_dark(self, exposure: float) -> Image:
        if not (np.isfinite(exposure) and exposure > 0):
            raise InvalidInput(f"exposure is {exposure} of the nominal one, it must be above 0")
        if exposure not in self._dark:
            self._dark[exposure] = []
        kept = self._dark[exposure]
        self._turn += 1
        if len(kept) < DARK_PICTURES:
            kept.append(self._delivered(self._ambient_now(), exposure))
            return kept[-1]
        return kept[self._turn % DARK_PICTURES]

    def _uneven_picture(self, light: Float32, rows: tuple[int, int], laser: float, exposure: float) -> Image:
        """A picture with laser light that differs all over from one without."""
        if not (np.isfinite(exposure) and exposure > 0):
            raise InvalidInput(f"exposure is {exposure} of the nominal one, it must be above 0")
        gains = np.array(self._light.drift, np.float32)
        level = self._ambient_now()
        if light.size:
            height, first = self._shape[0], rows[0]
            if self._light.is_scattered:
                first, end = rows_reached(rows, height)
                light = np.pad(light, ((rows[0] - first, end - rows[1]), (0, 0)))
                # What overflows depends on what the pixels were given.
                gain = np.float32(laser * exposure) * gains[2]
                light = scattered(light * gain, self._light, height) / gain
            level[first : first + len(light)] += light[:, :, None] * (
                np.array(self._light.leakage, dtype=np.float32) * np.float32(laser)
            )
        if self._light.drift != (1.0, 1.0, 1.0):
            level *= gains
        return self._delivered(level, exposure)

    def _ambient_now(self) -> Float32:
        """Ambient light (h, w, 3) of the next picture, with its flicker."""
        if not self._light.flicker:
            return self._ambient.copy()
        return self._ambient * np.float32(max(1 + self._light.flicker * self._rng.standard_normal(), 0.0))

    def _delivered(self, level: Float32, exposure: float) -> Image:
        """The picture that the camera delivers of these levels (h, w, 3); `level` is overwritten."""
        if self._blotches is not None:
            level *= np.float32(exposure)
            level += self._blotches.draw(self._rng)
            np.maximum(level, 0, out=level)
            exposure = 1.0
        return delivered(self._expose(level, exposure), self._light)

    def _expose(self, level: Float32, exposure: float) -> Image:
        """Add noise to levels (..., 3), in place, and clip to eight bits."""
        if exposure != 1.0:
            level *= np.float32(exposure)
        noise = level * np.float32(self._light.shot_noise)
        noise += np.float32(self._light.read_noise**2)
        np.sqrt(noise, out=noise)
        noise *= self._noise(level.size).reshape(level.shape)
        level += noise
        np.rint(level, out=level)
        np.clip(level, 0, 255, out=level)
        return level.astype(np.uint8)

    def _noise(self, count: int) -> Float32:
        start = int(self._rng.integers(0, self._pool.size - count + 1))
        return self._pool[start : start + count]
