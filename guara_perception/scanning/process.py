"""Processing of whole recorded scans."""

from __future__ import annotations

import logging
from collections.abc import Iterable

from guara_perception.calibration.calibration import Calibration, check_identity, format_indices
from guara_perception.exceptions import CalibrationMismatch, FileFormatError, InvalidInput, MissingFile
from guara_perception.progress import Progress
from guara_perception.ranging.scan_geometry import in_groups
from guara_perception.scan import Scan, frame_reader
from guara_perception.scanning.scan_processor import ScanProcessor
from guara_perception.settings import Settings
from guara_perception.stripes.band import FramePair
from kinematics import GravityEstimate, KinematicsError, RobotModel
from kinematics.stillness import check_camera_still

logger = logging.getLogger(__name__)

NO_CODE = "no dark flashes were recorded: light of other lasers and frames exposed at a wrong time cannot be detected"
# Difference of a mirror angle from the calibrated one above which a warning is logged [rad]. Commanded angles of one
# rangefinder repeat to 2e-5 rad; this difference turns the light by 1 mrad, which shifts the stripe by half a
# millimetre.
MIRROR_TOLERANCE = 5e-4


def run_scan(
    scan: Scan,
    calibration: Calibration,
    robot: RobotModel,
    method: str = "precise",
    resolution: float | None = None,
    *,
    threshold: float | None = None,
    strict: bool = False,
    progress: Progress | None = None,
    gravity: GravityEstimate | None = None,
) -> ScanProcessor:
    """Feed a recorded scan through a `ScanProcessor`, and return the processor.

    Args:
        scan: the recorded scan.
        calibration: calibration of its rangefinder.
        robot: robot of the scan.
        method, resolution, threshold, gravity: see `ScanProcessor`.
        strict: raise for an unusable frame instead of marking its stripe as bad.
        progress: called with the number of stripes done and their total.

    Raises:
        Errors as in `guara_perception.process_scan`.
    """
    _check_fit(scan, calibration, robot)
    scan.refuse_withdrawn()
    if scan.read_track is None:
        _check_still(scan, calibration, robot)
    try:
        track = None if scan.read_track is None else scan.read_track(robot, calibration.transform_camera_to_base)
        processor = ScanProcessor(
            calibration,
            robot,
            scan.stance,
            scan.mode,
            method=method,
            threshold=threshold,
            resolution=resolution,
            stamp=scan.end,
            step=scan.step,
            track=track,
            gravity=gravity,
        )
    except KinematicsError as error:
        raise InvalidInput(f"{scan.source}: stance: {error}") from error
    processor.expect_dark(scan.dark_after)
    if not scan.dark_after:
        logger.info("%s: %s", scan.source, NO_CODE)
    width, height = calibration.camera.size
    fitting = turned = done = 0
    unreadable: list[MissingFile | FileFormatError] = []
    read_stripe = frame_reader(scan)
    for group in in_groups(list(scan.stripes)):
        read: list[tuple[str, FramePair]] = []
        for stripe in group:
            try:
                read.append((stripe.on, read_stripe(stripe)))
            except (MissingFile, FileFormatError) as error:
                if strict:
                    raise
                unreadable.append(error)
                processor.mark_bad(stripe.index, str(error))
        profiles = processor.add_all([pair for _, pair in read])
        for (name, pair), profile in zip(read, profiles, strict=True):
            if strict and profile.is_frame_bad:
                raise InvalidInput(f"{scan.source}: frame {name}: {profile.reason}")
            fitting += pair.on.shape[:2] == (height, width)
            turned += pair.on.shape[:2] == (width, height)
        for _ in group:
            done += 1
            if progress is not None:
                progress(done, len(scan.stripes))
    if len(unreadable) == len(scan.stripes):
        raise unreadable[0]
    if not fitting:
        why = "the frames are turned by 90 degrees" if turned else "use the calibration of their camera"
        raise CalibrationMismatch(f"{scan.source}: no frame has the calibrated camera's {width}x{height} px: {why}")
    if processor.track_fault:
        _check_still(scan, calibration, robot)
        processor.leave_track()
    # Last, because a scan that is rejected needs no other warnings.
    _warn_of_differences(scan, calibration)
    return processor


def _check_still(scan: Scan, calibration: Calibration, robot: RobotModel) -> None:
    """Reject a scan during which the camera moved more than robot.toml allows."""
    if scan.stance_end is None:
        return
    try:
        check_camera_still(
            robot, scan.stance, scan.stance_end, transform_camera_to_base=calibration.transform_camera_to_base
        )
    except KinematicsError as error:
        raise InvalidInput(f"{scan.source}: stance_end: {error}") from error


def _check_fit(scan: Scan, calibration: Calibration, robot: RobotModel) -> None:
    """Reject a scan of another robot, camera or pattern, or with uncalibrated stripes."""
    if scan.robot != robot.name:
        raise CalibrationMismatch(
            f"{scan.source}: robot is {scan.robot!r}, but the given model is {robot.name!r}: use the robot of the scan"
        )
    check_identity(scan.camera_identity, calibration.camera.identity, scan.source)
    indices, pattern = {stripe.index for stripe in scan.stripes}, Settings.of(robot).pattern(scan.mode)
    if foreign := indices.difference(pattern):
        raise InvalidInput(
            f"{scan.source}: stripe index {_listed(foreign)} is not in the {scan.mode} pattern of {robot.name}: "
            f"{_listed(pattern)}"
        )
    if missing := indices.difference(calibration.indices):
        raise CalibrationMismatch(
            f"{scan.source}: stripe index {_listed(missing)} is not in the calibration, "
            f"which holds {_listed(calibration.indices)}: scan and calibration differ in rangefinder or pattern"
        )


def _warn_of_differences(scan: Scan, calibration: Calibration) -> None:
    """Warn of mirror angles and a calibration hash that differ from those of the calibration."""
    angles = {stripe.index: stripe.mirror_angle for stripe in scan.stripes}
    calibrated = {index: calibration.stripe(index).mirror_angle for index in angles}
    if moved := {index for index in angles if abs(angles[index] - calibrated[index]) > MIRROR_TOLERANCE}:
        logger.warning(
            "%s: mirror_angle of stripe index %s differs from the calibrated one by more than %g rad: heights are "
            "wrong if the mirror really had this angle",
            scan.source,
            _listed(moved),
            MIRROR_TOLERANCE,
        )
    recorded, used = scan.calibration_hash, calibration.hash
    if recorded and used and recorded != used:
        logger.warning("%s was recorded with calibration %s but is processed with %s", scan.source, recorded, used)


def _listed(indices: Iterable[int]) -> str:
    return format_indices(tuple(sorted(indices)))
