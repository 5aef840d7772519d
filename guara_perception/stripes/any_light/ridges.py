"""Ridges: what stands above both its sides, at several widths, and how much of that is chance."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from guara_perception.arrays import Float32, Mask
from guara_perception.stripes.median import robust_sigma

# Widths of ridges [px]; neighbours overlap, together they cover stripes of 1 to 15 px.
SIGMAS_PX = (1.2, 2.4, 4.8)
# Distance from the middle of a ridge to each of its sides, in sigmas.
SIDE_SIGMAS = 2.5
COLUMNS_MEAN = 3
# Noise of fewer grey levels than this cannot be separated from quantisation.
LEAST_NOISE = 0.15
# Texture counts as noise whose strongest hundredth begins at this number of sigmas.
TEXTURE_QUANTILE, TEXTURE_SIGMAS = 0.99, 3.0
# Evidence is zero at the first of these strengths of a ridge, grows in proportion up to the second, then with the
# logarithm times the gain.
ZERO_SIGMAS, LINEAR_SIGMAS, LOG_GAIN = 3.2, 8.0, 3.0


@dataclass(frozen=True, slots=True)
class Ridges:
    """The strongest ridge of all widths at every pixel.

    Attributes:
        strength: (rows, columns) float32, height over its noise.
        height: (rows, columns) float32, grey levels above the higher side.
        width: (rows, columns) int8, which of SIGMAS_PX.
    """

    strength: Float32
    height: Float32
    width: npt.NDArray[np.int8]

    def evidence(self) -> Float32:
        """How much more each pixel looks like stripe than like none, (rows, columns)."""
        over = np.log(np.maximum(self.strength / np.float32(LINEAR_SIGMAS), np.float32(1)))
        return np.asarray(
            np.minimum(self.strength, np.float32(LINEAR_SIGMAS)) + np.float32(LOG_GAIN) * over - np.float32(ZERO_SIGMAS)
        )


def ridges(light: Float32, elsewhere: Mask | None = None) -> Ridges:
    """The ridges along the columns of a picture.

    A step of brightness, which a second derivative takes for a line, has a higher side and is no ridge here.

    Args:
        light: (rows, columns) float32 grey levels.
        elsewhere: (rows, columns) where there is no stripe: the texture there is noise too.
    """
    strength, height = np.full(light.shape, -np.inf, np.float32), np.zeros_like(light)
    width = np.zeros(light.shape, np.int8)
    for i, sigma in enumerate(SIGMAS_PX):
        ridge = ridge_of_width(light, sigma)
        noise = max(robust_sigma(ridge[::3, ::7]), LEAST_NOISE)
        if elsewhere is not None:
            some = ridge[::2, ::3][elsewhere[::2, ::3]]
            if some.size:
                rank = int(TEXTURE_QUANTILE * some.size)
                noise = max(noise, float(np.partition(some, rank)[rank]) / TEXTURE_SIGMAS)
        own = ridge * np.float32(1 / noise)
        is_stronger = own > strength
        np.copyto(strength, own, where=is_stronger)
        np.copyto(height, ridge, where=is_stronger)
        width[is_stronger] = i
    return Ridges(strength, height, width)


def ridge_of_width(light: Float32, sigma: float) -> Float32:
    """How far the light, smoothed to this sigma [px] over rows, stands above the higher of its two sides."""
    taps = cv2.getGaussianKernel(2 * int(np.ceil(2 * sigma)) + 1, sigma, cv2.CV_32F)
    mean = np.full(COLUMNS_MEAN, 1 / COLUMNS_MEAN, np.float32)
    side = max(round(SIDE_SIGMAS * sigma), 2)
    smooth = cv2.sepFilter2D(light, cv2.CV_32F, mean, taps, borderType=cv2.BORDER_REPLICATE)
    padded = cv2.copyMakeBorder(smooth, side, side, 0, 0, cv2.BORDER_REPLICATE)
    return np.asarray(smooth - np.maximum(padded[: -2 * side], padded[2 * side :]))
