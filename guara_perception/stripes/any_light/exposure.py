"""Subtraction of the laser-off picture, also one of another exposure."""

from __future__ import annotations

import cv2
import numpy as np

from guara_perception.arrays import Float32
from guara_perception.stripes.any_light.laser_colour import CLIPPED
from guara_perception.stripes.kernel.library import address, kernel

# Largest share of the plain difference that may remain after a gain was fitted, if the gain is to be used.
MOST_LEFT = 0.7
# Bright pixels show a gain best, and may be few: this brightest share of all is looked at by itself too.
BRIGHT_SHARE = 0.1
# Beyond this ratio of exposures noise, clipping and the camera's own curve differ too: a gain cannot remove the scene.
MOST_GAIN = 1.6
# A laser-off picture that leaves more than this share of the scene's own contrast, and more than these grey levels, is
# of another scene.
MOST_SCENE_LEFT, LEAST_SCENE_LEFT = 0.5, 6.0
# The exposure is fitted to some rows and columns; scenes are compared by the means of blocks of pixels.
SAMPLE_ROWS, SAMPLE_COLUMNS, BLOCK = 8, 4, 8


def subtract(on: Float32, off: Float32) -> tuple[Float32, Float32, str]:
    """On minus off and an offset per channel, with a gain where exposures differ.

    Args:
        on, off: (rows, columns, channels) float32, 0 to 255.

    Returns:
        The light, the gains (channels,) of `off`, and why it is that of `on` alone; empty where `off` could be used.
    """
    gains, offsets = np.ones(on.shape[2], np.float32), np.zeros(on.shape[2], np.float32)
    on_blocks, off_blocks = (_blocks(picture) for picture in (on, off))
    for channel in range(on.shape[2]):
        dark, bright = (picture[::SAMPLE_ROWS, ::SAMPLE_COLUMNS, channel].ravel() for picture in (off, on))
        is_good = (dark < CLIPPED) & (bright < CLIPPED)
        dark, bright = dark[is_good], bright[is_good]
        if not dark.size:
            continue
        fitted_gain, fitted_offset, offset, left, plain = _fitted(dark, bright)
        gain = 1.0
        if left < MOST_LEFT * plain:
            gain, offset = fitted_gain, fitted_offset
        if not 1 / MOST_GAIN <= gain <= MOST_GAIN:
            return on, gains, other_exposure(1 / gain)
        gains[channel], offsets[channel] = gain, offset
        blocks = on_blocks[:, :, channel]
        scene, unlike = _contrast(blocks), _contrast(blocks - gains[channel] * off_blocks[:, :, channel])
        if unlike > max(MOST_SCENE_LEFT * scene, LEAST_SCENE_LEFT):
            reason = f"the laser-off picture is of another scene: {unlike:.0f} of {scene:.0f} grey levels remain"
            return on, gains, reason
    light = np.empty_like(on)
    pixels, channels = on.shape[0] * on.shape[1], on.shape[2]
    given = (address(on), address(off), pixels, channels, address(gains), address(offsets))
    kernel().subtract(*given, address(light))
    return light, gains, ""


def other_exposure(ratio: float) -> str:
    """Why a laser-off picture so many times as bright as the laser-on one is not used."""
    return f"the laser-off picture is {ratio:.2f} times as bright as the laser-on one: expose both alike"


def _blocks(picture: Float32) -> Float32:
    """Means (rows, columns, channels) of blocks of a picture."""
    blocks = cv2.resize(picture, None, fx=1 / BLOCK, fy=1 / BLOCK, interpolation=cv2.INTER_AREA)
    return np.asarray(blocks, np.float32).reshape(*blocks.shape[:2], -1)


def _contrast(blocks: Float32) -> float:
    """Median deviation of blocks from their median: that of the scene, not of noise."""
    return float(np.median(np.abs(blocks - np.median(blocks))))


def _fitted(dark: Float32, bright: Float32) -> list[float]:
    """Gain and offset by which the bright values follow from the dark ones; the offset without gain; what is left.

    What either of the two leaves is the median deviation of all pixels plus that of the brightest.
    """
    work, found = np.empty(2 * dark.size, np.float32), np.empty(5)
    bright_from = float(np.quantile(dark, 1 - BRIGHT_SHARE))
    kernel().exposure(address(dark), address(bright), dark.size, bright_from, address(work), address(found))
    return found.tolist()
