"""Diagnosis of a scan with few returns: orientation, order and pattern of its frames, and advice."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from guara_perception.arrays import Float, Index, Mask
from guara_perception.ranging.scan_geometry import ScanGeometry
from guara_perception.scanning.light_diagnosis import FrameSamples
from guara_perception.stripes.band import StripeStatus

# If less than this share of the columns shows any light, the laser was practically off.
NO_LIGHT = 0.01
# Least number of stripes from which a missing half of the pattern can be inferred.
FEWEST_OF_PATTERN = 8
# Half length of a stripe's line on z = 0 [m].
HALF_LENGTH_M = 0.6
# A frame fits a stripe if at least half of its light is closer to the stripe's line than this fraction of the image
# height, which is less than half the stripe spacing.
FIT_PX_OF_HEIGHT = 0.008
# Least share of the sampled frames that must fit for a cause to be named, and least number of sampled frames.
FITTING_SHARE = 0.6
FEWEST_FRAMES = 4
# Least share of turned or flipped frames that is reported while other frames are upright.
MIXED_SHARE = 0.15
# Least `_Fit.fine` at which a match to unexpected stripes is accepted. True matches have 0.98, accidental ones less
# than 0.65.
FINE_SHARE = 0.8
# Stripes are nearly symmetric from left to right: if the distances of two fits differ by less than this factor, turned
# frames cannot be told from flipped ones. The ratio is 1.08 for a camera centred to a quarter of a pixel, and 2 for
# most cameras.
ALIKE = 1.03
WHERE_NONE_CAN_BE = (
    "a stripe where none can be, too high or too low: the calibration belongs to another rangefinder, the camera or "
    "mirror has moved, or the stance is wrong"
)
TURNED, FLIPPED, UPRIGHT = "turned by 180 degrees", "flipped top to bottom", ""


def advice(coverage: float, counts: Index, wrong: str = "", weak: str = "") -> str:
    """State the cause and remedy of few returns in one sentence; the remedies include those of docs/paper.md.

    Order of precedence: faults of the whole scan (`wrong`); no light; light where no stripe can be; a weak line;
    saturated or ambiguous returns; anything else.

    Args:
        coverage: share of the expected ground that was seen.
        counts: number of image columns of all stripes per StripeStatus.
        wrong: description of a fault of the whole scan (motion, light, frames or pattern); empty if there is none.
        weak: description of a weak line; empty if the line is not weak.
    """
    found = f"only {100 * coverage:.0f} % of the ground that should be visible returned laser light"
    if wrong:
        return f"{found}: {wrong}"
    columns = max(int(counts.sum()), 1)
    used = int(counts[StripeStatus.OK] + counts[StripeStatus.SATURATED])
    bright = int(counts[StripeStatus.SATURATED] + counts[StripeStatus.AMBIGUOUS])
    beyond = int(counts[StripeStatus.OUT_OF_BAND])
    if columns - counts[StripeStatus.DROPOUT] < NO_LIGHT * columns:
        return (
            f"{found}; hardly any light came back: check that the laser is on, the mirror turns and the lens is clean"
        )
    if beyond > max(used, bright):
        return f"{found}; {beyond} columns show {WHERE_NONE_CAN_BE}"
    if weak:
        return f"{found}: {weak}"
    if bright > counts[StripeStatus.OK]:
        return f"{found}; most returns are saturated or ambiguous: expose less, or put a polarising filter on the lens"
    return f"{found}; the rest is too dark or a hole: put a narrow band-pass filter on the lens or use a stronger laser"


def wrong_pattern(fired: Iterable[int], stride: int) -> str:
    """Describe a scan in which no two neighbours of its pattern were fired; empty otherwise, and for few stripes."""
    indices = sorted(fired)
    if len(indices) < FEWEST_OF_PATTERN or np.diff(indices).min() <= stride:
        return ""
    return (
        "no two neighbouring stripes were fired, so no ground between them could be measured: every second stripe is "
        'missing, or a coarse scan was processed in mode "standard"'
    )


def wrong_frames(samples: FrameSamples, geometry: ScanGeometry) -> str:
    """Describe frames that are turned, flipped, out of order, or lit where no stripe can be; empty if none is found."""
    rows = samples.rows
    if len(rows) < FEWEST_FRAMES:
        return ""
    indices, seen = list(rows), np.array(list(rows.values()))
    width, height = geometry.calibration.camera.size
    order = list(geometry.stripes)
    expected = _expected(geometry, samples.columns)
    mirrored = _expected(geometry, width - 1 - samples.columns)
    within = FIT_PX_OF_HEIGHT * height
    upright = _Fit.of(UPRIGHT, seen, expected, order, within)
    turned = _Fit.of(TURNED, seen, height - 1 - mirrored, order, within)
    flipped = _Fit.of(FLIPPED, seen, height - 1 - expected, order, within)
    likelier = min(turned, flipped, key=lambda fit: fit.distance)
    doubtful = max(turned.distance, flipped.distance) < ALIKE * likelier.distance
    turn = f"{TURNED} or {FLIPPED}" if doubtful else likelier.name
    own, other = (fit.fits & (np.array(fit.stripe) == indices) for fit in (upright, likelier))
    if own.mean() + other.mean() >= FITTING_SHARE and other.mean() >= MIXED_SHARE:
        which = (
            "the frames are"
            if own.mean() < MIXED_SHARE
            else f"{int(other.sum())} of the {len(indices)} frames examined are"
        )
        return f"{which} {turn}: use the orientation in which the camera was calibrated"
    if own.mean() >= FITTING_SHARE:
        return ""
    for fit in (upright, likelier):
        if fit.fits.mean() >= FITTING_SHARE and fit.fine >= FINE_SHARE:
            order_text = _order_words(np.array(indices)[fit.fits], np.array(fit.stripe)[fit.fits])
            return f"the frames are {turn}; also, {order_text}" if fit is likelier else order_text
    return _elsewhere(geometry, indices, seen)


@dataclass(frozen=True, slots=True)
class _Fit:
    """Fit of the light of some frames to the lines of stripes, for one orientation.

    Attributes:
        name: the orientation, in words.
        stripe: index of the stripe that each frame fits best.
        fits: (f,) mask of the frames that fit their stripe.
        fine: of the light closer to those stripes than `within` (see `of`), the share that is closer than a third of
            it; about 1/3 for evenly spread light.
        distance: mean distance of the light from the best stripes [px], capped at `within`; a column without light
            counts as `within`.
    """

    name: str
    stripe: Sequence[int]
    fits: Mask
    fine: float
    distance: float

    @classmethod
    def of(cls, name: str, seen: Float, rows: Float, order: Sequence[int], within: float) -> Self:
        """Fit rows of light (f, n) to rows of stripes (s, n), up to a distance [px]; NaN where there is no row."""
        apart = np.abs(seen[:, None, :] - rows[None])
        capped = np.where(apart < within, apart, within)
        best = np.argmin(capped.sum(axis=2), axis=1)
        distance = capped[np.arange(len(seen)), best]
        near = distance < within
        return cls(
            name,
            [order[k] for k in best],
            near.sum(axis=1) >= 0.5 * np.isfinite(seen).sum(axis=1),
            float((distance < within / 3).sum() / max(int(near.sum()), 1)),
            float(distance.mean()),
        )


def _elsewhere(geometry: ScanGeometry, indices: Sequence[int], seen: Float) -> str:
    """Describe a scan whose frames mostly show light where no stripe can be; empty for any other scan."""
    bands = np.array([geometry.stripes[index].band for index in indices], np.float64)
    outside = ((seen < bands[:, :1]) | (seen >= bands[:, 1:])).sum(axis=1) > 0.5 * np.isfinite(seen).sum(axis=1)
    if outside.mean() < FITTING_SHARE:
        return ""
    return f"{int(outside.sum())} of the {len(indices)} frames examined show {WHERE_NONE_CAN_BE}"


def _expected(geometry: ScanGeometry, columns: Index) -> Float:
    """Row (s, n) at which each stripe on ground at z = 0 crosses some columns; NaN where it does not reach them."""
    y = np.linspace(-HALF_LENGTH_M, HALF_LENGTH_M, 41)
    rows = []
    for plane in geometry.planes_in_footprint:
        x = -(plane[1] * y + plane[3]) / plane[0]
        pixels = geometry.pixels(np.column_stack((x, y, np.zeros_like(y))))
        ordered = pixels[np.argsort(pixels[:, 0])]
        rows.append(np.interp(columns, ordered[:, 0], ordered[:, 1], left=np.nan, right=np.nan))
    return np.array(rows)


def _order_words(index: Index, stripe: Index) -> str:
    """Describe the difference between the stripes that the frames show and the indices given with the frames."""
    off = stripe - index
    usual = int(np.median(off))
    if (np.abs(off - usual) <= 1).mean() > FITTING_SHARE:
        shift = f"{'ahead' if usual > 0 else 'behind'} by {abs(usual)}" if usual else "partly off by one"
        return f"the frames are {shift} in stripe index: a frame was lost or the camera lags"
    if np.corrcoef(index, stripe)[0, 1] < -0.8:
        return "the frames are in reverse order"
    return "the frames do not match their stripe indices: they are out of order or were taken with another pattern"
