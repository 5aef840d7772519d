"""The `precise` method: detects the stripe of a band by its highest peaks, in any light where they are in doubt."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from guara_perception.stripes.any_light.detect_stripe import detect_in_any_light
from guara_perception.stripes.band import Band, at_rows
from guara_perception.stripes.centre import noise_gain, responses
from guara_perception.stripes.choose import RIVAL_OF_PEAK, choose_peaks
from guara_perception.stripes.laser_light import clipped_columns, laser_light
from guara_perception.stripes.measure import DetectedStripe, distance_beside, measure, sigma_of_filter
from guara_perception.stripes.median import upper_median
from guara_perception.stripes.peaks import COLUMN_MEAN_PX, ROW_MEAN_PX, THRESHOLD_SIGMAS, FoundPeaks, find_peaks
from guara_perception.stripes.profile import StripeProfile, bad_frame

# The highest peaks show the stripe where most of them stand this far above the noise, few jump by more than JUMP_PX
# rows from one column to the next, and few have a rival.
CLEAR_SIGMAS = 15.0
JUMP_PX, MOST_JUMPS, MOST_RIVALS = 4, 0.05, 0.2
# Noise of more grey levels than this is not the sensor's: the pair does not fit, and may hide a stripe.
MOST_NOISE = 4.0
# The same where the laser-off picture was exposed otherwise and the scene is known to be left in the difference.
MOST_UNEVEN_NOISE = 2.5
# Peaks in fewer columns than this share are chance: a band without its stripe is not doubtful.
LEAST_COLUMNS = 0.05


def extract_precise(bands: Sequence[Band]) -> list[StripeProfile]:
    """Find the stripes of some bands, which run across their columns.

    Each by itself; several at once only share the fixed cost of numpy's calls.

    Args:
        bands: one for each stripe, all of one width.

    Returns:
        For each band one position per column in full-picture rows.
    """
    detected = [detect(band) for band in bands]
    stripes = [stripe for stripe in detected if not isinstance(stripe, str)]
    measured = iter(measure(stripes) if stripes else [])
    return [
        bad_frame(band.on.shape[1], stripe) if isinstance(stripe, str) else next(measured)
        for band, stripe in zip(bands, detected, strict=True)
    ]


def detect(band: Band) -> DetectedStripe | str:
    """Detect a stripe that runs across the columns of a band; a text says why the pair of frames cannot be used."""
    if band.off is None:
        return detect_in_any_light(band)
    signal = laser_light(band.on, band.off)
    if signal.reason:
        return signal.reason
    if signal.unlike:
        return replace(detect_in_any_light(replace(band, off=None)), remark=signal.unlike)
    found = find_peaks(signal.light)
    if is_doubtful(found, signal.is_uneven):
        return detect_in_any_light(band, found.peaks.top, found.peaks.height > found.threshold)
    sigma = found.sigma
    choice = choose_peaks(found.searched, found.peaks, found.threshold, sigma)
    columns = np.arange(choice.top.size)
    is_clipped, is_unsure = np.zeros(columns.size, dtype=bool), choice.is_ambiguous
    if signal.is_clipped:
        is_clipped, is_lost = clipped_columns(signal.frame, choice.top, sigma, signal.channel, is_fused=signal.is_fused)
        is_unsure = is_unsure | is_lost
    beside_px = distance_beside(sigma)
    above = below = np.zeros(columns.size, np.uint8)
    if signal.background is not None:
        above = at_rows(signal.background, choice.top - beside_px, columns, signal.channel)
        below = at_rows(signal.background, choice.top + beside_px, columns, signal.channel)
    width = sigma_of_filter(sigma)
    return DetectedStripe(
        top=choice.top,
        height=choice.height,
        is_peak=choice.height > found.threshold,
        is_clipped=is_clipped,
        is_unsure=is_unsure,
        responses=responses(found.smooth, choice.top, columns, width),
        above=above,
        below=below,
        beside_px=beside_px,
        sigma=sigma,
        noise=found.noise * noise_gain(width, ROW_MEAN_PX),
        rows=len(signal.light),
        first_row=band.first_row,
    )


def is_doubtful(found: FoundPeaks, is_uneven: bool = False) -> bool:
    """Whether the highest peaks of a band may not be its stripe.

    Args:
        found: the peaks.
        is_uneven: whether the laser-off picture was exposed otherwise: what it leaves of the scene counts as noise.
    """
    is_peak = found.peaks.height > found.threshold
    count = int(np.count_nonzero(is_peak))
    if is_uneven and (count < LEAST_COLUMNS * is_peak.size or found.noise > MOST_UNEVEN_NOISE * COLUMN_MEAN_PX):
        return True
    if count < LEAST_COLUMNS * is_peak.size:
        return found.noise > MOST_NOISE * COLUMN_MEAN_PX
    height = found.peaks.height[is_peak]
    if upper_median(height) < CLEAR_SIGMAS / THRESHOLD_SIGMAS * found.threshold:
        return True
    jumps = (np.abs(np.diff(found.peaks.top)) > JUMP_PX) & is_peak[1:] & is_peak[:-1]
    second = found.peaks.second[is_peak]
    rivals = (second > found.threshold) & (second > RIVAL_OF_PEAK * height)
    return bool(np.count_nonzero(jumps) > MOST_JUMPS * count or np.count_nonzero(rivals) > MOST_RIVALS * count)
