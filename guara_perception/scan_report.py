"""What a scan says of itself: method, stance, coverage, bad frames, health; plain JSON values."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from guara_perception.arrays import Array, Float, Index, Mask
from guara_perception.calibration.calibration import Calibration
from guara_perception.light_diagnosis import STEADY, LightSamples
from guara_perception.ranging.stripe_points import StripePoints
from guara_perception.scan_diagnosis import WHERE_NONE_CAN_BE
from guara_perception.settings import Settings
from guara_perception.stripes.profile import StripeProfile, StripeStatus
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK, Hazard, cells_by_flag
from guara_perception.terrain.layers.record import Health, ScanRecord

if TYPE_CHECKING:
    from kinematics import RobotModel, Stance, StancePose

# Under this share of expected returns a scan says why and what helps.
LOW_COVERAGE = 0.5
# Under this share of columns with any light the laser was practically off.
NO_LIGHT = 0.01
# With fewer stripes nothing is concluded from every second one that is missing.
FEWEST_OF_PATTERN = 8
REGIONS_X, REGIONS_Y = ("near", "middle", "far"), ("right", "centre", "left")


def advice(coverage: float, counts: Index, wrong: str = "", weak: str = "") -> str:
    """One sentence on a scan with few returns: what happened and what helps, the paper's remedies included.

    Too much light, orientation, order and pattern come first, then whether stripes were found where they cannot be,
    weak, found but not usable, or not found.

    Args:
        coverage: share of the expected ground that was seen.
        counts: image columns of all stripes per StripeStatus.
        wrong: what is wrong with the light, the frames or the pattern as a whole; empty for nothing.
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
    """Seen over expected in each ninth of the area, by names such as "far left"; None where nothing was expected."""
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
    calibration: Calibration,
    robot: RobotModel,
    settings: Settings,
    stance: Stance,
    pose: StancePose,
    mode: str,
    method: str,
    profiles: Mapping[int, StripeProfile],
    points: Mapping[int, StripePoints],
    planned: Sequence[int],
    layers: Mapping[str, Array],
    laser_origin: Float,
    seconds: Mapping[str, float],
    wrong_frames: Callable[[], str] = lambda: "",
    light: LightSamples,
) -> ScanRecord:
    """What a scan says of itself; see docs/files.md for the fields."""
    from kinematics import describe_robot

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
    reasons = [f"stripe {index}: {reason}" for index, reason in bad.items()]
    missing = [index for index in planned if index not in profiles]
    if missing:
        reasons.append(f"{len(missing)} of {len(planned)} stripes were not fired")
    unused = light.unused
    if unused:
        index, why = next(iter(unused.items()))
        reasons.append(
            f"flicker: for {len(unused)} of {len(profiles)} stripes the laser-off picture does not fit and "
            f"was not used (stripe {index}: {why}): {STEADY}"
        )
    if not expected.any():
        reasons.append("no part of the area was scanned")
    elif coverage < LOW_COVERAGE:
        wrong = light.excess() or wrong_pattern(profiles, settings.pattern(mode).step) or wrong_frames()
        reasons.append(advice(coverage, counts, wrong, light.lack()))
    elif texture := light.texture():
        reasons.append(texture)
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
        laser_origin=laser_origin,
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
        health=Health.of(tuple(reasons)),
        seconds={name: round(value, 6) for name, value in seconds.items()},
        # An unjudged calibration is said too.
        extra={"calibration_verdict": None},
    )
