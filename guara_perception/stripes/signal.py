"""Turns a pair of frames into one picture of laser light: background removed, one channel or several fused."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from guara_perception.stripes.channels import Frame, OffRows, Plane, channel_of
from guara_perception.stripes.judge import clipped_from, is_clipped, judge
from guara_perception.stripes.middle import SIGMA_PER_DEVIATION, middle, middles
from guara_perception.stripes.windows import sampled

Float32 = npt.NDArray[np.float32]
Light = npt.NDArray[np.int16] | Float32

# Half the height of the opening that stands in for a missing off frame: wider than any stripe, narrower than texture.
BACKGROUND_HALF_HEIGHT_PX = 12
# A frame whose brightness away from the stripe moved by more than this share of full scale is not a pair.
MAX_AMBIENT_CHANGE = 0.15
# The tops of the stripe are taken from every so many columns, where they stand so far above the noise.
TOP_COLUMNS = 16
TOP_SIGMAS = 5.0
# Even a channel that is clipped throughout says where the shoulders of the stripe are.
LEAST_HEADROOM = 0.3


@dataclass(frozen=True, slots=True)
class LaserLight:
    """The laser's own light in a band of rows.

    Attributes:
        light: (rows, columns) int16 or float32, grey levels above background, negative where noise makes it so.
        frame: (rows, columns[, channels]) laser on, as delivered; only the channel used where only one was.
        background: the same with the laser off, None where there was no picture of it.
        channel: of `frame` and `background` that the laser lights most.
        is_fused: whether `light` is of all channels together; otherwise it is of that one.
        is_clipped: whether any pixel of that channel is at the end of its scale.
        reason: why the pair cannot be used, empty when it can.
    """

    light: Light
    frame: Frame
    background: Frame | None
    channel: int = 0
    is_fused: bool = False
    is_clipped: bool = False
    reason: str = ""


def laser_light(on: Frame, off: OffRows | None) -> LaserLight:
    """Subtract the background in the channel that the laser lights most; fuse the channels where that one is clipped.

    Args:
        on: (rows, columns) or (rows, columns, channels), uint8 or uint16, laser on.
        off: the same with the laser off, or None: the background is then a vertical grey opening of `on`.
    """
    dark = None if off is None else off.frame
    seen = judge(on, dark)
    full_scale = float(np.iinfo(on.dtype).max)
    if seen.is_swapped:
        return _unusable(on, "the stripe is darker than its surroundings: laser-on and laser-off frames are swapped")
    if off is not None and abs(seen.change) > MAX_AMBIENT_CHANGE * full_scale:
        return _unusable(
            on,
            f"brightness beside the stripe changed by {seen.change:+.0f} of {full_scale:.0f} between laser off and on",
        )
    if seen.is_core_clipped and has_colour(on):
        return LaserLight(fused_light(on, dark, seen.channel), on, dark, seen.channel, is_fused=True, is_clipped=True)
    plane, background = channel_of(on, seen.channel), None if off is None else off.plane(seen.channel)
    light = difference(plane, background)
    offset = middle(sampled(light))
    if abs(offset) > full_scale / 256:
        light -= light.dtype.type(offset)
    return LaserLight(light, plane, background, is_clipped=bool(plane.max() >= clipped_from(plane.dtype)))


def _unusable(on: Frame, reason: str) -> LaserLight:
    return LaserLight(np.zeros((0, 0), np.int16), on, None, reason=reason)


def fused_light(on: Frame, off: Frame | None, channel: int) -> Float32:
    """Light of all channels together, for stripes whose core clips the strongest one.

    Each channel is weighted by its headroom (the share of stripe tops at which it is not clipped) times its signal
    over its noise variance, all taken from the data, so a line of any colour works alike.

    Args:
        on: (rows, columns, 3) uint8 or uint16, laser on.
        off: the same with the laser off, or None.
        channel: that the laser lights most: its tops are those of the stripe.

    Returns:
        (rows, columns) float32, in grey levels of the strongest channel.
    """
    full_scale = float(np.iinfo(on.dtype).max)
    on = np.ascontiguousarray(on)
    light = np.asarray(cv2.subtract(on, opening(on) if off is None else off, dtype=cv2.CV_32F))
    sample = np.ascontiguousarray(sampled(light).reshape(-1, 3).T)
    offsets = middles(sample).astype(np.float64)
    noise = SIGMA_PER_DEVIATION * middles(np.abs(sample - offsets[:, None].astype(np.float32)))
    noise = np.maximum(noise.astype(np.float64), full_scale / 512)
    smooth = cv2.GaussianBlur(np.ascontiguousarray(light[:, ::TOP_COLUMNS, channel]), (1, 5), 0)
    shown = np.flatnonzero(smooth.max(axis=0) > TOP_SIGMAS * noise[channel])
    shown = shown if shown.size else np.arange(smooth.shape[1])
    top, columns = smooth.argmax(axis=0)[shown], TOP_COLUMNS * shown
    headroom = np.maximum(1 - is_clipped(on[top, columns]).mean(axis=0), LEAST_HEADROOM)
    gains = np.maximum(middles(light[top, columns].T) - offsets - noise, 0.0)
    weights = headroom**2 * gains / noise**2
    shares = weights * (gains.max() / max(float(weights @ gains), 1e-12))
    mixture = np.append(shares, -float(shares @ offsets)).astype(np.float32)
    return np.asarray(cv2.transform(light, mixture[None]))


def has_colour(frame: Frame) -> bool:
    """Whether a picture has three channels."""
    return frame.ndim == 3 and frame.shape[2] == 3


def difference(plane: Plane, background: Plane | None) -> Light:
    """Plane minus background, not saturating: negative values carry the noise."""
    background = opening(plane) if background is None else background
    return np.subtract(plane, background, dtype=np.int16 if plane.dtype == np.uint8 else np.float32)


def opening(plane: Plane) -> Plane:
    """Vertical grey opening: the picture without anything as narrow as a stripe."""
    kernel = np.ones((2 * BACKGROUND_HALF_HEIGHT_PX + 1, 1), np.uint8)
    return np.asarray(cv2.morphologyEx(plane, cv2.MORPH_OPEN, kernel))
