"""Record of a scan for its grid: provenance, counts, coverage and health."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from guara_perception.arrays import Array, Mask
from guara_perception.calibration.drift import DRIFTING, HOLDS, Drift, check_drift
from guara_perception.ranging.scan_geometry import ScanGeometry, StripePlace
from guara_perception.ranging.stripe_points import StripePoints
from guara_perception.scanning.background import MOVED
from guara_perception.scanning.coverage_diagnosis import advice, wrong_frames, wrong_pattern
from guara_perception.scanning.flash_proof import OTHER_INSTANT, Proof
from guara_perception.scanning.light_diagnosis import STEADY, FrameSamples
from guara_perception.scanning.scan_surface import ScanSurface
from guara_perception.settings import Settings
from guara_perception.stripes.band import StripeProfile, StripeStatus
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK, Hazard, cells_by_flag
from guara_perception.terrain.layers.record import Health, Run, ScanRecord
from kinematics import RobotModel, Stance, StancePose, describe_robot
from kinematics.stance_pose import support_soles

# Coverage below which the health states a cause and a remedy.
LOW_COVERAGE = 0.5
UNSEEN = (
    "a sway of the body cannot be detected: the light is too dim or unsteady, the ground has no texture, or there is "
    "no laser-off picture"
)
REGIONS_X, REGIONS_Y = ("near", "middle", "far"), ("right", "centre", "left")
MIRRORED = (
    "mirrored left to right, the frames fit the calibration: the camera or its driver mirrors them, so that left and "
    "right are exchanged"
)
# The drift check reads every fourth column. Neighbouring columns are smoothed together, so a quarter of them gives as
# much information in half the time.
COLUMNS_APART = 4
# Approximate number of stripes, spread over the scan, that decide whether all of it is checked for mirrored frames.
SUSPECTED = 12


def regional_coverage(seen: Mask, expected: Mask) -> dict[str, float | None]:
    """Coverage of each ninth of the area, by names such as "far left"; None where no ground was expected."""
    result: dict[str, float | None] = {}
    both, (ny, nx) = seen & expected, seen.shape
    for i, along in enumerate(REGIONS_X):
        for j, across in enumerate(REGIONS_Y):
            part = np.s_[j * ny // 3 : (j + 1) * ny // 3, i * nx // 3 : (i + 1) * nx // 3]
            total = int(np.count_nonzero(expected[part]))
            result[f"{along} {across}"] = int(np.count_nonzero(both[part])) / total if total else None
    return result


@dataclass(frozen=True, slots=True)
class Proved:
    """Stripes of a scan that its dark flashes, background and track confirm.

    Attributes:
        proof: findings on the light of the scan.
        profiles: profile of each stripe; those not confirmed are bad.
        surface: surface of the confirmed stripes.
        motion: description of detected motion during the scan, and reason why a track is not used; may be empty.
        may_sway: True if neither joint stream nor background can show whether the body sways.
        places: pose of camera and body at each stripe; None if all stripes have the pose of the stance.
    """

    proof: Proof
    profiles: Mapping[int, StripeProfile]
    surface: ScanSurface
    motion: str
    may_sway: bool
    places: Mapping[int, StripePlace] | None = None


def planned_record(
    geometry: ScanGeometry, robot: RobotModel, stance: Stance, pose: StancePose, mode: str, method: str
) -> ScanRecord:
    """Record of a scan before its first frame; docs/files.md describes its fields."""
    calibration, settings = geometry.calibration, Settings.of(robot)
    return ScanRecord(
        robot=robot.name,
        robot_description=describe_robot(robot),
        mode=mode,
        method=method,
        calibration_hash=calibration.hash,
        calibration_verdict=calibration.quality.get("verdict"),
        stance=stance,
        attitude_source=pose.attitude_source,
        attitude_sigma=pose.attitude_sigma,
        support_feet_used=pose.support_feet_used,
        support_soles=support_soles(pose, robot.noise),
        transform_base_to_footprint=pose.transform_base_to_footprint,
        transform_camera_to_base=calibration.transform_camera_to_base,
        laser_origin=geometry.sensor_origins[1],
        pose_covariance=pose.covariance,
        limits=settings.limits,
        validity_pauses=settings.validity_pauses,
        validity_seconds=settings.validity_seconds,
        stripes_planned=len(geometry.stripes),
        # Null if the calibration has no verdict.
        extra={"calibration_verdict": None},
    )


def scan_record(
    planned: ScanRecord,
    *,
    geometry: ScanGeometry,
    robot: RobotModel,
    proved: Proved,
    layers: Mapping[str, Array],
    seconds: Mapping[str, float],
    samples: FrameSamples,
    floor: FloorCheck,
    mirrored_points: Callable[[], Mapping[int, StripePoints]],
    lost_cells: tuple[Run, ...],
) -> ScanRecord:
    """Record of a scan: that of `planned_record`, completed with the results."""
    proof, profiles, motion = proved.proof, proved.profiles, proved.motion
    points, counts = proved.surface.stripes, proved.surface.counts
    bad = {index: profile.reason for index, profile in sorted(profiles.items()) if profile.is_frame_bad}
    hazard = np.asarray(layers["hazard"], np.uint16)
    unknown = (hazard & UNKNOWN_MASK) != 0
    expected = ~((hazard & np.uint16(Hazard.UNSCANNED | Hazard.OCCLUDED | Hazard.SELF)) != 0)
    coverage = int(np.count_nonzero(~unknown & expected)) / max(int(np.count_nonzero(expected)), 1)
    reasons = [
        f"stripe {index}: {reason}" for index, reason in bad.items() if index not in proof.unproved and reason != MOVED
    ]
    sway = robot.pause_limits.stance_sway
    if proved.may_sway:
        amplitude = f"up to {np.degrees(sway):.2f} degrees, which the variance of heights includes" if sway else "none"
        reasons.append(f"{UNSEEN}; robot.toml ([pause] stance_sway) allows for {amplitude}")
    if proof.unproved:
        reasons.append(
            f"{OTHER_INSTANT}, perhaps: {len(proof.unproved)} of {planned.stripes_planned} stripes not used, because "
            "no dark flash followed"
        )
    missing = [index for index in geometry.stripes if index not in profiles]
    if missing:
        reasons.append(f"{len(missing)} of {planned.stripes_planned} stripes were not fired")
    unused = samples.unused
    if unused:
        index, why = next(iter(unused.items()))
        reasons.append(
            f"flicker: the laser-off pictures of {len(unused)} of {len(profiles)} stripes do not fit and were not "
            f"used (stripe {index}: {why}): {STEADY}"
        )
    if not expected.any():
        reasons += filter(None, (motion, "no part of the area was scanned"))
    elif coverage < LOW_COVERAGE:
        stride = Settings.of(robot).pattern(str(planned.mode)).step
        wrong = motion or samples.excess() or wrong_pattern(profiles, stride) or wrong_frames(samples, geometry)
        reasons.append(advice(coverage, counts, wrong, samples.lack()))
    else:
        reasons += filter(None, (motion, floor.mirrored_frames(points, mirrored_points), samples.texture()))
    if planned.attitude_source == "support_plane":
        reasons.append(
            "levelled by the plane of the feet, since neither an IMU nor leg odometry gives gravity: level to "
            f"{np.degrees(planned.attitude_sigma or 0.0):.1f} degrees (one sigma)"
        )
    if planned.calibration_verdict == "refused":
        reasons.append("the calibration is used although its verdict is 'refused'")
    return replace(
        planned,
        stripes_used=len(points),
        stripes_missing=tuple(missing),
        frames_bad={str(index): reason for index, reason in bad.items()},
        off_pictures_unused={str(index): reason for index, reason in unused.items()},
        points={status.name: int(counts[status]) for status in StripeStatus},
        points_used=int(counts[StripeStatus.OK] + counts[StripeStatus.SATURATED]),
        lost_cells=lost_cells,
        coverage=coverage,
        coverage_regions=regional_coverage(~unknown, expected),
        known=float((~unknown).mean()),
        hazard_cells=cells_by_flag(hazard),
        dark_flashes=proof.darks,
        health=Health("failed", (proof.refused,)) if proof.refused else Health.of(tuple(reasons)),
        seconds={name: round(value, 6) for name, value in seconds.items()},
    )


def scan_drift(
    points: Mapping[int, StripePoints], mirrored_points: Callable[[], Mapping[int, StripePoints]], pose: StancePose
) -> Drift:
    """Drift check of a scan; see `ScanProcessor.drift`.

    Args:
        points: points of each stripe, by index.
        mirrored_points: computes the points from the same frames mirrored left to right.
        pose: pose of the body over the ground.
    """
    drift = _check_drift(points, pose)
    if drift.verdict == DRIFTING and _check_drift(mirrored_points(), pose).verdict == HOLDS:
        return replace(drift, reasons=(MIRRORED, *drift.reasons))
    return drift


class FloorCheck:
    """Detection of mirrored frames from the floor that a scan measured; the last verdict is cached."""

    def __init__(self, pose: StancePose) -> None:
        """Start a scan with the body at a pose over the ground."""
        self._pose, self._some, self._verdict = pose, list[StripePoints](), ""

    def verdict(self, points: Mapping[int, StripePoints]) -> str:
        """Verdict of the drift check on some of the stripes with these points."""
        some = dict(islice(points.items(), 0, None, max(len(points) // SUSPECTED, 1)))
        if list(map(id, some.values())) != list(map(id, self._some)):
            self._some, self._verdict = list(some.values()), _check_drift(some, self._pose).verdict
        return self._verdict

    def mirrored_frames(
        self, points: Mapping[int, StripePoints], mirrored_points: Callable[[], Mapping[int, StripePoints]]
    ) -> str:
        """MIRRORED if a scan of a flat floor fits the calibration only with mirrored frames; otherwise empty."""
        if self.verdict(points) != DRIFTING:
            return ""
        return MIRRORED if MIRRORED in scan_drift(points, mirrored_points, self._pose).reasons else ""


def _check_drift(stripes: Mapping[int, StripePoints], pose: StancePose) -> Drift:
    points = {index: stripe.points[::COLUMNS_APART] for index, stripe in stripes.items()}
    return check_drift(points, pose.covariance, pose.soles_in_footprint)
