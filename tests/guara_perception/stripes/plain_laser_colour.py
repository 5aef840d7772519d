"""Colour and ridges of a laser line by plain array operations: reference of the kernel."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from guara_perception.arrays import Array, Float, Float32, Index, Mask
from tests.guara_perception.stripes.plain_light import robust_sigma

# Grey level from which a pixel may be clipped: JPEG and demosaicing make clipped pixels slightly darker.
CLIPPED = 245.0
# A clipped core with its halo is narrower than this.
WIDEST_CORE_PX = 25
# Distance of the samples of a covariance in rows and in columns, and number of columns from which a colour is measured.
COVARIANCE_ROWS, COVARIANCE_COLUMNS, COLOUR_COLUMNS = 2, 5, 200
# Background and rim of the stripe, in rows from its centre.
BACKGROUND_PX, RIM_PX = 12, 6
# Largest response of another channel to a line laser, as a fraction of that of the laser's own channel.
MOST_LEAKAGE = 0.8
# Weight of the other channels in a clipped core, and their largest contribution as a fraction of the rim's light.
OTHERS_SHARE, MOST_OF_CORE = 0.1, 0.5
# Standard deviation that JPEG and quantisation cause in a channel, and regularisation as a fraction of the trace.
LEAST_DEVIATION, UNKNOWN_SHARE = 0.15, 1e-3
# Widths of ridges [px]; neighbours overlap, together they cover stripes of 1 to 15 px.
SIGMAS_PX = (1.2, 2.4, 4.8)
# Distance from the centre of a ridge to each of its sides, in sigmas.
SIDE_SIGMAS = 2.5
# Smoothing of details over columns and rows [px], and distance of the rows whose mean is subtracted.
DETAIL_SIGMAS, DETAIL_SIDE = (0.8, 1.6), 5
# Noise of fewer grey levels than this cannot be separated from quantisation.
LEAST_NOISE = 0.15
# Texture counts as noise of which TEXTURE_QUANTILE is below TEXTURE_SIGMAS sigmas.
TEXTURE_QUANTILE, TEXTURE_SIGMAS = 0.99, 3.0
# Evidence is zero at the first of these strengths of a ridge, grows in proportion up to the second, then with the
# logarithm times the gain.
ZERO_SIGMAS, LINEAR_SIGMAS, LOG_GAIN = 3.2, 8.0, 3.0
# Number of parts of equal size into which a scene is divided by brightness, to measure the noise of each.
LEVEL_PARTS = 8


def _select(values: Array, rank: int) -> float:
    """Value of this rank; the lowest has rank 0."""
    return float(np.sort(values, axis=None)[rank])


def _upper_medians(rows: Array) -> Array:
    """Upper median of each row (n,) of values (n, m)."""
    return np.sort(rows, axis=1)[:, rows.shape[1] // 2]


def _upper_median(values: Array) -> float:
    """Upper median of values."""
    return _select(values, values.size // 2)


def details(picture: Float32) -> Float32:
    """Light of each channel (rows, columns, channels) above the mean of the rows above and below."""
    smooth = cv2.GaussianBlur(picture, (3, 9), DETAIL_SIGMAS[0], sigmaY=DETAIL_SIGMAS[1]).reshape(picture.shape)
    up, low = (
        smooth[np.clip(np.arange(len(smooth)) + side, 0, len(smooth) - 1)] for side in (-DETAIL_SIDE, DETAIL_SIDE)
    )
    return smooth - np.float32(0.5) * (up + low)


def covariance(detail: Float32, elsewhere: Mask) -> Float:
    """Covariance (channels, channels) of the details of a scene away from the stripe."""
    use = elsewhere[::COVARIANCE_ROWS, ::COVARIANCE_COLUMNS]
    some = np.ascontiguousarray(detail[::COVARIANCE_ROWS, ::COVARIANCE_COLUMNS]).reshape(-1, detail.shape[2])
    some[np.flatnonzero(~use)] = 0
    seen = (some.T @ some).astype(np.float64) / max(int(use.sum()), 1)
    return np.asarray(seen + np.eye(len(seen)) * (LEAST_DEVIATION**2 + UNKNOWN_SHARE * np.trace(seen)))


def laser_weights(scene: Float, colour: Float) -> Float:
    """Weights (channels,) of Fisher's linear discriminant that keep the brightness of the laser's colour."""
    weights = np.linalg.solve(scene, colour)
    return np.asarray(weights / max(float(colour @ weights), 1e-9))


def in_laser_colour(
    picture: Float32, frame: Float32, scene: Float, colour: Float, channel: int
) -> tuple[Float32, Mask]:
    """Picture in the colour of the laser (Fisher's linear discriminant), and mask of its clipped pixels.

    A clipped pixel is at least as bright as the rim of its core. It is filled from the rim and slightly raised by the
    other channels, which still show the centre.

    Args:
        picture: (rows, columns, channels) float32 light.
        frame: (rows, columns, channels) the picture as delivered, 0 to 255, which shows what is clipped.
        scene: (channels, channels) covariance of the scene's details.
        colour: (channels,) colour of the laser, 1 in its own channel.
        channel: the laser's own.
    """
    weights = laser_weights(scene, colour)
    channels = picture.shape[2]
    mixed: Float32 = np.ascontiguousarray(picture[:, :, 0])
    if channels > 1:
        transformed = cv2.transform(picture, weights[None].astype(np.float32))
        mixed = np.asarray(transformed, np.float32).reshape(picture.shape[:2])
    full = cv2.extractChannel(frame, channel) >= CLIPPED
    if channels == 1 or not full.any():
        return mixed, full
    core = cv2.dilate(full.view(np.uint8), np.ones((3, 1), np.uint8)).view(bool)
    at = np.flatnonzero(core)
    # Rows that are too far from any core to affect the closing are omitted.
    rows = np.flatnonzero(core.any(axis=1))
    first, last = max(int(rows[0]) - WIDEST_CORE_PX, 0), int(rows[-1]) + WIDEST_CORE_PX + 1
    closed = cv2.morphologyEx(mixed[first:last], cv2.MORPH_CLOSE, np.ones((WIDEST_CORE_PX, 1), np.uint8))
    inside, rim = picture.reshape(-1, channels).take(at, axis=0), closed.reshape(-1).take(at - first * core.shape[1])
    others = np.float32(OTHERS_SHARE) * (inside.sum(axis=1) - inside[:, channel])
    mixed.reshape(-1)[at] = rim + np.clip(others, 0, np.float32(MOST_OF_CORE) * np.maximum(rim, 0))
    return mixed, core


def rim_colour(picture: Float32, frame: Float32, row: Index, is_stripe: Mask, channel: int) -> Float:
    """Median colour (channels,) that a stripe adds to its surroundings in the brighter half of its columns.

    Args:
        picture: (rows, columns, channels) float32 light.
        frame: (rows, columns, channels) the picture as delivered, 0 to 255.
        row, is_stripe: (columns,) row of the stripe, and whether there is one.
        channel: channel by which the brighter half of the columns is chosen.
    """
    columns, last = _some(np.flatnonzero(is_stripe)), len(picture) - 1
    if not columns.size:
        return np.zeros(picture.shape[2])
    rows, width = row[columns], picture.shape[1]
    pixels, as_delivered = picture.reshape(-1, picture.shape[2]), frame.reshape(-1, frame.shape[2])
    above, below = (
        pixels.take(np.clip(rows + side, 0, last) * width + columns, axis=0) for side in (-BACKGROUND_PX, BACKGROUND_PX)
    )
    at = np.clip(rows + np.arange(-RIM_PX, RIM_PX + 1)[:, None], 0, last) * width + columns
    # Channel by channel: numpy is slow along an axis of three.
    is_clear = np.logical_and.reduce([as_delivered[:, c].take(at) < CLIPPED for c in range(frame.shape[2])])
    added = ((pixels.take(at, axis=0) - np.float32(0.5) * (above + below)) * is_clear[:, :, None]).sum(axis=0)
    bright = added[added[:, channel] >= _upper_median(added[:, channel])]
    return _upper_medians(bright.T).astype(np.float64)


def core_colour(detail: Float32, frame: Float32, row: Index, is_stripe: Mask, channel: int) -> Float:
    """Median colour (channels,) of the centre of a stripe where no channel but the laser's own is clipped.

    Args:
        detail: (rows, columns, channels) details of the light, as `details` gives them.
        frame: (rows, columns, channels) the picture as delivered, 0 to 255.
        row, is_stripe: (columns,) row of the stripe, and whether there is one.
        channel: the laser's own channel: even clipped it is a lower bound.
    """
    columns = _some(np.flatnonzero(is_stripe))
    rows = row[columns]
    is_clear = np.delete(frame[rows, columns], channel, axis=1).max(axis=1, initial=0) < CLIPPED
    added = detail[rows, columns][is_clear]
    return _upper_medians(added.T).astype(np.float64) if len(added) else np.zeros(detail.shape[2])


def _some(columns: Index) -> Index:
    """Up to COLOUR_COLUMNS of them, evenly selected."""
    return columns[:: max(-(-columns.size // COLOUR_COLUMNS), 1)]


def relative_colour(added: Float, channel: int) -> Float:
    """Colour relative to one channel, with the others limited to MOST_LEAKAGE."""
    colour = np.clip(added / max(float(added[channel]), 1e-6), 0, MOST_LEAKAGE)
    colour[channel] = 1
    return np.asarray(colour)


def purity(added: Float, channel: int) -> float:
    """Purity of a colour for a laser of this channel: 0 for white or another laser's colour, 1 for a pure one."""
    if added.size == 1:
        return 1.0
    if added[channel] <= 0:
        return 0.0
    return float(np.clip((1.05 - np.delete(added, channel).max() / added[channel]) / 0.6, 0, 1))


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
        strong = np.log(np.maximum(self.strength / LINEAR_SIGMAS, 1))
        return np.minimum(self.strength, LINEAR_SIGMAS) - np.float32(ZERO_SIGMAS) + np.float32(LOG_GAIN) * strong


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
    strength = np.max([height / np.float32(noise) for height, noise in zip(heights, noises, strict=True)], axis=0)
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
    """Standard deviation of ridges of noise (rows, columns) [grey levels]."""
    noise = max(robust_sigma(height[::3, ::7]), LEAST_NOISE)
    if elsewhere is not None:
        some = height[::2, ::3][elsewhere[::2, ::3]]
        if some.size:
            noise = max(noise, _select(some, int(TEXTURE_QUANTILE * some.size)) / TEXTURE_SIGMAS)
    return noise


def ridge_of_width(light: Float32, sigma: float) -> Float32:
    """Height of the light, smoothed to this sigma [px] over rows, above the higher of its two sides."""
    rows, reach, side = len(light), int(np.ceil(2 * sigma)), max(round(SIDE_SIGMAS * sigma), 2)
    taps = cv2.getGaussianKernel(2 * reach + 1, sigma, cv2.CV_32F)
    smooth = cv2.sepFilter2D(light, -1, np.full(3, 1 / 3, np.float32), taps, borderType=cv2.BORDER_REPLICATE)
    up, low = (smooth[np.clip(np.arange(rows) + shift, 0, rows - 1)] for shift in (-side, side))
    return np.asarray(smooth - np.maximum(up, low), np.float32)
