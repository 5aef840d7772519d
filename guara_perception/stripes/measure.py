"""Measurement of detected stripes: sub-pixel centre and sigma in every column, or the reason for none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from guara_perception.arrays import Array, Float32, Image, Index, Mask
from guara_perception.stripes.band import StripeProfile, StripeStatus, at_rows, nothing
from guara_perception.stripes.peaks import ROW_SMOOTHING_SIGMA_PX, SCALE, centres

OK, SATURATED, DROPOUT = (
    np.uint8(status) for status in (StripeStatus.OK, StripeStatus.SATURATED, StripeStatus.DROPOUT)
)
NAN = np.float32(np.nan)
# A peak in the first or last rows of the band may be the flank of a stripe outside of it.
EDGE_ROWS = 2
# Standard deviation of the centre due to speckle, as a share of the stripe's sigma; independent of the light.
SPECKLE_OF_SIGMA = 0.06
# Uncertainty due to a brightness gradient across the stripe, as a share of the first-order shift of its centre.
ALBEDO_SHARE = 0.5
# Distance above and below the stripe at which the brightness is sampled, in sigmas and at least in pixels.
BESIDE_SIGMAS, LEAST_BESIDE_PX = 1.5, 2
# Columns averaged on each side, in symmetric pairs, so that a straight line is not changed.
REACH_COLUMNS = 3
# Steepest slope of a line; a steeper one is a jump, which is not smoothed.
STEEPEST_PX_PER_COLUMN = 0.5


@dataclass(frozen=True, slots=True)
class DetectedStripe:
    """A detected stripe, column by column, before its centre is measured.

    Attributes:
        top: (columns,) row of the stripe's peak within the band.
        height: (columns,) float32 light at the peak, times SCALE.
        is_peak: (columns,) whether the height is above the detection threshold.
        is_clipped: (columns,) whether the stripe's core is clipped.
        is_unsure: (columns,) whether another peak is as good, or nothing is left of a clipped core.
        responses: (shifts, columns) responses of the derivative filters about the top.
        background: (rows, columns[, channels]) laser-off picture; None if there is none or it cannot be used.
        channel: the channel of `background` that the laser lights most.
        sigma: width of the stripe [px].
        noise: standard deviation of a response; divided by the slope of the response, that of the row.
        rows: number of rows of the band.
        first_row: first row of the band in the full picture.
        remark: reason why the laser-off picture was not used; empty if it was used or there was none.
    """

    top: Index
    height: Float32
    is_peak: Mask
    is_clipped: Mask
    is_unsure: Mask
    responses: Float32
    background: Image | None
    channel: int
    sigma: float
    noise: float
    rows: int
    first_row: int
    remark: str = ""


def sigma_of_filter(sigma: float) -> float:
    """Width of the filter that finds the centre of a stripe of this width in smoothed light [px].

    For a thin stripe it is wider than the stripe, because of speckle; for a wide one (clipped or in a halo) it is
    narrower, because the core is the most accurate part. The smoothing already applied to the light is subtracted.
    """
    return round(float(np.sqrt((0.85 * sigma) ** 2 + 1.3**2 - ROW_SMOOTHING_SIGMA_PX**2)), 1)


def measure(stripes: Sequence[DetectedStripe]) -> list[StripeProfile]:
    """Measure the profiles of stripes with the same number of columns; the arrays inside are (stripes, columns)."""
    top, height, is_peak = (_stacked(stripes, name) for name in ("top", "height", "is_peak"))
    sigma, noise, first_row, rows = (
        np.array([getattr(stripe, name) for stripe in stripes], np.float32)[:, None]
        for name in ("sigma", "noise", "first_row", "rows")
    )
    from_top, slope = centres(_stacked(stripes, "responses"))
    row = np.where(is_peak, top.astype(np.float32) + from_top, NAN)
    is_found = np.isfinite(row)
    status = np.where(is_found, np.where(_stacked(stripes, "is_clipped"), SATURATED, OK), DROPOUT)
    status[is_peak & (~is_found | _stacked(stripes, "is_unsure"))] = StripeStatus.AMBIGUOUS
    status[is_peak & ((top < EDGE_ROWS) | (top >= rows - EDGE_ROWS))] = StripeStatus.OUT_OF_BAND
    usable = (status == OK) | (status == SATURATED)
    row, shrink = smooth_line(row, height)
    row += first_row
    variance = (noise * shrink / slope) ** 2 + (SPECKLE_OF_SIGMA * sigma) ** 2 * shrink
    variance += _albedo_shift(stripes, sigma) ** 2
    is_doubtful = is_peak & ~usable
    # A doubtful return without a centre is located by the row of its peak.
    seen = np.where(is_found, row, top + first_row)
    has_doubtful = is_doubtful.any(axis=1).tolist()
    position, deviation = np.where(usable, row, NAN), np.where(usable, np.sqrt(variance), NAN)
    peak = height / np.float32(SCALE)
    for array in (position, deviation, status, peak):
        # Read-only arrays are not copied by the profiles.
        array.setflags(write=False)
    return [
        StripeProfile(
            position_px=position[i],
            sigma_px=deviation[i],
            status=status[i],
            peak=peak[i],
            doubtful_px=np.where(is_doubtful[i], seen[i], NAN) if has_doubtful[i] else nothing(top.shape[1]),
            remark=stripes[i].remark,
        )
        for i in range(len(stripes))
    ]


def _albedo_shift(stripes: Sequence[DetectedStripe], sigma: Float32) -> Float32:
    """Shift of the centre that the brightness gradient of the surface may have caused [px].

    Reflectance that changes by a factor exp(g) per row shifts a Gaussian stripe by g sigma^2 rows. The laser-off
    picture shows the reflectance under ambient light, noise included, so only a share of it counts.
    """
    columns, beside_px = np.arange(stripes[0].top.size), np.maximum(np.round(BESIDE_SIGMAS * sigma), LEAST_BESIDE_PX)
    above, below = np.zeros((2, len(stripes), columns.size), np.float32)
    for i, (stripe, distance) in enumerate(zip(stripes, beside_px[:, 0].astype(int).tolist(), strict=True)):
        if stripe.background is not None:
            above[i] = at_rows(stripe.background, stripe.top - distance, columns, stripe.channel)
            below[i] = at_rows(stripe.background, stripe.top + distance, columns, stripe.channel)
    pull = ALBEDO_SHARE * sigma**2 / beside_px
    return np.asarray(pull * (below - above) / np.maximum(above + below, np.float32(1)))


def _stacked(stripes: Sequence[DetectedStripe], name: str) -> Array:
    """Array (..., stripes, columns) of one attribute of all stripes; not copied for a single stripe."""
    arrays = [getattr(stripe, name) for stripe in stripes]
    return arrays[0][..., None, :] if len(arrays) == 1 else np.stack(arrays, axis=-2)


def smooth_line(position: Float32, weight: Float32) -> tuple[Float32, Float32]:
    """Smooth the positions of a stripe along its columns: speckle is independent between columns, the surface is not.

    Neighbours count in pairs, one from each side with the same weight, so a straight line is not changed. Nothing is
    averaged across a gap or a jump.

    Args:
        position: (..., n) rows of each of n columns, NaN where there is no stripe.
        weight: (..., n) weight of each position, for instance the square of the peak.

    Returns:
        (..., n) smoothed positions, NaN where they were NaN, and (..., n) factors by which independent noise shrinks.
    """
    known = np.isfinite(position)
    weights, values = _shifted(np.where(known, weight, 0)), _shifted(np.where(known, position, 0))
    left, right = np.s_[REACH_COLUMNS - 1 :: -1], np.s_[REACH_COLUMNS + 1 :]
    here, own = values[REACH_COLUMNS], weights[REACH_COLUMNS]
    reach = np.arange(1, REACH_COLUMNS + 1, dtype=np.float32)[:, None]
    farthest = np.maximum(np.abs(values[left] - here), np.abs(values[right] - here))
    pair = np.minimum(weights[left], weights[right])
    allowed = (farthest < STEEPEST_PX_PER_COLUMN * reach) & (pair > 0) & (own > 0)
    for near, far in pairwise(allowed):
        far &= near
    pair *= allowed
    sum_of_weights = own + 2 * pair.sum(axis=0)
    sum_of_squares = own**2 + 2 * (pair**2).sum(axis=0)
    total = own * here + (pair * (values[left] + values[right])).sum(axis=0)
    divisor = np.where(sum_of_weights > 0, sum_of_weights, np.float32(1))
    smooth, shrink = _lines(total / divisor, position.shape), _lines(np.sqrt(sum_of_squares) / divisor, position.shape)
    return np.where(known, smooth, np.float32(np.nan)), shrink


def _shifted(lines: npt.NDArray[np.floating]) -> Float32:
    """View (2 * REACH_COLUMNS + 1, m) of the lines shifted by REACH_COLUMNS to -REACH_COLUMNS columns.

    The lines are concatenated with 2 * REACH_COLUMNS empty columns in between, across which nothing is averaged.
    """
    n = lines.shape[-1]
    length = lines.size // n * (n + 2 * REACH_COLUMNS)
    padded = np.zeros(length + 2 * REACH_COLUMNS, np.float32)
    _lines(padded[REACH_COLUMNS : length + REACH_COLUMNS], lines.shape)[...] = lines
    return np.ndarray((2 * REACH_COLUMNS + 1, length), np.float32, padded, strides=2 * padded.strides)


def _lines(row: Float32, shape: tuple[int, ...]) -> Float32:
    """View (..., n) of the lines that are concatenated in a row."""
    return row.reshape(*shape[:-1], -1)[..., : shape[-1]]
