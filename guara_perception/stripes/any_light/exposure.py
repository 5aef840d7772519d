"""Subtraction of the laser-off picture, also one of another exposure."""

from __future__ import annotations

import cv2
import numpy as np

from guara_perception.arrays import Float32
from guara_perception.stripes.any_light.laser_colour import CLIPPED

# Iterations of the fit of the gain between laser off and on; number of median deviations beyond which a pixel is left
# out; and the largest share of the plain difference that may remain after the fit if it is to be used.
GAIN_ROUNDS, TRIM_DEVIATIONS, MOST_LEFT = 6, 2.5, 0.7
# Bright pixels show a gain best, and may be few: this brightest share of all is looked at by itself too.
BRIGHT_SHARE = 0.1
# Beyond this ratio of exposures noise, clipping and the camera's own curve differ too: a gain cannot remove the scene.
MOST_GAIN = 1.6
# A laser-off picture that leaves more than this share of the scene's own contrast, and more than these grey levels, is
# of another scene.
MOST_SCENE_LEFT, LEAST_SCENE_LEFT = 0.5, 6.0
# The exposure is fitted to every fourth pixel each way; scenes are compared by the means of blocks of pixels.
SAMPLE, BLOCK = 4, 8


def subtract(on: Float32, off: Float32) -> tuple[Float32, str]:
    """On minus off and an offset per channel, with a gain where exposures differ.

    Args:
        on, off: (rows, columns, channels) float32, 0 to 255.

    Returns:
        The light, and the reason for which it is that of `on` alone; empty where `off` could be used.
    """
    light = on - off
    for channel in range(on.shape[2]):
        dark, bright = (picture[::SAMPLE, ::SAMPLE, channel].ravel() for picture in (off, on))
        is_good = (dark < CLIPPED) & (bright < CLIPPED)
        dark, bright = dark[is_good], bright[is_good]
        if not dark.size:
            continue
        is_bright = dark >= np.quantile(dark, 1 - BRIGHT_SHARE)
        gain, offset = 1.0, float(np.median(bright - dark))
        fitted_gain, fitted_offset = _fitted(dark, bright)
        left, plain = (
            float(np.median(deviation) + np.median(deviation[is_bright]))
            for deviation in (
                np.abs(bright - fitted_gain * dark - fitted_offset),
                np.abs(bright - dark - offset),
            )
        )
        if left < MOST_LEFT * plain:
            gain, offset = fitted_gain, fitted_offset
            light[:, :, channel] = on[:, :, channel] - np.float32(gain) * off[:, :, channel]
        if not 1 / MOST_GAIN <= gain <= MOST_GAIN:
            return on, f"the laser-off picture is {1 / gain:.2f} times as bright as the laser-on one: expose both alike"
        scene, unlike = (_contrast(picture) for picture in (on[:, :, channel], light[:, :, channel]))
        if unlike > max(MOST_SCENE_LEFT * scene, LEAST_SCENE_LEFT):
            return on, f"the laser-off picture is of another scene: {unlike:.0f} of {scene:.0f} grey levels remain"
        light[:, :, channel] -= np.float32(offset)
    return light, ""


def _contrast(picture: Float32) -> float:
    """Median deviation from the median of the blocks of a picture (rows, columns): that of the scene, not of noise."""
    blocks = cv2.resize(picture, None, fx=1 / BLOCK, fy=1 / BLOCK, interpolation=cv2.INTER_AREA)
    return float(np.median(np.abs(blocks - np.median(blocks))))


def _fitted(dark: Float32, bright: Float32) -> tuple[float, float]:
    """Gain and offset by which the bright values follow from the dark ones."""
    use = np.ones(dark.size, dtype=bool)
    gain, offset = 1.0, 0.0
    for _ in range(GAIN_ROUNDS):
        x, y = dark[use], bright[use]
        from_mean = x - x.mean()
        variance = float((from_mean**2).mean())
        if variance < 1:
            break
        gain = float((from_mean * y).mean()) / variance
        offset = float(y.mean() - gain * x.mean())
        deviation = np.abs(bright - gain * dark - offset)
        left = float(np.median(deviation))
        use = deviation <= TRIM_DEVIATIONS * max(left, 0.5)
    return gain, offset
