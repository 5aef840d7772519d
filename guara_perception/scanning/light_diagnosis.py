"""Faults of the light of a scan, diagnosed from a few of its frames: too bright, flicker, bloom, weak line, texture."""

from __future__ import annotations

import statistics
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from guara_perception.arrays import Float, Image, Index
from guara_perception.stripes.band import FramePair, StripeProfile, StripeStatus, full_scale, pictures_of
from guara_perception.stripes.kernel.library import Picture, address, addresses, kernel, memory

# Approximate number of sampled frames, spread over the scan, and spacing of the sampled rows and of the pixels in them
# [px]. Few rows are sampled, because reading a picture from memory takes most of the time.
SAMPLED_FRAMES = 12
ROWS_APART, PIXELS_APART = 32, 8
# Number of evenly spaced columns of a frame in which the brightest row and a clipped core are searched for.
GLANCED = 12
# Spacing of the rows in which light and a core are searched for, as a fraction of the image height: 2 px of 512.
GLANCED_ROWS_OF_HEIGHT = 1 / 256
# Largest share of the pixels that may be clipped in a laser-off image; above it there is too much light.
MOST_CLIPPED = 0.15
# Largest relative change of the brightness between laser off and laser on, or from frame to frame.
MOST_CHANGE = 0.06
# Changes in images darker than this level are taken relative to it, because such changes are too small to affect a
# stripe [grey levels of 255].
DARKEST_LEVEL = 32.0
# Share of the pixels that the mean level excludes: the brightest ones, including the stripe.
STRIPE_SHARE = 0.05
# Widest clipped core, as a fraction of the image height: a wider one leaves no flanks to measure. 8 px of 512.
WIDEST_CORE_OF_HEIGHT = 8 / 512
# Least height of a stripe above its surroundings [grey levels of 255]; a lower one is lost in texture and noise.
WEAKEST_LINE = 50.0
# Without laser-off pictures, texture hides the stripe if its contrast exceeds this multiple of the stripe's height.
MOST_TEXTURE = 3.0
# Percentiles that bound the darkest and the brightest tenth of a scene.
TENTHS = (10, 90)
# Share of the columns that must show a stripe before the stripe can be called weak.
LEAST_SEEN = 0.01


@dataclass(frozen=True, slots=True)
class FrameSample:
    """Light of one frame.

    Attributes:
        clipped: share of the pixels that are clipped in the laser-off image; without one, in the laser-on image.
        level: mean level of the laser-on image without its brightest pixels [grey levels of 255].
        change: relative difference in brightness from the laser-off image, 0 without one.
        core: number of rows clipped by the stripe, median over the columns that have any; 0 if none has.
        seen: share of the columns with a return, whether usable or not.
        peak: height of the stripe, median over these columns [grey levels of 255].
        contrast: difference between the brightest and the darkest tenth of the image [grey levels of 255]; 0 with a
            laser-off image, which removes the scene.
        rows: (GLANCED,) brightest row in each of `FrameSamples.columns`, after subtraction of a laser-off image [px];
            NaN where no row stands out.
    """

    clipped: float
    level: float
    change: float
    core: float
    seen: float
    peak: float
    contrast: float
    rows: Float


class FrameSamples:
    """Samples of some frames of a scan, taken while the frames are processed.

    Attributes:
        columns: (GLANCED,) columns of `FrameSample.rows`.
    """

    def __init__(self, order: Sequence[int], size: tuple[int, int]) -> None:
        """Choose frames at an odd stride, so that good and bad frames are both sampled if every second frame is bad.

        Args:
            order: indices of the scan's stripes.
            size: width and height of the frames [px].
        """
        self._chosen = frozenset(order[:: len(order) // SAMPLED_FRAMES | 1])
        width, self._height = size
        self.columns = np.linspace(0.1 * width, 0.9 * width - 1, GLANCED).astype(np.intp)
        self._samples: dict[int, FrameSample] = {}
        self._unused: dict[int, str] = {}

    def add(self, pair: FramePair, profile: StripeProfile) -> None:
        """Sample a frame if it was chosen, and record the reason if its laser-off image was not used."""
        if profile.remark and pair.off is not None:
            self._unused[pair.index] = profile.remark
        if pair.index in self._chosen:
            self._samples[pair.index] = _sample(pair, profile, self.columns)

    def take_over(self, other: FrameSamples, indices: Collection[int]) -> None:
        """Add the samples of some stripes of another scan."""
        self._samples.update({index: sample for index, sample in other._samples.items() if index in indices})
        self._unused.update({index: why for index, why in other._unused.items() if index in indices})

    @property
    def rows(self) -> dict[int, Float]:
        """Brightest rows (GLANCED,), by index, of sampled frames with light in at least a third of `columns`."""
        rows = {index: sample.rows for index, sample in sorted(self._samples.items())}
        return {index: seen for index, seen in rows.items() if np.isfinite(seen).sum() >= GLANCED // 3}

    @property
    def unused(self) -> dict[int, str]:
        """Reasons why laser-off images were not used, by stripe index."""
        return dict(sorted(self._unused.items()))

    def excess(self) -> str:
        """Description of excessive or unsteady light, with the remedy; empty if the light is neither."""
        samples = list(self._samples.values())
        if not samples:
            return ""
        clipped, core = _median(samples, "clipped"), _median(samples, "core")
        change = _change(samples)
        if clipped > MOST_CLIPPED:
            return (
                f"too bright: {100 * clipped:.0f} % of the picture is clipped without the laser: shade the scene, "
                "expose less, or put a narrow band-pass filter on the lens"
            )
        if core > WIDEST_CORE_OF_HEIGHT * self._height:
            return (
                f"bloom: the stripe is clipped over {core:.0f} px: expose less, weaken the laser, or put a polarising "
                "filter on the lens"
            )
        if change > MOST_CHANGE:
            return f"flicker: the brightness changes by {100 * change:.0f} % from picture to picture: {STEADY}"
        return ""

    def margins(self) -> dict[str, float]:
        """Margins of the light, by name; empty without samples.

        "margin_clipped" and "margin_steady" are 1 far from the limits of `excess`, 0 at them and negative beyond;
        "stripe_level", missing if no stripe was found, is the height of the stripe [grey levels of 255], which falls as
        the lens or the laser ages.
        """
        samples, lit = list(self._samples.values()), self._with_laser()
        result = {}
        if samples:
            result["margin_clipped"] = 1.0 - _median(samples, "clipped") / MOST_CLIPPED
            result["margin_steady"] = 1.0 - _change(samples) / MOST_CHANGE
        if lit:
            result["stripe_level"] = _median(lit, "peak")
        return result

    def lack(self) -> str:
        """Description of a weak stripe, with the remedy; empty if the stripe is not weak, or was hardly seen at all."""
        samples = self._with_laser()
        if not samples or sum(sample.seen for sample in samples) < LEAST_SEEN * len(self._samples):
            return ""
        peak = _median(samples, "peak")
        if peak >= WEAKEST_LINE:
            return ""
        return (
            f"weak line: the stripe stands only {peak:.0f} grey levels of 255 above its surroundings: use a stronger "
            "laser, a narrow band-pass filter, or a longer exposure"
        )

    def texture(self) -> str:
        """Description of texture that hides the stripe in a scan without laser-off images; empty if there is none."""
        samples = self._with_laser()
        if not samples or (contrast := _median(samples, "contrast")) <= MOST_TEXTURE * _median(samples, "peak"):
            return ""
        return (
            f"texture: the scene's own light varies by {contrast:.0f} grey levels of 255; the stripe adds "
            f"{_median(samples, 'peak'):.0f}: take laser-off pictures"
        )

    def _with_laser(self) -> list[FrameSample]:
        return [sample for sample in self._samples.values() if sample.seen > 0]


STEADY = 'lock exposure and white balance, keep lamps steady, or take laser-off pictures "per stripe"'


def _sample(pair: FramePair, profile: StripeProfile, columns: Index) -> FrameSample:
    on, off = pictures_of(pair.on, pair.off)
    scale = 255.0 / full_scale(pair.on)
    level, clipped = _levels(on)
    dark, clipped = (level, clipped) if off is None else _levels(off)
    found = profile.status != StripeStatus.DROPOUT
    seen, peaks = np.count_nonzero(found) / found.size, profile.peak[found]
    apart, brightest = max(round(GLANCED_ROWS_OF_HEIGHT * on.rows), 1), np.empty(columns.size)
    work = memory(kernel().look_down_size(on.rows, columns.size))
    core = kernel().look_down(on, off, apart, address(columns), columns.size, *addresses(work, brightest))
    return FrameSample(
        clipped=clipped,
        level=scale * level,
        change=_share(scale * level, scale * dark),
        core=apart * core,
        seen=seen,
        peak=scale * float(np.float32(kernel().median(address(peaks), peaks.size))) if seen else 0.0,
        contrast=0.0 if off is not None else scale * _contrast(pair.on[::ROWS_APART, ::PIXELS_APART]),
        rows=apart * brightest,
    )


def _levels(picture: Picture) -> tuple[float, float]:
    """Mean of some pixels except the brightest ones [grey levels], and the share of these pixels that are clipped."""
    found, work = np.empty(2), memory(kernel().levels_size(picture))
    kernel().levels_of(picture, ROWS_APART, PIXELS_APART, STRIPE_SHARE, *addresses(work, found))
    level, clipped = found.tolist()
    return level, clipped


def _median(samples: Sequence[FrameSample], name: str) -> float:
    return statistics.median(getattr(sample, name) for sample in samples)


def _change(samples: Sequence[FrameSample]) -> float:
    """Relative change of the brightness between laser off and on, or from frame to frame."""
    usual = _median(samples, "level")
    from_frame_to_frame = float(np.median([_share(sample.level, usual) for sample in samples]))
    return max(_median(samples, "change"), from_frame_to_frame)


def _contrast(picture: Image) -> float:
    """Difference between the brightest and the darkest tenth of the pixels, after averaging their channels."""
    low, high = np.percentile(picture.reshape(*picture.shape[:2], -1).mean(axis=2), TENTHS)
    return float(high - low)


def _share(level: float, usual: float) -> float:
    """Relative difference between two levels; see DARKEST_LEVEL."""
    return abs(level - usual) / max(usual, DARKEST_LEVEL)
