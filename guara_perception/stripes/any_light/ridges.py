"""Ridges: what stands above both its sides, at several widths, and how much of that is chance."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from guara_perception.arrays import Float32, Index, Mask, robust_sigma

# Widths of ridges [px]; neighbours overlap, together they cover stripes of 1 to 15 px.
SIGMAS_PX = (1.2, 2.4, 4.8)
# Distance from the centre of a ridge to each of its sides, in sigmas.
SIDE_SIGMAS = 2.5
COLUMNS_MEAN = 3
# Noise of fewer grey levels than this cannot be separated from quantisation.
LEAST_NOISE = 0.15
# Texture counts as noise whose strongest hundredth begins at this number of sigmas.
TEXTURE_QUANTILE, TEXTURE_SIGMAS = 0.99, 3.0
# Evidence is zero at the first of these strengths of a ridge, grows in proportion up to the second, then with the
# logarithm times the gain.
ZERO_SIGMAS, LINEAR_SIGMAS, LOG_GAIN = 3.2, 8.0, 3.0
# Number of parts of equal size into which a scene is divided by brightness, to measure the noise of each.
LEVEL_PARTS = 8


@dataclass(frozen=True, slots=True)
class Ridges:
    """The strongest ridge of all widths at every pixel.

    Attributes:
        strength: (rows, columns) float32, height over its noise.
        heights: for each of SIGMAS_PX, (rows, columns) float32, grey levels above the higher side.
        noises: noise of each of SIGMAS_PX [grey levels].
    """

    strength: Float32
    heights: tuple[Float32, ...]
    noises: tuple[float, ...]

    def along(self, rows: Index, columns: Index) -> tuple[Float32, Float32]:
        """Height [grey levels] and width [px] of the strongest ridge at some pixels (n,)."""
        heights = np.stack([height[rows, columns] for height in self.heights])
        strongest = (heights * np.array([[1 / noise] for noise in self.noises], np.float32)).argmax(axis=0)
        return heights[strongest, np.arange(strongest.size)], np.array(SIGMAS_PX, np.float32)[strongest]

    def evidence(self) -> Float32:
        """Evidence (rows, columns) for the stripe at each pixel, negative where it is more likely absent."""
        evidence = np.minimum(self.strength, np.float32(LINEAR_SIGMAS))
        evidence -= np.float32(ZERO_SIGMAS)
        # Few pixels are that strong, and logarithms are dear.
        strong = np.flatnonzero(self.strength > LINEAR_SIGMAS)
        times = self.strength.reshape(-1).take(strong) / np.float32(LINEAR_SIGMAS)
        evidence.reshape(-1)[strong] += np.float32(LOG_GAIN) * np.log(times)
        return np.asarray(evidence)


def ridges(light: Float32, elsewhere: Mask | None = None, scene: Float32 | None = None) -> Ridges:
    """The ridges along the columns of a picture.

    An edge between dark and bright, which a second derivative takes for a line, has a higher side: it is no ridge here.

    Args:
        light: (rows, columns) float32 grey levels.
        elsewhere: (rows, columns) where there is no stripe: the texture there is noise too.
        scene: (rows, columns) float32 levels of 0 to 255 without the laser, where known: bright light is noisy.
    """
    heights = tuple(ridge_of_width(light, sigma) for sigma in SIGMAS_PX)
    noises = tuple(_noise(height, elsewhere) for height in heights)
    strength = heights[0] * np.float32(1 / noises[0])
    for height, noise in zip(heights[1:], noises[1:], strict=True):
        np.maximum(strength, height * np.float32(1 / noise), out=strength)
    if scene is not None:
        strength *= _quietness(heights[0], noises[0], scene)
    return Ridges(strength, heights, noises)


def _quietness(height: Float32, noise: float, scene: Float32) -> Float32:
    """Ratio (rows, columns) of the usual noise of a scene to that at the grey level of each pixel, at most 1.

    The variance of a camera's noise grows in proportion to the light (photon transfer, EMVA standard 1288). Where it is
    darker than usual the ratio stays 1: else a halo alone would count as a stripe there.

    Args:
        height: (rows, columns) heights of ridges of one width.
        noise: usual noise of these heights.
        scene: (rows, columns) grey levels of the scene, 0 to 255.
    """
    some, level = height[::3, ::7].ravel(), scene[::3, ::7].ravel()
    parts = np.array_split(level.argsort(), LEVEL_PARTS)
    levels = np.array([np.median(level[part]) for part in parts])
    variances = np.array([robust_sigma(some[part]) ** 2 for part in parts])
    apart = levels - levels.mean()
    slope = max(float(apart @ variances) / max(float(apart @ apart), 1.0), 0.0)
    variance = variances.mean() + slope * (np.arange(256) - levels.mean())
    quietness = noise / np.sqrt(np.maximum(variance, noise**2))
    return np.asarray(cv2.LUT(cv2.convertScaleAbs(scene), quietness.astype(np.float32)))


def _noise(height: Float32, elsewhere: Mask | None) -> float:
    """How high ridges (rows, columns) are by chance [grey levels]."""
    noise = max(robust_sigma(height[::3, ::7]), LEAST_NOISE)
    if elsewhere is not None:
        some = height[::2, ::3][elsewhere[::2, ::3]]
        if some.size:
            rank = int(TEXTURE_QUANTILE * some.size)
            noise = max(noise, float(np.partition(some, rank)[rank]) / TEXTURE_SIGMAS)
    return noise


def ridge_of_width(light: Float32, sigma: float) -> Float32:
    """How far the light, smoothed to this sigma [px] over rows, stands above the higher of its two sides."""
    taps = cv2.getGaussianKernel(2 * int(np.ceil(2 * sigma)) + 1, sigma, cv2.CV_32F)
    mean = np.full(COLUMNS_MEAN, 1 / COLUMNS_MEAN, np.float32)
    side = max(round(SIDE_SIGMAS * sigma), 2)
    smooth = cv2.sepFilter2D(light, cv2.CV_32F, mean, taps, borderType=cv2.BORDER_REPLICATE)
    padded = cv2.copyMakeBorder(smooth, side, side, 0, 0, cv2.BORDER_REPLICATE)
    higher = np.maximum(padded[: -2 * side], padded[2 * side :])
    return np.asarray(np.subtract(smooth, higher, out=higher))
