"""Detects a stripe that its highest peaks do not show: its path in any light, then its peaks about that path."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from guara_perception.arrays import Float32, Index, Mask
from guara_perception.stripes.any_light.stripe_path import StripePath, find_path
from guara_perception.stripes.band import Band
from guara_perception.stripes.laser_light import clipped_columns, opening
from guara_perception.stripes.measure import (
    ROW_MEAN_PX,
    ROW_SMOOTHING_SIGMA_PX,
    SHIFTS,
    DetectedStripe,
    noise_gain,
    responses,
    sigma_of_filter,
)
from guara_perception.stripes.peaks import WIDE_SIGMA_PX, noise_of_columns, smooth_light, smooth_wide, stripe_sigma

# Distance of the columns in which the stripe's width is measured.
WIDTH_COLUMNS = 8
# How far from the path a peak may be, in sigmas of its ridge, or of the whole stripe where that is wide, and [px].
REACH_SIGMAS, LEAST_REACH_PX = 1.5, 2


def detect_in_any_light(band: Band, weak_row: Index | None = None, is_weak: Mask | None = None) -> DetectedStripe:
    """Detect the stripe that runs across the columns of a band, with or without a picture with the laser off.

    Args:
        band: rows that can hold the stripe.
        weak_row, is_weak: (columns,) row of a peak that may be a stripe, and whether there is one: where no stripe is
            found these are doubtful returns.
    """
    off = band.off
    path = find_path(band.on, off)
    if weak_row is not None and is_weak is not None:
        path = replace(path, row=np.where(path.is_path, path.row, weak_row), is_path=path.is_path | is_weak)
    scale = np.float32(np.iinfo(band.on.dtype).max / 255)
    n = path.row.size
    columns = np.arange(n)
    top, height, sigma = path.row.copy(), np.zeros(n, np.float32), 1.0
    every_response, noise = np.zeros((SHIFTS, n), np.float32), 0.0
    for where, light in _lights(path):
        light = (light - opening(light)) * scale
        smooth = smooth_light(light)
        rows, width = _peaks(light, smooth, path, where)
        top = np.where(where, rows, top)
        height = np.where(where, smooth[rows, columns], height)
        response = responses(smooth, rows, sigma_of_filter(width))
        every_response = np.where(where, response, every_response)
        noise = max(noise, noise_of_columns(light) * noise_gain(sigma_of_filter(width), ROW_MEAN_PX))
        sigma = max(sigma, width)
    is_clipped, is_lost = clipped_columns(band.on, top, sigma, path.channel, is_fused=band.on.ndim == 3)
    return DetectedStripe(
        top=top,
        height=np.where(path.is_path, np.maximum(height, np.float32(1e-3)), 0).astype(np.float32),
        is_peak=path.is_path,
        is_clipped=is_clipped & path.is_path,
        is_unsure=~path.is_stripe | is_lost,
        responses=every_response,
        background=None if path.remark else off,
        channel=path.channel,
        sigma=sigma,
        noise=noise,
        rows=len(path.laser),
        first_row=band.first_row,
        remark=path.remark,
    )


def _lights(path: StripePath) -> list[tuple[Mask, Float32]]:
    """Columns of the stripe, and the light (rows, columns) in which these are measured; later entries replace earlier.

    The laser's own colour shows the stripe with the least of the scene; where that is clipped, all channels together.
    """
    everywhere = np.ones(path.row.size, dtype=bool)
    if not path.is_core.any():
        return [(everywhere, path.laser)]
    every_channel = cv2.transform(path.light, np.ones((1, path.light.shape[2]), np.float32))
    return [(everywhere, path.laser), (path.is_core, np.asarray(every_channel, np.float32).reshape(path.laser.shape))]


def _peaks(light: Float32, smooth: Float32, path: StripePath, where: Mask) -> tuple[Index, float]:
    """Row of the peak next to the path in each column, and the width of the stripe [px]."""
    use = np.flatnonzero(where & path.is_stripe)
    if not use.size:
        return path.row, 1.0
    rows = _highest_near(smooth, path.row, float(np.percentile(path.sigma[use], 75)))
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
