"""Sensor of the simulated camera: exposure, noise, saturation, quantisation, and effects of lens and compression."""

from __future__ import annotations

import cv2
import numpy as np

from drivers.cameras.bayer import mosaic
from guara_perception.arrays import Float32, Image
from guara_perception.simulation.light import Light

# Number of noisy laser-off images that are cached for each scene and exposure, and returned in turn.
DARK_PICTURES = 4
# Minimum number of precomputed noise values.
POOL_SIZE = 1 << 22
# Distance from the stripe beyond which the skirt of scattered light decreases as 1 / distance, and distance at which it
# ends [px].
SKIRT_FROM_PX, SKIRT_TO_PX = 8, 40
# Number of columns over which scattered light is averaged along the stripe.
SKIRT_COLUMNS = 9
# Standard deviation of the Gaussian decrease of a halo from the edge of the clipped core [px]; 8 % remain at 20 px.
HALO_SIGMA_PX = 9.0
FULL_SCALE = 255.0
# Ghost (reflection) of the stripe, displaced along a sine wave: mean displacement and amplitude, relative to the image
# height; wavelength, relative to the image width; and standard deviation of the blur [px].
GHOST_OF_HEIGHT, GHOST_AMPLITUDE_OF_HEIGHT, GHOST_WAVE_OF_WIDTH = 0.05, 0.012, 0.4
GHOST_SIGMA_PX = 1.2
# First and last column between which the ghost is visible, relative to the image width.
GHOST_COLUMNS = (0.3, 0.75)
# Sigma of the Gaussian filter that turns white noise into blotches [px].
BLOTCH_SIGMA_PX = 3.0


class Sensor:
    """Camera sensor that converts light levels to images; all noise comes from one seeded generator."""

    def __init__(self, light: Light, shape: tuple[int, int], seed: int) -> None:
        """Generate the noise; each image uses random parts of it.

        Args:
            light: parameters of light, laser and sensor.
            shape: height and width of the image [px].
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
        """Set the grey levels (h, w, 3) without laser light at nominal exposure."""
        self._ambient = ambient
        self._dark.clear()

    def dark_picture(self, exposure: float) -> Image:
        """Render an image without laser light, (h, w, 3) uint8; `exposure` is relative to the nominal one."""
        return self._next_dark(exposure).copy()

    def picture(self, light: Float32, rows: tuple[int, int], laser: float, exposure: float) -> Image:
        """Render an image with laser light, (h, w, 3) uint8.

        Args:
            light: (rows, w) grey levels of the laser light in the red channel, at nominal exposure.
            rows: first and end row covered by `light`.
            laser: share of the exposure during which the laser was on.
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
        """Factors (count,) with mean 1 by which laser light varies from pixel to pixel."""
        factors = 1 + np.float32(self._light.speckle) * self._noise(count)
        return np.asarray(np.maximum(factors, 0))

    def _next_dark(self, exposure: float) -> Image:
        kept = self._dark.setdefault(exposure, [])
        self._turn += 1
        if len(kept) < DARK_PICTURES:
            kept.append(self._delivered(self._ambient_now(), exposure))
            return kept[-1]
        return kept[self._turn % DARK_PICTURES]

    def _uneven_picture(self, light: Float32, rows: tuple[int, int], laser: float, exposure: float) -> Image:
        """Render a whole laser-on image: some effects also change pixels outside the stripe (see `Light.is_even`)."""
        gains = np.array(self._light.drift, np.float32)
        level = self._ambient_now()
        if light.size:
            height, first = self._shape[0], rows[0]
            if self._light.is_scattered:
                first, end = rows_reached(rows, height)
                light = np.pad(light, ((rows[0] - first, end - rows[1]), (0, 0)))
                # The overflow of clipped pixels depends on the level at the sensor, which includes exposure and drift.
                gain = np.float32(laser * exposure) * gains[2]
                light = scattered(light * gain, self._light, height) / gain
            level[first : first + len(light)] += light[:, :, None] * (
                np.array(self._light.leakage, dtype=np.float32) * np.float32(laser)
            )
        if self._light.drift != (1.0, 1.0, 1.0):
            level *= gains
        return self._delivered(level, exposure)

    def _ambient_now(self) -> Float32:
        """Ambient light (h, w, 3) of the next image, with random flicker."""
        if not self._light.flicker:
            return self._ambient.copy()
        return self._ambient * np.float32(max(1 + self._light.flicker * self._rng.standard_normal(), 0.0))

    def _delivered(self, level: Float32, exposure: float) -> Image:
        """Convert levels (h, w, 3) to the image that the camera delivers; overwrites `level`."""
        if self._blotches is not None:
            level *= np.float32(exposure)
            level += self._blotches.draw(self._rng)
            np.maximum(level, 0, out=level)
            exposure = 1.0
        return delivered(self._expose(level, exposure), self._light)

    def _expose(self, level: Float32, exposure: float) -> Image:
        """Convert levels (..., 3) to an image with noise, clipped to 8 bits; overwrites `level`."""
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


def rows_reached(rows: tuple[int, int], height: int) -> tuple[int, int]:
    """First and end row reached by scattered light from a range of rows."""
    ghost = int((GHOST_OF_HEIGHT + GHOST_AMPLITUDE_OF_HEIGHT) * height) + 1
    return max(rows[0] - SKIRT_TO_PX, 0), min(rows[1] + ghost + SKIRT_TO_PX, height)


def scattered(level: Float32, light: Light, height: int) -> Float32:
    """Add reflections, scatter in the lens and overflow of clipped pixels to laser light.

    Args:
        level: (rows, w) grey levels of the laser light at the sensor, not clipped.
        light: strengths of the effects.
        height: height of the whole image [px].
    """
    if light.ghost:
        level = level + np.float32(light.ghost) * _ghost(level, height)
    result = level
    if light.skirt:
        result = result + _skirt(level, light.skirt)
    if light.halo:
        result = result + _halo(level, light.halo)
    return result


def _ghost(level: Float32, height: int) -> Float32:
    """Reflection (rows, w) of the laser light, displaced downwards in the image."""
    width = level.shape[1]
    columns, rows = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(len(level), dtype=np.float32))
    wave = GHOST_AMPLITUDE_OF_HEIGHT * np.sin(2 * np.pi * columns / (GHOST_WAVE_OF_WIDTH * width))
    source = rows - np.float32(height) * (GHOST_OF_HEIGHT + wave).astype(np.float32)
    seen = cv2.remap(level, columns, source, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    seen[:, : int(GHOST_COLUMNS[0] * width)] = 0
    seen[:, int(GHOST_COLUMNS[1] * width) :] = 0
    return np.asarray(cv2.GaussianBlur(seen, (0, 0), GHOST_SIGMA_PX), np.float32)


def _skirt(level: Float32, share: float) -> Float32:
    """Light scattered by the lens: in each column, `share` of the peak (at most 255) within SKIRT_FROM_PX of it.

    Farther away, it decreases as 1 / distance and ends at SKIRT_TO_PX.
    """
    distance = np.abs(np.arange(-SKIRT_TO_PX, SKIRT_TO_PX + 1))
    taps = (SKIRT_FROM_PX / np.maximum(distance, SKIRT_FROM_PX)).astype(np.float32)
    total = level.sum(axis=0)
    peak = np.where(total > 0, level.max(axis=0) / np.maximum(total, np.float32(1e-6)), 0)
    ones = np.ones(SKIRT_COLUMNS, np.float32) / np.float32(SKIRT_COLUMNS)
    seen = cv2.sepFilter2D(level * peak.astype(np.float32), cv2.CV_32F, ones, taps, borderType=cv2.BORDER_CONSTANT)
    return np.float32(share) * np.asarray(np.minimum(seen, FULL_SCALE), np.float32)


def _halo(level: Float32, strength: float) -> Float32:
    """Overflow of clipped pixels, with level `strength` at the edge of the clipped core."""
    core = (level > FULL_SCALE).astype(np.uint8)
    if not core.any():
        return np.zeros_like(level)
    distance = cv2.distanceTransform(1 - core, cv2.DIST_L2, 3)
    return np.asarray(strength * np.exp(-0.5 * (distance / HALO_SIGMA_PX) ** 2), np.float32)


class Blotches:
    """Blotchy noise; each image uses a random part of one large pattern."""

    def __init__(self, noise: Float32, deviation: float) -> None:
        """Filter white noise into blotches.

        Args:
            noise: (2 h, 2 w, channels) independent noise of each pixel, with standard deviation 1.
            deviation: standard deviation of the filtered noise [grey levels].
        """
        soft = cv2.GaussianBlur(noise, (0, 0), BLOTCH_SIGMA_PX)
        # A Gaussian filter reduces the standard deviation of white noise to 1 / (2 sqrt(pi) sigma).
        self._patches = np.asarray(soft * np.float32(deviation * 2 * np.sqrt(np.pi) * BLOTCH_SIGMA_PX), np.float32)

    def draw(self, rng: np.random.Generator) -> Float32:
        """Draw the blotches of one image, (h, w, channels) [grey levels]."""
        height, width = self._patches.shape[0] // 2, self._patches.shape[1] // 2
        row, column = int(rng.integers(height + 1)), int(rng.integers(width + 1))
        return self._patches[row : row + height, column : column + width]


def delivered(picture: Image, light: Light) -> Image:
    """Apply demosaicing and JPEG compression, if enabled in `light`, to an image (h, w, 3) uint8."""
    if light.demosaiced:
        picture = np.asarray(cv2.cvtColor(mosaic(picture, "BayerRG8"), cv2.COLOR_BayerRGGB2BGR), np.uint8)
    if light.jpeg_quality:
        options = [cv2.IMWRITE_JPEG_QUALITY, light.jpeg_quality]
        options += [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420]
        packed = cv2.imencode(".jpg", picture, options)[1]
        picture = np.asarray(cv2.imdecode(packed, cv2.IMREAD_COLOR), np.uint8)
    return picture
