"""Laser light of a pair of frames: background removed, one channel or several fused."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from guara_perception.arrays import Array, Float32, Image, Index, Mask
from guara_perception.stripes.band import (
    OffRows,
    channel_of,
    clipped_from,
    has_colour,
    is_clipped,
    rows_from,
    sampled,
)
from guara_perception.stripes.peaks import SIGMA_PER_DEVIATION, upper_median, upper_medians

# Rows from one judged row to the next, and number of judged columns: a thin stripe is missed in some, never in all.
JUDGED_ROWS, JUDGED_COLUMNS = 3, 16
# Mean deviations of the noise above which the peak of a column stands out: noise alone reaches four of them.
NOISE_DEVIATIONS, PEAK_DEVIATIONS = 4.0, 6.0
# From this share of clipped tops on, the channels are fused.
FUSE_FROM_CLIPPED = 0.2
# Half the height of the opening that stands in for a missing off frame: wider than any stripe, narrower than texture.
BACKGROUND_HALF_HEIGHT_PX = 12
# Largest change of the brightness beside the stripe between laser off and on, as a share of full scale: beyond the
# first the frames are no pair; beyond the second the exposure changed, so that the difference shows the texture too.
MAX_AMBIENT_CHANGE, EVEN_AMBIENT_CHANGE = 0.15, 1 / 64
# Columns from one sampled top of the stripe to the next, and sigmas of noise by which a top stands out.
TOP_COLUMNS = 16
TOP_SIGMAS = 5.0
# Even a channel that is clipped throughout shows where the shoulders of the stripe are.
LEAST_HEADROOM = 0.3
# Rows whose channels are mixed in one go: all at once they would need four times the memory of the band.
MIXED_ROWS = 32
# How far to each side of its top the core is looked at, in sigmas of the stripe.
REACH_SIGMAS = 3.0
# A clipped core wider than this, in sigmas of the stripe, leaves no shoulders to judge by.
MAX_CLIPPED_SIGMAS = 5.0


@dataclass(frozen=True, slots=True)
class Judgement:
    """Assessment of a pair of frames by some columns of a band.

    Attributes:
        channel: number of the channel in which the stripe stands out most from the noise; 0 for mono.
        is_swapped: the dark side looks like a stripe and the bright side does not.
        change: how much brighter the surroundings of the stripe are than the background [grey levels].
        is_uneven: whether the surroundings are brighter or darker in any channel.
        is_core_clipped: whether the stripe's core is clipped in that channel in more than FUSE_FROM_CLIPPED of the
            columns.
    """

    channel: int
    is_swapped: bool
    change: float
    is_uneven: bool
    is_core_clipped: bool


@dataclass(frozen=True, slots=True)
class LaserLight:
    """The laser's own light in a band of rows.

    Attributes:
        light: (rows, columns) int16 or float32, grey levels above background, negative where noise makes it so.
        frame: (rows, columns[, channels]) laser on, as delivered, or only the channel used.
        background: the same with the laser off, None where there was no picture of it.
        channel: the channel of `frame` and `background` that the laser lights most.
        is_fused: whether `light` is of all channels together; otherwise it is of that one.
        is_clipped: whether any pixel of that channel is at the end of its scale.
        is_uneven: whether the laser-off picture was exposed a little otherwise.
        unlike: reason for which the laser-off picture cannot be used, in which case there is no `light`; else empty.
        reason: reason for which the pair cannot be used; empty when it can.
    """

    light: Array
    frame: Image
    background: Image | None
    channel: int = 0
    is_fused: bool = False
    is_clipped: bool = False
    is_uneven: bool = False
    unlike: str = ""
    reason: str = ""


def laser_light(on: Image, off: OffRows | None) -> LaserLight:
    """Subtract the background in the channel that the laser lights most; fuse the channels where that one is clipped.

    Args:
        on: (rows, columns) or (rows, columns, channels), uint8 or uint16, laser on.
        off: the same with the laser off, or None: the background is then a vertical grey opening of `on`.
    """
    dark = None if off is None else off.frame
    seen = judge(on, dark)
    full_scale = float(np.iinfo(on.dtype).max)
    nothing = np.zeros((0, 0), np.int16)
    if seen.is_swapped:
        reason = "the stripe is darker than its surroundings: laser-on and laser-off frames are swapped"
        return LaserLight(nothing, on, None, reason=reason)
    if off is not None and abs(seen.change) > MAX_AMBIENT_CHANGE * full_scale:
        change = f"{seen.change:+.0f} of {full_scale:.0f}"
        unlike = f"brightness beside the stripe changed by {change} between laser off and on"
        return LaserLight(nothing, on, None, unlike=unlike)
    if seen.is_core_clipped and has_colour(on):
        fused = fused_light(on, dark, seen.channel)
        return LaserLight(fused, on, dark, seen.channel, is_fused=True, is_clipped=True, is_uneven=seen.is_uneven)
    bright, background = channel_of(on, seen.channel), None if off is None else off.channel(seen.channel)
    light = difference(bright, background)
    offset = upper_median(sampled(light))
    if abs(offset) > full_scale / 256:
        light -= light.dtype.type(offset)
    is_core_clipped = bool(bright.max() >= clipped_from(bright.dtype))
    channel = 0
    if on.flags.c_contiguous and (dark is None or dark.flags.c_contiguous):
        # The few pixels that are read later are found in the pictures themselves: the channel need not be held.
        bright, background, channel = on, dark, seen.channel
    return LaserLight(light, bright, background, channel, is_clipped=is_core_clipped, is_uneven=seen.is_uneven)


def judge(on: Image, off: Image | None) -> Judgement:
    """Judge a pair by some columns: which channel shows the stripe best, and whether its core is clipped.

    Args:
        on: (rows, columns[, channels]) uint8 or uint16, laser on.
        off: the same with the laser off, or None.
    """
    interval = max(on.shape[1] // JUDGED_COLUMNS, 1)
    seen = _judged(on, interval)
    light = seen - (np.median(seen, axis=0) if off is None else _judged(off, interval))
    changes = np.zeros(light.shape[2], np.float32)
    height = light.max(axis=0)
    # Without the brightest pixel of each column: the stripe's own light is no change of the surroundings.
    beside = (np.add.reduce(light) - height).mean(axis=0) / np.float32(max(len(light) - 1, 1))
    is_uneven = bool(np.abs(beside).max() > EVEN_AMBIENT_CHANGE * float(np.iinfo(on.dtype).max))
    if is_uneven:
        # A change of brightness is no noise, and differs from channel to channel.
        changes = upper_medians(light.reshape(-1, light.shape[2]).T)
        light, height = light - changes, height - changes
    # Mean absolute value instead of a robust sigma: the stripe is a small share of a column and raises it alike.
    noise = np.add.reduce(np.abs(light)) / np.float32(len(light))
    channel = int(np.add.reduce(height - NOISE_DEVIATIONS * noise).argmax())
    change = float(changes[channel]) + upper_median(light[:, :, channel])
    tops = seen[:, :, channel].max(axis=0)[height[:, channel] > PEAK_DEVIATIONS * noise[:, channel]]
    clipped = np.count_nonzero(tops >= clipped_from(on.dtype))
    is_swapped = _is_swapped(-light.min(axis=0), height, noise)
    is_core_clipped = bool(clipped > FUSE_FROM_CLIPPED * max(tops.size, 1))
    return Judgement(channel, is_swapped, change, off is not None and is_uneven, is_core_clipped)


def _judged(frame: Image, interval: int) -> Float32:
    """Judged pixels (rows, columns, channels)."""
    some = frame[::JUDGED_ROWS, ::interval]
    return some.astype(np.float32).reshape(*some.shape[:2], -1)


def _is_swapped(depth: Float32, height: Float32, noise: Float32) -> bool:
    """Test that the deepest dips exceed twice the highest peaks, and most columns (columns, channels) have one."""
    if depth.max() <= 2 * height.max():
        return False
    channel = int(np.argmax(depth.mean(axis=0)))
    return bool(np.median(depth[:, channel] - PEAK_DEVIATIONS * noise[:, channel]) > 0)


def fused_light(on: Image, off: Image | None, channel: int) -> Float32:
    """Light of all channels together, for stripes whose core clips the strongest one.

    Each channel is weighted by its headroom (the share of stripe tops at which it is not clipped) times its signal
    over its noise variance, all taken from the data, so a line of any colour works alike.

    Args:
        on: (rows, columns, 3) uint8 or uint16, laser on.
        off: the same with the laser off, or None.
        channel: channel that the laser lights most, in which the tops of the stripe are found.

    Returns:
        (rows, columns) float32, in grey levels of the strongest channel.
    """
    full_scale = float(np.iinfo(on.dtype).max)
    on = np.ascontiguousarray(on)
    off = opening(on) if off is None else off
    sample = np.ascontiguousarray(np.subtract(sampled(on), sampled(off), dtype=np.float32).reshape(-1, 3).T)
    offsets = upper_medians(sample).astype(np.float64)
    noise = SIGMA_PER_DEVIATION * upper_medians(np.abs(sample - offsets[:, None].astype(np.float32)))
    noise = np.maximum(noise.astype(np.float64), full_scale / 512)
    some = np.subtract(on[:, ::TOP_COLUMNS], off[:, ::TOP_COLUMNS], dtype=np.float32)
    smooth = cv2.GaussianBlur(np.ascontiguousarray(some[:, :, channel]), (1, 5), 0)
    shown = np.flatnonzero(smooth.max(axis=0) > TOP_SIGMAS * noise[channel])
    shown = shown if shown.size else np.arange(smooth.shape[1])
    top = smooth.argmax(axis=0)[shown]
    headroom = np.maximum(1 - is_clipped(on[top, TOP_COLUMNS * shown]).mean(axis=0), LEAST_HEADROOM)
    gains = np.maximum(upper_medians(some[top, shown].T) - offsets - noise, 0.0)
    weights = headroom**2 * gains / noise**2
    shares = weights * (gains.max() / max(float(weights @ gains), 1e-12))
    mixture = np.append(shares, -float(shares @ offsets)).astype(np.float32)[None]
    fused = np.empty(on.shape[:2], np.float32)
    for first in range(0, len(on), MIXED_ROWS):
        rows = slice(first, first + MIXED_ROWS)
        fused[rows] = cv2.transform(cv2.subtract(on[rows], off[rows], dtype=cv2.CV_32F), mixture)
    return fused


def difference(bright: Image, background: Image | None) -> Array:
    """One channel minus background, not saturating: negative values carry the noise."""
    background = opening(bright) if background is None else background
    return np.subtract(bright, background, dtype=np.int16 if bright.dtype == np.uint8 else np.float32)


def opening(picture: Image) -> Image:
    """Vertical grey opening: the picture without anything as narrow as a stripe."""
    kernel = np.ones((2 * BACKGROUND_HALF_HEIGHT_PX + 1, 1), np.uint8)
    return np.asarray(cv2.morphologyEx(picture, cv2.MORPH_OPEN, kernel))


def clipped_columns(on: Image, top: Index, sigma: float, channel: int, *, is_fused: bool) -> tuple[Mask, Mask]:
    """Columns whose core is clipped in one channel, and those whose core is lost.

    Args:
        on: (rows, columns[, channels]) laser on.
        top: (columns,) rows of the stripe.
        sigma: width of the stripe [px].
        channel: channel that the laser lights most.
        is_fused: whether light of all channels was used: then the core is lost only where all are clipped.
    """
    reach = int(REACH_SIGMAS * sigma)
    first, count = top - reach, 2 * reach + 1
    columns = np.arange(top.size)
    clipped = is_clipped(rows_from(on, first, count, columns, channel)).sum(axis=0)
    is_lost = clipped > MAX_CLIPPED_SIGMAS * sigma
    if is_fused and is_lost.any():
        wide = np.flatnonzero(is_lost)
        every = [is_clipped(rows_from(on, first[wide], count, wide, i)) for i in range(on.shape[2])]
        is_lost[wide] = np.logical_and.reduce(every).sum(axis=0) > MAX_CLIPPED_SIGMAS * sigma
    return clipped > 0, is_lost
