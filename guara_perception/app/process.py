"""Processing of a recorded scan, which is given as an object or a path."""

from __future__ import annotations

from pathlib import Path

from guara_perception.app.files.open_scan import calibration_for, open_scan
from guara_perception.calibration.calibration import Calibration
from guara_perception.calibration.file import load_calibration
from guara_perception.exceptions import InvalidInput
from guara_perception.progress import Progress
from guara_perception.scan import Scan
from guara_perception.scanning.pictures import with_pictures
from guara_perception.scanning.process import run_scan
from guara_perception.scanning.scan_surface import check_area
from guara_perception.settings import RobotLike, robot_model
from guara_perception.terrain.grid import TerrainGrid


def process_scan(
    scan: Scan | str | Path,
    calibration: Calibration | str | Path | None = None,
    robot: RobotLike | None = None,
    method: str = "precise",
    resolution: float | None = None,
    *,
    threshold: float | None = None,
    area: str = "footprint",
    pictures: bool = True,
    strict: bool = False,
    progress: Progress | None = None,
) -> TerrainGrid:
    """Compute the terrain grid of a recorded scan.

    Args:
        scan: scan from `open_scan`, or the path of a scan folder or an .mcap file with one scan.
        calibration: calibration of the rangefinder that recorded the scan, or the path of the calibration file; None =
            the calibration stored with the scan, if `scan` is a path.
        robot: model, name or folder of the robot that carried the rangefinder; None = the robot named in the scan.
        method: one of `guara_perception.scanning.stripe_finder.METHODS`.
        resolution: cell edge [m]; None = the robot's default.
        threshold: binarisation threshold of the paper's methods [8-bit grey levels]; None = chosen for each frame.
        area: "footprint"; or "wide", which is extended along y to the width of the robot's map, for
            `TerrainMap.update`.
        pictures: True to add the range images (`terrain.pictures`).
        strict: True to reject a scan with an unusable frame; False to leave the ground of its stripe unknown. If
            `scan` is the path of a folder, a missing frame is an error in either case.
        progress: called with (stripes done, total number of stripes), or None.

    Returns:
        TerrainGrid of a single scan; its `extent` is "footprint" for both areas.

    Raises:
        CalibrationMismatch: the scan or the calibration belongs to a robot other than `robot`, or the calibration does
            not match the camera, the image size or the stripes of the scan.
        InvalidInput: there is no calibration; the method or area is unknown, the threshold or resolution is invalid; a
            stance or a stripe index does not fit the robot; the camera moved during the scan; the node withdrew the
            grid of the scan; the path contains no scan or several; or, with `strict`, a frame is unusable.
        MissingFile, FileFormatError: scan or calibration is missing or invalid; a frame is missing from the given
            folder; no frame can be read; or, with `strict`, a frame cannot be read.
        kinematics.KinematicsError: the robot does not exist or cannot be loaded.
    """
    check_area(area)
    if not isinstance(scan, Scan):
        calibration = calibration if isinstance(calibration, Calibration) else calibration_for(scan, calibration)
        scan = open_scan(scan)
    elif calibration is None:
        raise InvalidInput(f"{scan.source}: give its calibration, which can only be omitted if the scan is a path")
    elif not isinstance(calibration, Calibration):
        calibration = load_calibration(calibration)
    robot = robot_model(scan.robot if robot is None else robot)
    processor = run_scan(
        scan, calibration, robot, method, resolution, threshold=threshold, strict=strict, progress=progress
    )
    terrain = processor.finish(area)
    return with_pictures(terrain, processor) if pictures else terrain
