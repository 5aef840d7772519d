"""Turns a pair of frames into one picture of laser light: background removed, one channel or several fused."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from guara_perception.stripes.middle import middle, spread

Float32 = npt.NDArray[np.float32]
Light = npt.NDArray[np.int16] | Float32
Plane = npt.NDArray[Any]

# Half the height of the opening that stands in for a missing off frame: wider than any stripe, narrower than texture.
BACKGROUND_HALF_HEIGHT_PX = 12
# A frame whose brightness away from the stripe moved by more than this share of full scale is not a pair.
MAX_AMBIENT_CHANGE = 0.15
# From this share of full scale a pixel counts as clipped; JPEG and demosaicing keep it from reaching 1.
CLIPPED = 0.98
# Statistics of a band are taken from every so many rows and columns.
SAMPLE_ROWS, SAMPLE_COLUMNS = 8, 24
# No stripe is thinner than two rows.
JUDGED_ROWS, JUDGED_COLUMNS = 2, 64
# Even a channel that is clipped throughout says where the shoulders of the stripe are.
LEAST_HEADROOM = 0.3


@dataclass(frozen=True, slots=True)
class LaserLight:
    """The laser's own light in a band of rows.

    Attributes:
        light: (rows, columns) int16 or float32, grey levels above background, negative where noise makes it so.
        plane: (rows, columns) the channel that the laser lights most, as delivered.
        full_scale: value at which that channel is clipped for certain.
        channel: number of that channel.
        reason: why the pair cannot be used, empty when it can.
    """

    light: Light
    plane: Plane
    full_scale: float
    channel: int
    reason: str = ""

    @property
    def clipped_from(self) -> float:
        """Grey level from which a pixel counts as clipped."""
        return CLIPPED * self.full_scale


def laser_light(on: npt.NDArray[Any], off: npt.NDArray[Any] | None) -> LaserLight:
    """Subtract the background in the channel that the laser lights most.

    Args:
        on: (rows, columns) or (rows, columns, channels), uint8 or uint16, laser on.
        off: the same with the laser off, or None: the background is then a vertical grey opening of `on`.
    """
    full_scale = float(np.iinfo(on.dtype).max)
    channel = strongest_channel(on, off)
    plane = channel_of(on, channel)
    light = difference(plane, None if off is None else channel_of(off, channel))
    offset = middle(light[::SAMPLE_ROWS, ::SAMPLE_COLUMNS])
    reason = ""
    if abs(offset) > MAX_AMBIENT_CHANGE * full_scale:
        reason = f"brightness beside the stripe changed by {offset:+.0f} of {full_scale:.0f} between laser off and on"
    elif abs(offset) > full_scale / 256:
        light = light - light.dtype.type(offset)
    return LaserLight(light, plane, full_scale, channel, reason)


def fused_light(
    on: npt.NDArray[Any], off: npt.NDArray[Any] | None, top: npt.NDArray[np.intp], columns: npt.NDArray[np.intp]
) -> Float32:
    """Light of all channels together, for stripes whose core clips the strongest one.

    Each channel is weighted by its headroom (the share of stripe tops at which it is not clipped) times its signal
    over its noise variance, all taken from the data, so a line of any colour works alike.

    Args:
        on, off: as in `laser_light`; three channels.
        top: (n,) rows of stripe tops.
        columns: (n,) their columns.

    Returns:
        (rows, columns) float32, in grey levels of the strongest channel.
    """
    full_scale = float(np.iinfo(on.dtype).max)
    on = np.ascontiguousarray(on)
    light = np.asarray(cv2.subtract(on, opening(on) if off is None else off, dtype=cv2.CV_32F))
    sample, tops, seen = light[::SAMPLE_ROWS, ::SAMPLE_COLUMNS], light[top, columns], on[top, columns]
    offsets, gains, weights = [], [], []
    for channel in range(on.shape[2]):
        offset = middle(sample[:, :, channel])
        noise = max(spread(sample[:, :, channel]), full_scale / 512)
        headroom = max(float(np.mean(seen[:, channel] < CLIPPED * full_scale)), LEAST_HEADROOM)
        gain = max(middle(tops[:, channel]) - offset - noise, 0.0)
        offsets.append(offset)
        gains.append(gain)
        weights.append(headroom**2 * gain / noise**2)
    scale = max(gains) / max(float(np.dot(weights, gains)), 1e-12)
    shares = scale * np.array(weights)
    mixture = np.append(shares, -float(shares @ offsets)).astype(np.float32)
    return np.asarray(cv2.transform(light, mixture[None]))


def strongest_channel(on: npt.NDArray[Any], off: npt.NDArray[Any] | None) -> int:
    """Number of the channel in which the stripe stands out most from the noise, judged on some columns; 0 for mono."""
    if on.ndim == 2 or on.shape[2] == 1:
        return 0
    judged = np.s_[::JUDGED_ROWS, ::JUDGED_COLUMNS]
    columns = on[judged].astype(np.float32).reshape(-1, on[judged].shape[1] * on.shape[2])
    columns -= off[judged].reshape(columns.shape) if off is not None else np.median(columns, axis=0)
    # Mean absolute value instead of a robust spread: the stripe is a small part of a column and raises it alike.
    noise = np.abs(columns).mean(axis=0)
    return int(np.argmax((columns.max(axis=0) - 4 * noise).reshape(-1, on.shape[2]).mean(axis=0)))


def channel_of(frame: npt.NDArray[Any], channel: int) -> Plane:
    """One channel as a contiguous picture."""
    if frame.ndim == 2:
        return np.ascontiguousarray(frame)
    if frame.shape[2] == 1:
        return np.ascontiguousarray(frame[:, :, 0])
    plane = np.empty(frame.shape[:2], dtype=frame.dtype)
    cv2.mixChannels([np.ascontiguousarray(frame)], [plane], [channel, 0])
    return plane


def difference(plane: Plane, background: Plane | None) -> Light:
    """Plane minus background, not saturating: negative values carry the noise."""
    background = opening(plane) if background is None else background
    kind = cv2.CV_16S if plane.dtype == np.uint8 else cv2.CV_32F
    light: Light = cv2.subtract(plane, background, dtype=kind)  # type: ignore[assignment]
    return light


def opening(plane: Plane) -> Plane:
    """Vertical grey opening: the picture without anything as narrow as a stripe."""
    kernel = np.ones((2 * BACKGROUND_HALF_HEIGHT_PX + 1, 1), np.uint8)
    return np.asarray(cv2.morphologyEx(plane, cv2.MORPH_OPEN, kernel))
