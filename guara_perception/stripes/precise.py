"""The `precise` method: highest peak of each column; doubtful bands go to the detector for any light."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from guara_perception.arrays import Float, Float32, Index, Mask
from guara_perception.stripes.any_light.detect_stripe import detect_in_any_light
from guara_perception.stripes.band import Band, StripeProfile, bad_frame
from guara_perception.stripes.laser_light import clipped_columns, laser_light
from guara_perception.stripes.measure import DetectedStripe, measure, sigma_of_filter
from guara_perception.stripes.peaks import (
    COLUMN_MEAN_PX,
    ROW_MEAN_PX,
    THRESHOLD_SIGMAS,
    FoundPeaks,
    candidates,
    find_peaks,
    noise_gain,
    responses,
    upper_median,
)

# The highest peaks are trusted if their median height exceeds this many sigmas of the noise, at most MOST_JUMPS of them
# jump by more than JUMP_PX rows to the next column, and at most MOST_RIVALS of them have a rival.
CLEAR_SIGMAS = 15.0
JUMP_PX, MOST_JUMPS, MOST_RIVALS = 4, 0.05, 0.2
# Noise above this is not the sensor's: the two frames do not match, and may hide a stripe [grey levels].
MOST_NOISE = 4.0
# The same for a laser-off picture of another exposure, where the difference is known to contain some of the scene.
MOST_UNEVEN_NOISE = 2.5
# Peaks in a smaller share of the columns are chance: the band holds no stripe, which leaves no doubt.
LEAST_COLUMNS = 0.05
# Height of a second peak, as a share of the highest, from which it is a rival.
RIVAL_OF_PEAK = 0.35
# Columns without a rival that are added on both sides of a run of columns with one.
CONTEXT_COLUMNS = 6
# Longest run of columns with two peaks that is a jump of the stripe.
EDGE_COLUMNS = 4
# A choice is ambiguous if the cost of the next best exceeds its own by less than this.
LEAST_MARGIN = 1.5
# Peaks of one column closer than this, in sigmas of the stripe and at least in pixels, are one peak.
APART_SIGMAS = 3.0
APART_PX = 5
# Factor of log(highest / own height) in the cost of a peak, with the highest candidate of its column.
WEAKNESS_COST = 2.0
# Row difference between neighbouring columns that costs 1; a jump (an edge) costs at most JUMP_COST.
ROWS_PER_COST = 2.0
JUMP_COST = 4.0
# Cost of choosing no peak in a column, and of entering or leaving that state.
DROPOUT_COST = 3.0
GAP_COST = 1.0


def extract_precise(bands: Sequence[Band]) -> list[StripeProfile]:
    """Find the stripe in each band.

    Bands are independent of each other.

    Args:
        bands: one band per stripe, all of the same width.

    Returns:
        Profile of each band: one position per column, in rows of the full picture.
    """
    return [_extract(band) for band in bands]


def _extract(band: Band) -> StripeProfile:
    """Profile of one band."""
    stripe = detect(band)
    return bad_frame(band.on.shape[1], stripe) if isinstance(stripe, str) else measure(stripe)


def detect(band: Band) -> DetectedStripe | str:
    """Detect the stripe of a band, row by column; returns the reason as text if its frames cannot be used."""
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
    top, height, is_unsure = choose_peaks(found)
    is_clipped = np.zeros(top.size, dtype=bool)
    if signal.is_clipped:
        is_clipped, is_lost = clipped_columns(signal.frame, top, sigma, signal.channel, is_fused=signal.is_fused)
        is_unsure = is_unsure | is_lost
    width = sigma_of_filter(sigma)
    return DetectedStripe(
        top=top,
        height=height,
        is_peak=height > found.threshold,
        is_clipped=is_clipped,
        is_unsure=is_unsure,
        responses=responses(found.smooth, top, np.arange(top.size), width),
        background=signal.background,
        channel=signal.channel,
        sigma=sigma,
        noise=found.noise * noise_gain(width, ROW_MEAN_PX),
        rows=len(signal.light),
        first_row=band.first_row,
    )


def is_doubtful(found: FoundPeaks, is_uneven: bool = False) -> bool:
    """Test for doubt that the highest peaks of a band are its stripe.

    Args:
        found: the peaks.
        is_uneven: whether the laser-off picture had another exposure; the scene left in the difference counts as noise.
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


def choose_peaks(found: FoundPeaks) -> tuple[Index, Float32, Mask]:
    """Choose the highest peak where it has no rival; elsewhere follow the stripe from column to column.

    Returns:
        (columns,) row and height of the stripe's peak, and a mask of the columns in which another choice would have
        been as good.
    """
    peaks, threshold = found.peaks, found.threshold
    top, height = peaks.top.copy(), peaks.height.copy()
    ambiguous = np.zeros(top.size, dtype=bool)
    rival = (peaks.second > RIVAL_OF_PEAK * height) & (peaks.second > threshold) & (height > threshold)
    if not rival.any():
        return top, height, ambiguous
    distance = max(int(np.ceil(APART_SIGMAS * found.sigma)), APART_PX)
    for begin, end in _runs(rival):
        if end - begin <= EDGE_COLUMNS:
            # At a jump the mean over columns mixes the light of both sides: neither peak is right.
            ambiguous[begin:end] = rival[begin:end]
            continue
        columns = np.arange(max(begin - CONTEXT_COLUMNS, 0), min(end + CONTEXT_COLUMNS, top.size))
        rows, heights = candidates(found.searched, columns, threshold, distance)
        heights[heights < RIVAL_OF_PEAK * heights.max(axis=0)] = 0
        chosen, margin = follow_candidates(rows, heights)
        every = np.arange(columns.size)
        use = chosen >= 0
        top[columns[use]] = rows[chosen[use], every[use]]
        height[columns[use]] = heights[chosen[use], every[use]]
        several = (heights > 0).sum(axis=0) > 1
        ambiguous[columns] |= several & (~use | (margin < LEAST_MARGIN))
    return top, height, ambiguous


def _runs(mask: Mask) -> list[tuple[int, int]]:
    """First and end column of the runs of True; runs whose contexts overlap are joined."""
    indices = np.flatnonzero(mask)
    breaks = np.flatnonzero(np.diff(indices) > 2 * CONTEXT_COLUMNS)
    first = indices[np.append(0, breaks + 1)]
    last = indices[np.append(breaks, indices.size - 1)]
    return [(int(a), int(b) + 1) for a, b in zip(first, last, strict=True)]


def follow_candidates(rows: Index, heights: Float32) -> tuple[Index, Float]:
    """Choose one peak, or none, in each of a run of neighbouring columns: dynamic programming with explicit dropout.

    Args:
        rows: (k, n) rows of the candidates of each column.
        heights: (k, n) their heights, 0 where a column has fewer than k.

    Returns:
        choice (n,): index of the chosen candidate, -1 for none; margin (n,): cost of the cheapest path with another
        choice in this column, minus the cost of the best path.
    """
    k, n = rows.shape
    strongest = np.maximum(heights.max(axis=0), 1e-6)
    own = np.full((k + 1, n), np.inf)
    with np.errstate(divide="ignore"):
        own[:k] = np.where(heights > 0, -WEAKNESS_COST * np.log(heights / strongest), np.inf)
    own[k] = DROPOUT_COST
    moves = _transition_costs(rows)
    forward = own.copy()
    for i in range(1, n):
        forward[:, i] += (forward[:, i - 1, None] + moves[i - 1]).min(axis=0)
    backward = np.zeros((k + 1, n))
    for i in range(n - 2, -1, -1):
        backward[:, i] = (moves[i] + (own[:, i + 1] + backward[:, i + 1])).min(axis=1)
    total = forward + backward
    best = total.argmin(axis=0)
    ordered = np.sort(total, axis=0)
    margin = np.where(np.isfinite(ordered[1]), ordered[1] - ordered[0], np.inf)
    return np.where(best == k, -1, best), margin


def _transition_costs(rows: Index) -> Float:
    """Costs (n - 1, k + 1, k + 1) of the transitions between states of neighbouring columns; the last is dropout."""
    k, n = rows.shape
    cost = np.full((n - 1, k + 1, k + 1), GAP_COST)
    before, after = rows.T[:-1, :, None], rows.T[1:, None, :]
    cost[:, :k, :k] = np.minimum(np.abs(before - after) / ROWS_PER_COST, JUMP_COST)
    cost[:, k, k] = 0.0
    return cost
