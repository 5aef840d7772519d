"""Image-based verification that each frame was exposed with the commanded laser state and mirror angle."""

from __future__ import annotations

import math
import statistics
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from drivers.arrays import Array, Float, Image, Mask
from drivers.sweep.capture import StripeEvidence, StripeVerdict
from drivers.sweep.firing_order import RowRange

# Least number of sampled columns, if the image has as many. Their median row is accurate to a fraction of a pixel and
# takes 0.2 ms to compute.
COLUMNS = 80
# Least number of sampled rows, if the image has as many; at any image size, their spacing is less than half a stripe's
# width.
ROWS = 512
# Every 32nd sampled row and every 4th sampled column are used for offset and noise.
COARSE_STRIDES = (32, 4)
# Number of the latest stripes over which the median shift per radian is taken.
MEMORY = 9
# Fraction of columns lit within the band at which lit columns elsewhere can no longer change the verdict.
PLAINLY_LIT = 0.5
# Function that warps the first image to the view of the second, or returns None if it finds no motion between them.
Align = Callable[[Image, Image], Image | None]
# Verdicts that edges in the scene can also cause if the scene has moved since the reference.
SCENE_MAY_HAVE_MOVED = (StripeVerdict.LEAK, StripeVerdict.DARK, StripeVerdict.OUT_OF_BAND, StripeVerdict.NOT_MOVED)
PROVED = (StripeVerdict.OK, StripeVerdict.AMBIENT_CHANGED)


@dataclass(frozen=True, slots=True, kw_only=True)
class ProofLimits:
    """Thresholds of the comparison of frames.

    Attributes:
        min_contrast: least excess of a lit pixel over the reference, as a fraction of a channel's full scale.
        noise_factor: the same excess in standard deviations of the difference; the larger of the two thresholds
            applies.
        min_lit_fraction: least fraction of lit columns at which the laser counts as seen.
        min_leak_fraction: least fraction of columns brighter in the off frame at which the off frame counts as lit.
        max_offset: largest brightness change of the whole frame, as a fraction of full scale.
        min_shift: least shift of a stripe, as a fraction of the expected shift; 1 px until three shifts are known.
        max_out_of_band: largest fraction of lit columns outside the band.
    """

    min_contrast: float = 0.05
    noise_factor: float = 8.0
    min_lit_fraction: float = 0.02
    min_leak_fraction: float = 0.1
    max_offset: float = 0.04
    min_shift: float = 0.3
    max_out_of_band: float = 0.5


class StripeProof:
    """Verification of the stripes of one scan, in the order in which they are scanned.

    A stripe is compared over the whole image, unless its band is known and the previous stripe passed with the same off
    frame. Then, only the band is compared first, at a tenth of the cost, and the whole image only if the stripe does
    not clearly pass there.
    """

    def __init__(self, limits: ProofLimits | None = None, align: Align | None = None) -> None:
        """Start the verification of a scan; `align` is as in `acquire`."""
        self._limits, self._align = limits or ProofLimits(), align
        self._before: _Seen | None = None
        self._plain: _Seen | None = None
        self._slopes: deque[float] = deque(maxlen=MEMORY)
        self._grid = _SampleGrid(1, 1)
        self._reference: Image | None = None
        self._reference_light: Array = np.zeros((0, 0), dtype=np.int32)
        self._reference_is_clean = False

    def judge(
        self,
        mirror_angle: float,
        on: Image,
        reference: Image,
        *,
        reference_is_off: bool,
        band: RowRange | None = None,
    ) -> tuple[StripeVerdict, StripeEvidence]:
        """Compare the on frame of a stripe with a reference.

        Args:
            mirror_angle: commanded mirror angle [rad].
            on: frame with the laser on.
            reference: the off frame of the stripe, or the on frame of the previous stripe.
            reference_is_off: True if `reference` is an off frame.
            band: rows (first, end) where the stripe can be; None = anywhere.

        Returns:
            The verdict and its evidence, from the rows of the band if they suffice, otherwise from the whole image.
        """
        if reference is not self._reference:
            self._grid = _SampleGrid.of(reference)
            self._reference, self._reference_light = reference, self._grid.light(reference)
            self._reference_is_clean = False
        background = self._background(on, self._reference_light)
        if band is not None and self._reference_is_clean:
            rows = self._grid.sampled(band)
            if rows[1] > rows[0]:
                found = self._compare(mirror_angle, on, rows, background, reference_is_off)
                if found[1].lit_fraction >= PLAINLY_LIT:
                    # Only rows of the band were compared, so the verdict need not check the band.
                    verdict = self._verdict(*found, background, None)
                    if verdict in PROVED:
                        return verdict, found[1]
        rows = 0, len(self._reference_light)
        found = self._compare(mirror_angle, on, rows, background, reference_is_off)
        verdict = self._verdict(*found, background, band)
        if verdict in SCENE_MAY_HAVE_MOVED and self._align is not None:
            moved = self._align(reference, on)
            if moved is not None:
                import cv2

                # Motion of the scene must not look like a leak: the light of a pixel may have moved to a neighbouring
                # pixel.
                near = np.ones((3, 3), np.uint8)
                least = moved.copy()
                cv2.erode(moved, near, least)
                lights = self._grid.light(moved), self._grid.light(least)
                # At imperfectly aligned edges, pixels may darken by up to the threshold that was valid before the
                # alignment.
                least_leak, background = background.threshold, self._background(on, lights[0])
                found = self._compare(mirror_angle, on, rows, background, reference_is_off, lights, least_leak)
                verdict = self._verdict(*found, background, band)
        self._reference_is_clean = reference_is_off and verdict in PROVED
        return verdict, found[1]

    def _background(self, on: Image, reference: Array) -> _Background:
        """Estimate offset and noise between a frame and a reference from one in 128 of the sampled pixels."""
        sample = self._grid.coarser.light(on) - reference[:: COARSE_STRIDES[0], :: COARSE_STRIDES[1]]
        offset = _median(sample)
        noise = 1.4826 * _median(np.abs(sample - offset))
        full = float((1 << 8 * on.dtype.itemsize) - 1)
        threshold = max(self._limits.min_contrast * full, self._limits.noise_factor * noise)
        return _Background(offset, noise, threshold, full * (on.shape[2] if on.ndim == 3 else 1))

    def _compare(
        self,
        mirror_angle: float,
        on: Image,
        rows: tuple[int, int],
        background: _Background,
        reference_is_off: bool,
        lights: tuple[Array, Array] | None = None,
        least_leak: float = 0.0,
    ) -> tuple[_Seen, StripeEvidence]:
        """Compare rows of a frame with the reference or with an aligned reference.

        Args:
            mirror_angle: commanded mirror angle [rad].
            on: frame with the laser on.
            rows: sampled rows (first, end).
            background: difference over the whole image.
            reference_is_off: True if the reference is the off frame.
            lights: light of the aligned reference, and the minimum of that light around each pixel; None = the
                reference as it is.
            least_leak: least decrease that counts as a leak, if it is larger than the threshold.
        """
        first, end = rows
        difference = self._grid.light(on, rows)
        lowest = None if lights is None else (difference - lights[1][first:end]).min(axis=0)
        difference -= (self._reference_light if lights is None else lights[0])[first:end]
        peaks = difference.max(axis=0) - background.offset
        lit = peaks > background.threshold
        leaks = 0
        if reference_is_off:
            lowest = difference.min(axis=0) if lowest is None else lowest
            leaks = int(np.count_nonzero(background.offset - lowest > max(background.threshold, least_leak)))
        at = (first + difference.argmax(axis=0)) * float(self._grid.row_stride)
        seen = _Seen(mirror_angle, at, lit)
        count = int(np.count_nonzero(lit))
        return seen, StripeEvidence(
            lit_fraction=count / lit.size,
            leak_fraction=leaks / lit.size,
            contrast=_median(peaks if count == lit.size else peaks[lit]) if count else math.nan,
            offset=background.offset,
            noise=background.noise,
            row=_median(at if count == lit.size else at[lit]) if count else math.nan,
            row_shift=seen.shift_from(self._before),
        )

    def _verdict(
        self, seen: _Seen, evidence: StripeEvidence, background: _Background, band: RowRange | None
    ) -> StripeVerdict:
        limits = self._limits
        if evidence.leak_fraction >= limits.min_leak_fraction:
            return StripeVerdict.LEAK
        if evidence.lit_fraction < limits.min_lit_fraction:
            return StripeVerdict.DARK
        if band is not None:
            rows = seen.rows[seen.lit]
            outside = np.count_nonzero((rows < band[0]) | (rows >= band[1])) / rows.size
            if outside > limits.max_out_of_band:
                return StripeVerdict.OUT_OF_BAND
        if not self._has_moved(seen, evidence.row_shift):
            return StripeVerdict.NOT_MOVED
        self._before = seen
        if evidence.lit_fraction >= PLAINLY_LIT:
            self._plain = seen
        if abs(evidence.offset) > limits.max_offset * background.full_scale:
            return StripeVerdict.AMBIENT_CHANGED
        return StripeVerdict.OK

    def _has_moved(self, seen: _Seen, shift: float) -> bool:
        """Return True if a stripe has moved relative to the previous one or to the last plainly lit one.

        The last plainly lit stripe is tried as well if fewer than half of the lit columns were also lit in the previous
        stripe: the lit columns of the previous stripe may be edges of a moving scene, which must not make later stripes
        look stuck.
        """
        before, plain = self._before, self._plain
        if self._moved(seen, before, shift):
            return True
        if before is None or plain is None or before.lit.shape != seen.lit.shape:
            return False
        is_few = 2 * np.count_nonzero(seen.lit & before.lit) < np.count_nonzero(seen.lit)
        return bool(is_few) and self._moved(seen, plain, seen.shift_from(plain))

    def _moved(self, seen: _Seen, before: _Seen | None, shift: float) -> bool:
        if before is None or math.isnan(shift) or seen.mirror_angle == before.mirror_angle:
            return True
        turn = seen.mirror_angle - before.mirror_angle
        if len(self._slopes) >= 3:
            expected = statistics.median(self._slopes) * turn
            moved = shift * math.copysign(1.0, expected) >= self._limits.min_shift * abs(expected)
        else:
            moved = abs(shift) >= 1.0
        if moved:
            self._slopes.append(shift / turn)
        return moved


@dataclass(frozen=True, slots=True)
class _Background:
    """Difference between a whole frame and the reference, in counts summed over channels."""

    offset: float
    noise: float
    threshold: float
    full_scale: float


@dataclass(frozen=True, slots=True)
class _Seen:
    mirror_angle: float
    rows: Float
    lit: Mask

    def shift_from(self, before: _Seen | None) -> float:
        """Median row shift over the columns lit in both stripes [px]; NaN if there are fewer than three."""
        if before is None or before.lit.shape != self.lit.shape:
            return math.nan
        both = self.lit & before.lit
        count = np.count_nonzero(both)
        if count < 3:
            return math.nan
        moved = self.rows - before.rows
        return _median(moved if count == both.size else moved[both])


@dataclass(frozen=True, slots=True)
class _SampleGrid:
    """Sampled pixels of a frame: every `row_stride`-th row and every `column_stride`-th column."""

    row_stride: int
    column_stride: int

    @classmethod
    def of(cls, image: Image) -> _SampleGrid:
        """Choose the strides for images of this size. Column strides that are multiples of four are faster."""
        column_stride = max(1, image.shape[1] // COLUMNS)
        return cls(
            max(1, image.shape[0] // ROWS), column_stride - column_stride % 4 if column_stride > 4 else column_stride
        )

    @property
    def coarser(self) -> _SampleGrid:
        """Grid of one in 128 of the sampled pixels."""
        return _SampleGrid(COARSE_STRIDES[0] * self.row_stride, COARSE_STRIDES[1] * self.column_stride)

    def sampled(self, band: RowRange) -> tuple[int, int]:
        """Indices (first, end) of the sampled rows in a band of image rows."""
        return -(-max(band[0], 0) // self.row_stride), -(-max(band[1], 0) // self.row_stride)

    def light(self, image: Image, rows: tuple[int, int] | None = None) -> Array:
        """Sum over channels at the sampled pixels, (rows, columns); `rows` are sampled rows (first, end), None = all.

        The sum responds to a laser of any colour. A difference of sums has the right sign, unlike a difference of
        maxima.
        """
        first, end = (0, None) if rows is None else (rows[0] * self.row_stride, rows[1] * self.row_stride)
        pixels = self._pixels(image, slice(first, end, self.row_stride))
        kind = np.int16 if image.dtype.itemsize == 1 else np.int32
        if image.ndim == 2:
            return pixels.astype(kind)
        # Adding channel by channel is four times faster than a sum over an axis of length three.
        total: Array = np.add(pixels[..., 0], pixels[..., 1], dtype=kind)
        for channel in range(2, image.shape[2]):
            total += pixels[..., channel]
        return total

    def _pixels(self, image: Image, rows: slice) -> Array:
        """Return the sampled pixels; those of 8-bit colour may have a fourth channel, the first byte of the next pixel.

        The four bytes are read as one integer, because passes over the frame in memory dominate the cost.
        """
        stride = self.column_stride
        is_colour = image.ndim == 3 and image.shape[2] == 3 and image.dtype.itemsize == 1
        if not (is_colour and image.flags.c_contiguous and image.shape[1] % 4 == 0 and stride % 4 == 0):
            return image[rows, ::stride]
        packed = image.reshape(image.shape[0], -1).view(np.uint32)[rows, :: stride * 3 // 4]
        return packed.copy().view(np.uint8).reshape(*packed.shape, 4)


def _median(values: Array) -> float:
    """Compute the median; about three times as fast as `np.median` for a few values."""
    ordered = np.sort(values, axis=None)
    half = ordered.size // 2
    return float(ordered[half] if ordered.size % 2 else 0.5 * (ordered[half - 1] + ordered[half]))
