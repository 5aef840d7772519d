"""Seeks a stripe that its highest peaks do not tell: detection in any light, then measurement about its path."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from guara_perception.stripes.band import Band
from guara_perception.stripes.centre import noise_gain, responses, stripe_sigma
from guara_perception.stripes.channels import channel_of
from guara_perception.stripes.clipped import clipped_columns
from guara_perception.stripes.detect import Detection, detect
from guara_perception.stripes.filters import (
    COLUMN_MEAN_PX,
    ROW_MEAN_PX,
    ROW_SMOOTHING_SIGMA_PX,
    smooth_light,
    smooth_wide,
    sums_of_columns,
)
from guara_perception.stripes.find_peaks import LEAST_NOISE, WIDE_SIGMA_PX
from guara_perception.stripes.middle import spread
from guara_perception.stripes.signal import opening
from guara_perception.stripes.sought import BESIDE_SIGMAS, LEAST_BESIDE_PX, SoughtStripe, sigma_of_filter
from guara_perception.stripes.windows import SAMPLE_COLUMNS, SAMPLE_ROWS, at_rows

Float32 = npt.NDArray[np.float32]
Index = npt.NDArray[np.intp]
Mask = npt.NDArray[np.bool_]

# The width of a stripe is taken from every so many columns.
WIDTH_COLUMNS = 8
# The peak is sought so many sigmas of its ridge, of the whole stripe where that is wide, from the path.
REACH_SIGMAS, LEAST_REACH_PX = 1.5, 2


def seek_any_light(band: Band, weak_row: Index | None = None, is_weak: Mask | None = None) -> SoughtStripe:
    """Seek the stripe that runs across the columns of a band, with or without a picture with the laser off.

    Args:
        band: rows to look in.
        weak_row, is_weak: (columns,) row of a peak that may be a stripe, and whether there is one: where no stripe is
            found these are doubtful returns.
    """
    off = None if band.off is None else band.off.frame
    found = detect(band.on, off)
    if weak_row is not None and is_weak is not None:
        found = replace(found, row=np.where(found.is_path, found.row, weak_row), is_path=found.is_path | is_weak)
    scale = np.float32(np.iinfo(band.on.dtype).max / 255)
    n = found.row.size
    columns = np.arange(n)
    top, height, sigma = found.row.copy(), np.zeros(n, np.float32), 1.0
    every_response: Float32 | None = None
    noise = 0.0
    for part, light in _lights(found):
        light = (light - opening(light)) * scale
        smooth = smooth_light(light)
        rows, width = _peaks(light, smooth, found, part)
        top = np.where(part, rows, top)
        height = np.where(part, smooth[rows, columns], height)
        response = responses(smooth, rows, columns, sigma_of_filter(width))
        every_response = response if every_response is None else _of_part(every_response, response, part)
        sums = sums_of_columns(light, SAMPLE_ROWS, SAMPLE_COLUMNS)
        own_noise = max(spread(sums) if sums.size else 0.0, LEAST_NOISE * COLUMN_MEAN_PX)
        noise = max(noise, own_noise * noise_gain(sigma_of_filter(width), ROW_MEAN_PX))
        sigma = max(sigma, width)
    assert every_response is not None
    is_clipped, is_lost = clipped_columns(band.on, top, sigma, found.channel, is_fused=band.on.ndim == 3)
    beside_px = max(round(BESIDE_SIGMAS * sigma), LEAST_BESIDE_PX)
    above = below = np.zeros(n, np.uint8)
    if off is not None:
        plane = channel_of(off, found.channel)
        above, below = (at_rows(plane, top + side, columns) for side in (-beside_px, beside_px))
    return SoughtStripe(
        top=top,
        height=np.where(found.is_path, np.maximum(height, np.float32(1e-3)), 0).astype(np.float32),
        is_peak=found.is_path,
        is_clipped=is_clipped & found.is_path,
        is_unsure=~found.is_stripe | is_lost,
        responses=every_response,
        above=above,
        below=below,
        beside_px=beside_px,
        sigma=sigma,
        noise=noise,
        rows=len(found.plane),
        first_row=band.first_row,
    )


def _lights(found: Detection) -> list[tuple[Mask, Float32]]:
    """Parts of the stripe (columns,) and the light (rows, columns) in which each is measured.

    The laser's own colour shows the stripe with the least of the scene; where that is clipped, all channels together.
    """
    everywhere = np.ones(found.row.size, dtype=bool)
    if not found.is_core.any():
        return [(everywhere, found.plane)]
    return [(everywhere, found.plane), (found.is_core, found.light.sum(axis=2))]


def _of_part(before: Float32, now: Float32, part: Mask) -> Float32:
    return np.where(part[None], now, before)


def _peaks(light: Float32, smooth: Float32, found: Detection, part: Mask) -> tuple[Index, float]:
    """Row of the peak next to the path in each column, and the width of the stripe [px]."""
    use = np.flatnonzero(part & found.is_stripe)
    if not use.size:
        return found.row, 1.0
    rows = _highest_near(smooth, found.row, float(np.percentile(found.sigma[use], 75)))
    some = use[:: min(WIDTH_COLUMNS, max(use.size // WIDTH_COLUMNS, 1))]
    sigma = round(stripe_sigma(smooth, rows[some], some, smooth[rows[some], some], ROW_SMOOTHING_SIGMA_PX), 1)
    if sigma > WIDE_SIGMA_PX:
        rows = _highest_near(smooth_wide(light, sigma), rows, sigma)
    return rows, sigma


def _highest_near(light: Float32, rows: Index, sigma: float) -> Index:
    """Row of the highest value within some sigmas [px] of given rows (columns,)."""
    reach = max(int(np.ceil(REACH_SIGMAS * sigma)), LEAST_REACH_PX)
    around = np.clip(rows + np.arange(-reach, reach + 1)[:, None], 0, len(light) - 1)
    columns = np.arange(rows.size)
    return np.asarray(around[light[around, columns].argmax(axis=0), columns])
