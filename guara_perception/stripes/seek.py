"""Seeks one stripe in a band: which peak of each column it is, and what tells of its exact place there."""

from __future__ import annotations

import numpy as np

from guara_perception.stripes.band import Band
from guara_perception.stripes.centre import noise_gain, responses
from guara_perception.stripes.choose import RIVAL_OF_PEAK, choose_peaks
from guara_perception.stripes.clipped import clipped_columns
from guara_perception.stripes.filters import COLUMN_MEAN_PX, ROW_MEAN_PX
from guara_perception.stripes.find_peaks import THRESHOLD_SIGMAS, FoundPeaks, find_peaks
from guara_perception.stripes.middle import middle
from guara_perception.stripes.seek_any_light import seek_any_light
from guara_perception.stripes.signal import laser_light
from guara_perception.stripes.sought import BESIDE_SIGMAS, LEAST_BESIDE_PX, SoughtStripe, sigma_of_filter
from guara_perception.stripes.windows import at_rows

# The highest peaks tell the stripe where most of them stand this far above the noise, few jump by more than so many
# rows from one column to the next, and few have a rival.
CLEAR_SIGMAS = 15.0
# Noise of more grey levels than this is not the sensor's: the pair does not fit, and may hide a stripe.
MOST_NOISE = 4.0
# Peaks in fewer columns than this share are chance: a band without its stripe is not doubtful.
LEAST_COLUMNS = 0.05
JUMP_PX, MOST_JUMPS, MOST_RIVALS = 4, 0.05, 0.2


def seek(band: Band) -> SoughtStripe | str:
    """Seek a stripe that runs across the columns of a band; a text says why the pair of frames cannot be used."""
    if band.off is None:
        return seek_any_light(band)
    signal = laser_light(band.on, band.off)
    if signal.reason:
        return signal.reason
    found = find_peaks(signal.light)
    if is_doubtful(found):
        return seek_any_light(band, found.peaks.top, found.peaks.height > found.threshold)
    sigma = found.sigma
    choice = choose_peaks(found.sought, found.peaks, found.threshold, sigma)
    columns = np.arange(choice.top.size)
    is_clipped, is_unsure = np.zeros(columns.size, dtype=bool), choice.is_ambiguous
    if signal.is_clipped:
        is_clipped, is_lost = clipped_columns(signal.frame, choice.top, sigma, signal.channel, is_fused=signal.is_fused)
        is_unsure = is_unsure | is_lost
    beside_px = max(int(round(BESIDE_SIGMAS * sigma)), LEAST_BESIDE_PX)
    above = below = np.zeros(columns.size, np.uint8)
    if signal.background is not None:
        above = at_rows(signal.background, choice.top - beside_px, columns, signal.channel)
        below = at_rows(signal.background, choice.top + beside_px, columns, signal.channel)
    width = sigma_of_filter(sigma)
    return SoughtStripe(
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


def is_doubtful(found: FoundPeaks) -> bool:
    """Whether the highest peaks of a band may not be its stripe."""
    is_peak = found.peaks.height > found.threshold
    count = int(np.count_nonzero(is_peak))
    if count < LEAST_COLUMNS * is_peak.size:
        return found.noise > MOST_NOISE * COLUMN_MEAN_PX
    height = found.peaks.height[is_peak]
    if middle(height) < CLEAR_SIGMAS / THRESHOLD_SIGMAS * found.threshold:
        return True
    jumps = (np.abs(np.diff(found.peaks.top)) > JUMP_PX) & is_peak[1:] & is_peak[:-1]
    second = found.peaks.second[is_peak]
    rivals = (second > found.threshold) & (second > RIVAL_OF_PEAK * height)
    return bool(np.count_nonzero(jumps) > MOST_JUMPS * count or np.count_nonzero(rivals) > MOST_RIVALS * count)
