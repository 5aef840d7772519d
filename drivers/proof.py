"""Proves from the pictures that laser, mirror and frame are in step: where is light, against what was commanded."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from drivers.capture import StripeEvidence, StripeVerdict
from drivers.frame import Image
from drivers.pattern import Band

_COLUMNS = 80  # sampled columns: the median row of 80 columns is good to a fraction of a pixel, in 0.2 ms
_ROWS = 512  # sampled rows: finer than half a stripe's width at any size
_MEMORY = 9  # stripes from which the usual shift per radian is taken


@dataclass(frozen=True, slots=True, kw_only=True)
class ProofLimits:
    """When a difference counts.

    Attributes:
        min_contrast: height of a lit pixel above the off frame, share of one channel's full scale.
        noise_factor: the same in standard deviations of the difference; the larger of the two holds.
        min_lit_fraction: share of columns that must be lit for the laser to count as seen.
        min_leak_fraction: share of columns brighter in the off frame for it to count as lit.
        max_offset: change of the whole frame that counts as changed light, share of the full scale.
        min_shift: share of the expected shift that a stripe must have moved.
        max_out_of_band: share of lit columns that may lie outside the band.
    """

    min_contrast: float = 0.05
    noise_factor: float = 8.0
    min_lit_fraction: float = 0.02
    min_leak_fraction: float = 0.1
    max_offset: float = 0.04
    min_shift: float = 0.3
    max_out_of_band: float = 0.5


class StepProof:
    """Judges the stripes of one scan, in the order in which they were taken."""

    def __init__(self, limits: ProofLimits | None = None) -> None:
        """Begin a scan."""
        self._limits = limits or ProofLimits()
        self._before: _Seen | None = None
        self._slopes: deque[float] = deque(maxlen=_MEMORY)

    def judge(
        self,
        mirror_angle: float,
        on: Image,
        reference: Image,
        *,
        reference_is_off: bool,
        band: Band | None = None,
    ) -> tuple[StripeVerdict, StripeEvidence]:
        """Compare the on frame of a stripe with a reference.

        Args:
            mirror_angle: as commanded [rad].
            on: frame with the laser on.
            reference: the off frame, or the on frame of the stripe before.
            reference_is_off: which of them.
            band: rows (first, end) where the stripe can be; None for anywhere.

        Returns:
            The verdict and what it rests on.
        """
        limits = self._limits
        scale = float(np.iinfo(on.dtype).max)
        channels = on.shape[2] if on.ndim == 3 else 1
        difference, row_step = _difference(on, reference)
        sample = difference[::8, ::4]
        offset = float(np.median(sample))
        noise = 1.4826 * float(np.median(np.abs(sample - offset)))
        threshold = max(limits.min_contrast * scale, limits.noise_factor * noise)
        rows = difference.argmax(axis=0)
        peaks = np.take_along_axis(difference, rows[None, :], axis=0)[0] - offset
        lit = peaks > threshold
        leak = (offset - difference.min(axis=0)) > threshold
        seen = _Seen(mirror_angle, rows * float(row_step), lit)
        shift = seen.shift_from(self._before)
        evidence = StripeEvidence(
            lit_fraction=float(lit.mean()),
            leak_fraction=float(leak.mean()) if reference_is_off else 0.0,
            contrast=float(np.median(peaks[lit])) if lit.any() else math.nan,
            offset=offset,
            noise=noise,
            row=float(np.median(seen.rows[lit])) if lit.any() else math.nan,
            row_shift=shift,
        )
        return self._verdict(seen, evidence, scale * channels, band), evidence

    def _verdict(self, seen: _Seen, evidence: StripeEvidence, full_scale: float, band: Band | None) -> StripeVerdict:
        limits = self._limits
        if evidence.leak_fraction >= limits.min_leak_fraction:
            return StripeVerdict.LEAK
        if evidence.lit_fraction < limits.min_lit_fraction:
            return StripeVerdict.DARK
        if band is not None:
            rows = seen.rows[seen.lit]
            outside = float(np.mean((rows < band[0]) | (rows >= band[1])))
            if outside > limits.max_out_of_band:
                return StripeVerdict.OUT_OF_BAND
        if not self._moved(seen, evidence.row_shift):
            return StripeVerdict.NOT_MOVED
        self._before = seen
        if abs(evidence.offset) > limits.max_offset * full_scale:
            return StripeVerdict.AMBIENT_CHANGED
        return StripeVerdict.OK

    def _moved(self, seen: _Seen, shift: float) -> bool:
        before = self._before
        if before is None or math.isnan(shift) or seen.mirror_angle == before.mirror_angle:
            return True
        turn = seen.mirror_angle - before.mirror_angle
        if len(self._slopes) >= 3:
            expected = float(np.median(self._slopes)) * turn
            moved = shift * math.copysign(1.0, expected) >= self._limits.min_shift * abs(expected)
        else:
            moved = abs(shift) >= 1.0
        if moved:
            self._slopes.append(shift / turn)
        return moved


@dataclass(frozen=True, slots=True)
class _Seen:
    mirror_angle: float
    rows: npt.NDArray[np.float64]
    lit: npt.NDArray[np.bool_]

    def shift_from(self, before: _Seen | None) -> float:
        """Return the median shift over columns lit in both [px], NaN when there are too few."""
        if before is None or before.lit.shape != self.lit.shape:
            return math.nan
        both = self.lit & before.lit
        if np.count_nonzero(both) < 3:
            return math.nan
        return float(np.median(self.rows[both] - before.rows[both]))


def _difference(on: Image, reference: Image) -> tuple[npt.NDArray[np.int32], int]:
    """Return on - reference on sampled rows and columns, channels summed, and the step between rows.

    The sum sees a laser of any colour, and keeps the sign, which the strongest channel would not.
    """
    row_step = max(1, on.shape[0] // _ROWS)
    column_step = max(1, on.shape[1] // _COLUMNS)
    places = (slice(None, None, row_step), slice(None, None, column_step))
    if on.ndim == 2:
        return np.subtract(on[places], reference[places], dtype=np.int32), row_step
    # Channel by channel: four times quicker than summing over an axis of three.
    total = np.subtract(on[..., 0][places], reference[..., 0][places], dtype=np.int32)
    for channel in range(1, on.shape[2]):
        total += np.subtract(on[..., channel][places], reference[..., channel][places], dtype=np.int32)
    return total, row_step
