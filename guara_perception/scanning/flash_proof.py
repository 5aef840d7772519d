"""Proof that a scan shows no laser light but the robot's own, and that each frame was exposed during its flash."""

from __future__ import annotations

import math
import statistics
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import cv2
import numpy as np

from guara_perception.arrays import Float32, Image, Mask
from guara_perception.scanning.background import aligned
from guara_perception.stripes.band import (
    FramePair,
    StripeProfile,
    StripeStatus,
    full_scale,
    pictures_of,
    upper_median,
)
from guara_perception.stripes.kernel.library import address, kernel, memory

SECOND_LINE = "two lines in one picture"
# Brightness of a second line relative to the stripe, above which it shifts the measured row.
LEAST_SHARE = 0.45
# A fainter second line, above LEAST_ODD_SHARE, counts if it exceeds ODD times the median of the scan's stripes. A
# second line that all stripes show is a reflection, which does not shift the row.
LEAST_ODD_SHARE, ODD = 0.2, 2.5
# The whole scan is refused if at least this fraction of its stripes, and at least this number, show a second line.
REFUSED_SHARE, REFUSED_STRIPES = 0.2, 4
FOREIGN_LIGHT = "foreign laser light"
OTHER_INSTANT = "frames are not of their flash"
# Images are reduced by an integer factor so that they are narrower than twice COMPARED_PX. MEAN_PX is the edge of the
# averaging window. Light narrower than LARGEST_PX is a line or a spot [px].
COMPARED_PX, MEAN_PX, LARGEST_PX = 640, 5, 25
# Least excess of the averaged light, in grey levels of 255 and in sigmas of the noise.
LEAST_LEVEL, LEAST_SIGMAS = 5.0, 8.0
# Displacement that may remain between aligned images, because the ground is not flat [px].
WITHIN_PX = 1
# Light in at least this fraction of the columns or rows is a line. A smaller light that does not move, such as a lamp,
# only makes its pixels unusable.
LINE_SHARE = 0.08
# Least extent of a spot of light that is compared with the next dark frame, as a fraction of the columns or rows.
SPOT_SHARE = 0.01
# Spots in two successive dark frames that overlap in less than this fraction of the smaller one are moving light.
LEAST_OVERLAP = 0.3
# A frame shows no line if less than the fraction NO_LINE of its columns has returns, and a line if more than PLAIN_LINE
# has.
NO_LINE, PLAIN_LINE = 0.02, 0.1
# Largest shift between frames and flashes that is tested [frames].
MOST_SHIFT = 6
# Returns within this distance of light in a dark frame are not used [px of the reduced images].
BESIDE_PX = 6


def second_line(pair: FramePair, profile: StripeProfile) -> float:
    """Brightness of a second line relative to a stripe, estimated over many columns; 1 if the two lines merge.

    It is 0 if too few columns show the stripe well, and without a laser-off image, because a bright edge of the scene
    would look like a line.

    Args:
        pair: images of the stripe.
        profile: stripe found in them.
    """
    if pair.off is None:
        return 0.0
    on, off = pictures_of(pair.on, pair.off)
    work = memory(kernel().second_line_size(on.rows))
    return float(kernel().second_line(on, off, address(profile.position_px), LEAST_SHARE, address(work)))


def second_line_in_motion(share: float, pair: FramePair, profile: StripeProfile) -> float:
    """Brightness as of `second_line`, which returned `share`, if the camera may have moved between the two images.

    The laser-off image is warped to the view of the laser-on image, so that moving texture is not taken for a line.
    """
    if pair.off is None or share <= LEAST_ODD_SHARE or (moved := aligned(pair.off, pair.on)) is None:
        return share
    return second_line(replace(pair, off=moved), profile)


def doubled_stripes(shares: Mapping[int, float]) -> frozenset[int]:
    """Stripes that a second line may have shifted: a bright line, or a fainter one that other stripes lack.

    Args:
        shares: relative brightness of the second line, by stripe index.
    """
    usual = statistics.median(shares.values()) if shares else 0.0
    least = min(LEAST_SHARE, max(LEAST_ODD_SHARE, ODD * usual))
    return frozenset(index for index, share in shares.items() if share > least)


@dataclass(frozen=True, slots=True)
class Proof:
    """Findings of `FlashProof` about a scan.

    Attributes:
        refused: reason why no stripe of the scan may be used, beginning with the cause; empty if the scan may be used.
        unproved: stripes after the last dark flash, whose frames may show another instant.
        spoilt: (h, w) mask of pixels that are lit while the laser is off, and of pixels close to them, at the
            resolution of `lit_pixels`; None if there are none.
        doubled: stripes that are not used because their image shows two lines.
        darks: number of dark flashes whose frames are known; None for a sweep without dark flashes.
    """

    refused: str = ""
    unproved: frozenset[int] = frozenset()
    spoilt: Mask | None = None
    doubled: frozenset[int] = frozenset()
    darks: int | None = None


class FlashProof:
    """Comparison of the frames of a sweep with the sequence of its lit and dark flashes."""

    def __init__(self) -> None:
        """Start a sweep; no dark flash is expected yet."""
        self._planned: set[int] = set()
        self._seen: dict[int, float] = {}
        self._darks: dict[int, tuple[float, Mask]] = {}
        self._second: dict[int, float] = {}
        self._alone: tuple[int, Image] | None = None

    def expect(self, dark_after: Collection[int]) -> None:
        """Expect dark flashes after some stripes, besides those expected before."""
        self._planned.update(dark_after)

    def add(self, index: int, profile: StripeProfile) -> None:
        """Add the profile of a stripe, in the order in which the stripes were fired."""
        share = np.count_nonzero(profile.status != StripeStatus.DROPOUT) / profile.status.size
        self._seen[index] = math.nan if profile.is_frame_bad else share

    def add_second_line(self, index: int, share: float) -> None:
        """Add the brightness of a second line in the image of a stripe, relative to the stripe."""
        self._second[index] = share

    def add_dark(self, index: int, dark: Image, reference: Image | None) -> None:
        """Add the frame of the dark flash after a stripe.

        Args:
            index: index of the stripe.
            dark: frame of the dark flash.
            reference: a frame without the laser; None = the first dark frame that was added without a reference.
        """
        self._planned.add(index)
        if reference is None:
            if self._alone is None:
                self._alone = index, dark.copy()
                self._darks[index] = 0.0, np.zeros((1, 1), np.bool_)
                return
            first, reference = self._alone
            if first in self._darks and self._darks[first][1].size == 1:
                self._keep(first, reference, dark)
        self._keep(index, dark, reference)

    def _keep(self, index: int, dark: Image, reference: Image) -> None:
        if dark.shape != reference.shape or dark.dtype != reference.dtype:
            # Frames of different sizes or types cannot be compared, so this dark flash proves nothing.
            return
        lit = lit_pixels(dark, reference)
        if lit.any() and (moved := aligned(reference, dark)) is not None:
            lit = lit_pixels(dark, moved, within=WITHIN_PX)
        self._darks[index] = max(float(lit.any(axis=0).mean()), float(lit.any(axis=1).mean())), lit

    @property
    def version(self) -> tuple[int, ...]:
        """Numbers that change when something is added."""
        return len(self._planned), len(self._seen), len(self._darks), len(self._second)

    def judge(self) -> Proof:
        """Judge the frames added so far."""
        order, count = list(self._seen), len(self._darks) if self._planned else None
        doubled = doubled_stripes(self._second)
        if len(doubled) >= max(REFUSED_STRIPES, REFUSED_SHARE * len(order)):
            text = f"{FOREIGN_LIGHT}: {SECOND_LINE} for {len(doubled)} of {len(order)} stripes: another robot, or a "
            return Proof(text + "reflection of the robot's own line in a window or mirror", darks=count)
        if not self._planned:
            return Proof(doubled=doubled)
        lines = [index for index in order if index in self._darks and self._darks[index][0] >= LINE_SHARE]
        if lines:
            return Proof(self._cause(order, lines), darks=count)
        if self._moves():
            return Proof(f"{FOREIGN_LIGHT}: light moves while the laser is off", darks=count)
        last = max((place for place, index in enumerate(order) if index in self._darks), default=-1)
        lit = [mask for share, mask in self._darks.values() if share > 0]
        spoilt = None
        if lit:
            grown = np.ones((2 * BESIDE_PX + 1, 2 * BESIDE_PX + 1), np.uint8)
            spoilt = np.asarray(cv2.dilate(np.logical_or.reduce(lit).astype(np.uint8), grown) > 0)
        return Proof(unproved=frozenset(order[last + 1 :]), spoilt=spoilt, doubled=doubled, darks=count)

    def _cause(self, order: list[int], lines: list[int]) -> str:
        """State the cause of lines in dark frames: frames of another instant if one shift explains the lines."""
        listed = ", ".join(map(str, lines))
        shots: list[tuple[int, bool]] = []
        for index in order:
            shots.append((index, True))
            if index in self._planned:
                shots.append((index, False))
        for shift in (each * sign for each in range(1, MOST_SHIFT + 1) for sign in (1, -1)):
            if self._explains(shots, lines, shift):
                return (
                    f"{OTHER_INSTANT}: they are {abs(shift)} frame{'s' if abs(shift) > 1 else ''} "
                    f"{'late' if shift > 0 else 'early'}, and show a "
                    f"line in the dark flash after stripe {listed}: restart the camera, and check its driver and "
                    "trigger"
                )
        return (
            f"{FOREIGN_LIGHT}, or {OTHER_INSTANT}: a line is seen in the dark flash after stripe {listed}: is another "
            "robot scanning the same ground?"
        )

    def _explains(self, shots: list[tuple[int, bool]], lines: list[int], shift: int) -> bool:
        """Test that a shift of the frames explains the lines in dark flashes.

        The frame that was exposed during a dark flash is then recorded for a lit flash. It shows no line, but frames
        near it do.
        """
        found = 0
        for place, (index, is_lit) in enumerate(shots):
            at = place + shift
            if is_lit or index not in lines or not 0 <= at < len(shots) or not shots[at][1]:
                continue
            beside = [
                self._seen[other] for other, lit in shots[max(at - 2, 0) : at + 3] if lit and other != shots[at][0]
            ]
            if not (self._seen[shots[at][0]] < NO_LINE and max(beside, default=0.0) > PLAIN_LINE):
                return False
            found += 1
        return found > 0

    def _moves(self) -> bool:
        """Test that a spot of light moves from one dark frame to the next."""
        spots = [mask for share, mask in self._darks.values() if share >= SPOT_SHARE]
        return any(
            np.count_nonzero(a & b) < LEAST_OVERLAP * min(np.count_nonzero(a), np.count_nonzero(b))
            for a, b in pairwise(spots)
        )


def lit_pixels(dark: Image, reference: Image, *, within: int = 0) -> Mask:
    """Mask of light in a laser-off frame that `reference` lacks and that is narrower than LARGEST_PX in some direction.

    If the frame is at least twice as wide as COMPARED_PX, the mask is smaller than the frame by an integer factor.

    Args:
        dark: frame without the laser.
        reference: another frame without the laser, of the same size and type.
        within: distance up to which light in the reference explains light in the frame [pixels of the mask].
    """
    scale = 255.0 / full_scale(dark)
    reduced = [_reduced(picture) for picture in (dark, reference)]
    samples = [float(picture[::8, ::8].mean()) for picture in reduced]
    # The overall brightness of the scene may have changed.
    gain = samples[0] / max(samples[1], 1e-3)
    light = reduced[0] - np.float32(gain) * reduced[1]
    mean = _mean(light * np.float32(scale))
    noise = _noise(mean)
    if within:
        near = cv2.dilate(reduced[1], np.ones((2 * within + 1, 2 * within + 1), np.uint8))
        # Clipped at 0, because pixels between negative differences would otherwise stand out like light.
        mean = _mean(np.maximum(reduced[0] - np.float32(gain) * near, 0) * np.float32(scale))
    wide = cv2.morphologyEx(mean, cv2.MORPH_OPEN, np.ones((LARGEST_PX, LARGEST_PX), np.uint8))
    narrow = mean - np.asarray(wide, np.float32)
    return np.asarray(narrow > max(LEAST_LEVEL, LEAST_SIGMAS * noise))


def _mean(light: Float32) -> Float32:
    """Mean of the brightest channel over a window of MEAN_PX x MEAN_PX."""
    one = light.max(axis=2) if light.ndim == 3 else light
    return np.asarray(cv2.blur(one, (MEAN_PX, MEAN_PX)), np.float32)


def _reduced(picture: Image) -> Float32:
    """Image as float32, reduced by an integer factor to less than twice COMPARED_PX in width."""
    factor = max(picture.shape[1] // COMPARED_PX, 1)
    height, width = picture.shape[0] // factor, picture.shape[1] // factor
    whole = picture[: height * factor, : width * factor].astype(np.float32)
    return whole if factor == 1 else np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA))


def _noise(mean: Float32) -> float:
    some = mean[:: 2 * MEAN_PX, :: 2 * MEAN_PX]
    return 1.4826 * upper_median(np.abs(some - upper_median(some)))


def without_spoilt(profile: StripeProfile, spoilt: Mask) -> StripeProfile:
    """Profile without the returns in the pixels of a mask, which become AMBIGUOUS.

    Args:
        profile: profile of a usable frame.
        spoilt: (h, w) mask as in `Proof`, in the size of the frame or smaller by an integer factor.
    """
    rows = np.where(np.isfinite(profile.position_px), profile.position_px, profile.doubtful_px)
    columns = np.flatnonzero(np.isfinite(rows))
    factor = max(rows.size // spoilt.shape[1], 1)
    at = np.minimum(np.rint(rows[columns]).astype(np.intp) // factor, spoilt.shape[0] - 1)
    hit = columns[spoilt[at, np.minimum(columns // factor, spoilt.shape[1] - 1)]]
    if not hit.size:
        return profile
    status, position = profile.status.copy(), profile.position_px.copy()
    sigma, doubtful = profile.sigma_px.copy(), profile.doubtful_px.copy()
    position[hit] = sigma[hit] = doubtful[hit] = np.nan
    status[hit] = StripeStatus.AMBIGUOUS
    return replace(profile, position_px=position, sigma_px=sigma, status=status, doubtful_px=doubtful)
