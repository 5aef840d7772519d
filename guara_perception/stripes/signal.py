"""Turns a pair of frames into one picture of laser light: background removed, channels fused by signal and noise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

Float32 = npt.NDArray[np.float32]

# Half the height of the opening that stands in for a missing off frame: wider than any stripe, narrower than texture.
BACKGROUND_HALF_HEIGHT_PX = 12
# A frame whose brightness away from the stripe moved by more than this share of full scale is not a pair.
MAX_AMBIENT_CHANGE = 0.15


@dataclass(frozen=True, slots=True)
class LaserLight:
    """The laser's own light in a band of rows.

    Attributes:
        light: (rows, columns) float32, grey levels above background.
        is_clipped: (rows, columns) bool, where the brightest channel is at full scale.
        noise: standard deviation of `light` where there is no laser [grey levels].
        reason: why the pair cannot be used, empty when it can.
    """

    light: Float32
    is_clipped: npt.NDArray[np.bool_]
    noise: float
    reason: str = ""


def laser_light(on: npt.NDArray[Any], off: npt.NDArray[Any] | None) -> LaserLight:
    """Subtract the background and fuse the channels.

    Each channel is weighted by its signal over its noise variance, both taken from the data, so a line of any colour
    and a mono camera work alike; the result is scaled back to the grey levels of the strongest channel.

    Args:
        on: (rows, columns) or (rows, columns, 3), uint8 or uint16, laser on.
        off: the same with the laser off, or None: the background is then a vertical grey opening of `on`.
    """
    full_scale = float(np.iinfo(on.dtype).max)
    lit = on.reshape(on.shape[0], on.shape[1], -1)
    differences, gains, noises = [], [], []
    for channel in range(lit.shape[2]):
        plane = np.ascontiguousarray(lit[:, :, channel]).astype(np.float32)
        background = _opening(plane) if off is None else _channel(off, channel)
        difference = plane - background
        sample = difference[::2, ::3]
        offset = float(np.median(sample))
        if abs(offset) > MAX_AMBIENT_CHANGE * full_scale:
            reason = (
                f"brightness away from the stripe changed by {offset:+.0f} of {full_scale:.0f} between laser off and on"
            )
            return LaserLight(difference, np.zeros(difference.shape, bool), np.nan, reason)
        difference -= offset
        noise = max(1.4826 * float(np.median(np.abs(sample - offset))), full_scale / 512)
        differences.append(difference)
        noises.append(noise)
        gains.append(max(float(np.median(difference.max(axis=0))) - 2.5 * noise, 0.0))
    strongest = int(np.argmax(gains))
    is_clipped = lit[:, :, strongest] >= 0.98 * full_scale
    if gains[strongest] <= 0:
        return LaserLight(differences[strongest], is_clipped, noises[strongest])
    weights = np.array([gain / noise**2 for gain, noise in zip(gains, noises, strict=True)])
    weights *= gains[strongest] / float(np.dot(weights, gains))
    light = sum(weight * plane for weight, plane in zip(weights, differences, strict=True) if weight > 0)
    noise = float(np.sqrt(np.sum((weights * np.array(noises)) ** 2)))
    return LaserLight(np.asarray(light, dtype=np.float32), is_clipped, noise)


def _channel(frame: npt.NDArray[Any], channel: int) -> Float32:
    plane = frame if frame.ndim == 2 else frame[:, :, channel]
    return np.ascontiguousarray(plane).astype(np.float32)


def _opening(plane: Float32) -> Float32:
    kernel = np.ones((2 * BACKGROUND_HALF_HEIGHT_PX + 1, 1), np.uint8)
    return np.asarray(cv2.morphologyEx(plane, cv2.MORPH_OPEN, kernel), dtype=np.float32)
