"""Record of a scan for its grid, and diagnosis of a scan with few returns."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import TYPE_CHECKING, Self

import numpy as np

from guara_perception.arrays import Array, Float, Index, Mask
from guara_perception.calibration.drift import DRIFTING, HOLDS, Drift, check_drift
from guara_perception.ranging.scan_geometry import ScanGeometry
from guara_perception.ranging.stripe_points import StripePoints
from guara_perception.scanning.flash_proof import OTHER_INSTANT, Proof
from guara_perception.scanning.light_diagnosis import STEADY, FrameSamples
from guara_perception.settings import Settings
from guara_perception.stripes.band import StripeProfile, StripeStatus
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK, Hazard, cells_by_flag
from guara_perception.terrain.layers.record import ScanRecord
from guara_perception.terrain.layers.record_fields import Health

if TYPE_CHECKING:
    from kinematics import RobotModel, Stance, StancePose

# Under this share of expected returns a scan says why and what helps.
LOW_COVERAGE = 0.5
# Under this share of columns with any light the laser was practically off.
NO_LIGHT = 0.01
# With fewer stripes nothing is concluded from every second one that is missing.
FEWEST_OF_PATTERN = 8
REGIONS_X, REGIONS_Y = ("near", "middle", "far"), ("right", "centre", "left")
# [m] The lines of the stripes on z = 0 are drawn this far to both sides.
HALF_LENGTH_M = 0.6
# A frame fits a stripe when half of its light lies within this of it: less than half a pitch of neighbouring stripes.
FIT_PX_OF_HEIGHT = 0.008
# Frames that must fit for a cause to be named, as a share and in number.
FITTING_SHARE = 0.6
FEWEST_FRAMES = 4
# From this share on, frames that fit turned or flipped while the others fit upright are reported.
MIXED_SHARE = 0.15
# Frames show other stripes than they should when this share of the light near those stripes lies close to them. In such
# frames 0.98 of it does, by chance less than 0.65.
FINE_SHARE = 0.8
# Stripes look nearly the same from left to right: fits that differ by less than this factor leave open whether frames
# are turned or flipped. They differ by 1.08 for a camera that is mounted and centred to a quarter of a pixel, by 2 for
# most.
ALIKE = 1.03
WHERE_NONE_CAN_BE = (
    "a stripe where none can be, too high or too low: the calibration is of another rangefinder, camera or mirror "
    "moved, or the stance is wrong"
)
MIRRORED = (
    "mirrored left to right, the frames fit the calibration: the camera or its driver flips them, and what is on the "
    "left is taken for the right"
)
# The drift check reads every fourth column: neighbouring columns are smoothed together, so these carry as much
# information in half of the time.
COLUMNS_APART = 4
# So many stripes, all over the scan, show that the whole scan is worth a check for mirrored frames.
SUSPECTED = 12
TURNED, FLIPPED, UPRIGHT = "turned by 180 degrees", "flipped top to bottom", ""


def advice(coverage: float, counts: Index, wrong: str = "", weak: str = "") -> str:
    """Cause and remedy of few returns in one sentence, the paper's remedies included.

    Too much light, orientation, order and pattern come first, then stripes found where they cannot be, weak stripes,
    stripes that are not usable, and stripes that were not found.

    Args:
        coverage: share of the expected ground that was seen.
        counts: image columns of all stripes per StripeStatus.
        wrong: fault of the light, the frames or the pattern as a whole; empty for none.
        weak: text on a weak line; empty where the line is not weak. A stripe where none can be is a guess, and looks
            weak.
    """
    found = f"only {100 * coverage:.0f} % of the expected ground returned the laser"
    if wrong:
        return f"{found}: {wrong}"
    columns = max(int(counts.sum()), 1)
    used = int(counts[StripeStatus.OK] + counts[StripeStatus.SATURATED])
    bright = int(counts[StripeStatus.SATURATED] + counts[StripeStatus.AMBIGUOUS])
    beyond = int(counts[StripeStatus.OUT_OF_BAND])
    if columns - counts[StripeStatus.DROPOUT] < NO_LIGHT * columns:
        return (
            f"{found}, hardly any light came back: check that the laser is on, the mirror turns and the lens is clean"
        )
    if beyond > max(used, bright):
        return f"{found}, {beyond} columns show {WHERE_NONE_CAN_BE}"
    if weak:
        return f"{found}: {weak}"
    if bright > counts[StripeStatus.OK]:
        return f"{found}, most of what came back is too bright or double: expose less, or put a polarised lens on"
    return f"{found}, the rest is too dark or a hole: put a narrow band-pass filter on the lens or use a stronger laser"


def wrong_pattern(fired: Iterable[int], stride: int) -> str:
    """Text for a scan of which no two neighbours of its pattern were fired; empty when there are some."""
    indices = sorted(fired)
    if len(indices) < FEWEST_OF_PATTERN or np.diff(indices).min() <= stride:
        return ""
    return (
        "no two neighbours of the pattern were fired, and only ground between two such stripes counts as seen: every "
        'second stripe is missing, or a coarse scan was given mode "standard"'
    )


def regional_coverage(seen: Mask, expected: Mask) -> dict[str, float | None]:
    """Coverage of each ninth of the area, by names such as "far left"; None where nothing was expected."""
    result: dict[str, float | None] = {}
    ny, nx = seen.shape
    for i, along in enumerate(REGIONS_X):
        for j, across in enumerate(REGIONS_Y):
            part = np.s_[j * ny // 3 : (j + 1) * ny // 3, i * nx // 3 : (i + 1) * nx // 3]
            total = int(expected[part].sum())
            result[f"{along} {across}"] = float((seen & expected)[part].sum() / total) if total else None
    return result


def scan_record(
    *,
    geometry: ScanGeometry,
    robot: RobotModel,
    stance: Stance,
    pose: StancePose,
    mode: str,
    method: str,
    profiles: Mapping[int, StripeProfile],
    points: Mapping[int, StripePoints],
    layers: Mapping[str, Array],
    seconds: Mapping[str, float],
    samples: FrameSamples,
    mirrored_points: Callable[[], Mapping[int, StripePoints]],
    proof: Proof,
) -> ScanRecord:
    """Record of a scan; docs/files.md describes its fields."""
    from kinematics import describe_robot

    calibration, planned, settings = geometry.calibration, geometry.stripes, Settings.of(robot)
    bad = {index: profile.reason for index, profile in sorted(profiles.items()) if profile.is_frame_bad}
    counts = np.zeros(len(StripeStatus), dtype=np.int64)
    if points:
        status = np.concatenate([stripe.status for stripe in points.values()])
        counts[:] = [np.count_nonzero(status == np.uint8(each)) for each in StripeStatus]
    used = int(counts[StripeStatus.OK] + counts[StripeStatus.SATURATED])
    hazard = np.asarray(layers["hazard"], np.uint16)
    unknown = (hazard & UNKNOWN_MASK) != 0
    expected = ~((hazard & np.uint16(Hazard.UNSCANNED | Hazard.OCCLUDED | Hazard.SELF)) != 0)
    coverage = float((~unknown & expected).sum() / max(int(expected.sum()), 1))
    reasons = [f"stripe {index}: {reason}" for index, reason in bad.items() if index not in proof.unproved]
    if proof.unproved:
        reasons.append(
            f"{OTHER_INSTANT}, perhaps: no dark flash came after {len(proof.unproved)} stripes, which are not used"
        )
    missing = [index for index in planned if index not in profiles]
    if missing:
        reasons.append(f"{len(missing)} of {len(planned)} stripes were not fired")
    unused = samples.unused
    if unused:
        index, why = next(iter(unused.items()))
        reasons.append(
            f"flicker: for {len(unused)} of {len(profiles)} stripes the laser-off picture does not fit and "
            f"was not used (stripe {index}: {why}): {STEADY}"
        )
    if not expected.any():
        reasons.append("no part of the area was scanned")
    elif coverage < LOW_COVERAGE:
        wrong = samples.excess() or wrong_pattern(profiles, settings.pattern(mode).step)
        reasons.append(advice(coverage, counts, wrong or wrong_frames(samples, geometry), samples.lack()))
    else:
        reasons += filter(None, (mirrored_frames(points, mirrored_points, pose), samples.texture()))
    if sway := robot.pause_limits.stance_sway:
        reasons.append(
            f"the body may sway by {np.degrees(sway):.2f} degrees unseen (robot.toml, [pause] stance_sway): heights "
            "are less sure by that"
        )
    verdict = calibration.quality.get("verdict")
    if verdict == "refused":
        reasons.append("the calibration was refused and is used all the same")
    return ScanRecord(
        robot=robot.name,
        robot_description=describe_robot(robot),
        mode=mode,
        method=method,
        calibration_hash=calibration.hash,
        calibration_verdict=verdict,
        stance=stance,
        attitude_source=pose.attitude_source,
        support_feet_used=tuple(pose.support_feet_used),
        transform_base_to_footprint=np.asarray(pose.transform_base_to_footprint),
        transform_camera_to_base=calibration.transform_camera_to_base,
        laser_origin=geometry.sensor_origins[1],
        pose_covariance=np.asarray(pose.covariance),
        limits=settings.limits,
        validity_pauses=settings.validity_pauses,
        validity_seconds=settings.validity_seconds,
        stripes_planned=len(planned),
        stripes_used=len(points),
        stripes_missing=tuple(missing),
        frames_bad={str(index): reason for index, reason in bad.items()},
        off_pictures_unused={str(index): reason for index, reason in unused.items()},
        points={status.name: int(counts[status]) for status in StripeStatus},
        points_used=used,
        coverage=coverage,
        coverage_regions=regional_coverage(~unknown, expected),
        known=float((~unknown).mean()),
        hazard_cells=cells_by_flag(hazard),
        dark_flashes=proof.darks,
        health=Health("failed", (proof.refused,)) if proof.refused else Health.of(tuple(reasons)),
        seconds={name: round(value, 6) for name, value in seconds.items()},
        # An unjudged calibration is said too.
        extra={"calibration_verdict": None},
    )


def scan_drift(
    points: Mapping[int, StripePoints], mirrored_points: Callable[[], Mapping[int, StripePoints]], pose: StancePose
) -> Drift:
    """Drift check of a scan; see `ScanProcessor.drift`.

    Args:
        points: points of each stripe, by index.
        mirrored_points: computes the same points as if every frame had been mirrored left to right.
        pose: pose of the body over the ground.
    """
    drift = _check_drift(points, pose)
    if drift.verdict == DRIFTING and _check_drift(mirrored_points(), pose).verdict == HOLDS:
        return replace(drift, reasons=(MIRRORED, *drift.reasons))
    return drift


def mirrored_frames(
    points: Mapping[int, StripePoints], mirrored_points: Callable[[], Mapping[int, StripePoints]], pose: StancePose
) -> str:
    """MIRRORED where a scan of a flat floor fits its calibration only when its frames are mirrored, else empty."""
    some = dict(islice(points.items(), 0, None, max(len(points) // SUSPECTED, 1)))
    if _check_drift(some, pose).verdict != DRIFTING:
        return ""
    return MIRRORED if MIRRORED in scan_drift(points, mirrored_points, pose).reasons else ""


def _check_drift(stripes: Mapping[int, StripePoints], pose: StancePose) -> Drift:
    points = {index: stripe.points[::COLUMNS_APART] for index, stripe in stripes.items()}
    return check_drift(points, pose.covariance, pose.soles_in_footprint)


def wrong_frames(samples: FrameSamples, geometry: ScanGeometry) -> str:
    """Text that says how the frames are wrong: turned, flipped or out of order; empty when nothing is found."""
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
            else f"{int(other.sum())} of {len(indices)} frames looked at are"
        )
        return f"{which} {turn}: give them as the camera had them when it was calibrated"
    if own.mean() >= FITTING_SHARE:
        return ""
    for fit in (upright, likelier):
        if fit.fits.mean() >= FITTING_SHARE and fit.fine >= FINE_SHARE:
            order_text = _order_words(np.array(indices)[fit.fits], np.array(fit.stripe)[fit.fits])
            return f"{order_text} and {turn}" if fit is likelier else order_text
    return _elsewhere(geometry, indices, seen)


@dataclass(frozen=True, slots=True)
class _Fit:
    """Fit of the light of some frames to the lines of stripes, for one orientation.

    Attributes:
        name: the orientation, in words.
        stripe: index of the stripe that each frame fits best.
        fits: (f,) whether the frame fits that stripe.
        fine: share of the light near those stripes that lies within a third of the distance that counts as near; by
            chance it would be a third.
        distance: mean distance of the light from the best stripes [px], at most the distance that counts as near.
    """

    name: str
    stripe: Sequence[int]
    fits: Mask
    fine: float
    distance: float

    @classmethod
    def of(cls, name: str, seen: Float, rows: Float, order: Sequence[int], within: float) -> Self:
        """Fit rows of light (f, n) to rows of stripes (s, n), NaN for none."""
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
    """Text for frames that mostly show light where no stripe can be; empty otherwise."""
    bands = np.array([geometry.stripes[index].band for index in indices], np.float64)
    outside = ((seen < bands[:, :1]) | (seen >= bands[:, 1:])).sum(axis=1) > 0.5 * np.isfinite(seen).sum(axis=1)
    if outside.mean() < FITTING_SHARE:
        return ""
    return f"{int(outside.sum())} of {len(indices)} frames looked at show {WHERE_NONE_CAN_BE}"


def _expected(geometry: ScanGeometry, columns: Index) -> Float:
    """(s, n) row in which each stripe crosses some columns on ground at z = 0, NaN outside the picture."""
    y = np.linspace(-HALF_LENGTH_M, HALF_LENGTH_M, 41)
    rows = []
    for plane in geometry.planes_in_footprint:
        x = -(plane[1] * y + plane[3]) / plane[0]
        pixels = geometry.pixels(np.column_stack((x, y, np.zeros_like(y))))
        ordered = pixels[np.argsort(pixels[:, 0])]
        rows.append(np.interp(columns, ordered[:, 0], ordered[:, 1], left=np.nan, right=np.nan))
    return np.array(rows)


def _order_words(index: Index, stripe: Index) -> str:
    """Text on the difference between the stripes in the frames and the indices given with the frames."""
    off = stripe - index
    usual = int(np.median(off))
    if (np.abs(off - usual) <= 1).mean() > FITTING_SHARE:
        direction = "ahead" if usual > 0 else "behind"
        return f"the frames are {abs(usual)} stripe indices {direction}: a frame was lost or the camera lags"
    if np.corrcoef(index, stripe)[0, 1] < -0.8:
        return "the frames are in reverse order"
    return "the frames show other stripes than they are said to be: they are out of order, or of another pattern"
