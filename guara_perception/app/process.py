"""Processing of a recorded scan, given as an object or as a path."""

from __future__ import annotations

from pathlib import Path

from guara_perception.app.files.open_scan import open_scan
from guara_perception.app.files.scan_calibration import calibration_for
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
    """Process a recorded scan.

    Args:
        scan: the scan, as `open_scan` returns it, or the path of a folder or .mcap file with one scan.
        calibration: calibration of the rangefinder that recorded it, or the path of its file; None = the one that the
            folder or recording carries, where `scan` is a path.
        robot: model of the robot that carried it, or its name or folder; None = the one that the scan names.
        method: one of `guara_perception.scanning.stripe_finder.METHODS`.
        resolution: cell edge [m]; None = the robot's default.
        threshold: binarisation threshold of the paper's methods [grey levels of 8 bits]; None = chosen for each frame.
        area: "footprint", or "wide": as far along y as the robot's map, so that `TerrainMap.update` gets more ground.
        pictures: also draw the range images (`terrain.pictures`).
        strict: reject a scan with an unusable frame; otherwise the ground of its stripe stays unknown.
        progress: called with (stripes done, stripes in all).

    Returns:
        TerrainGrid of extent "footprint".

    Raises:
        CalibrationMismatch: robot, stripes or image size of scan and calibration do not match.
        InvalidInput: no calibration; unknown method or area, bad threshold or resolution, a stance or a stripe index
            that does not fit the robot; a scan whose grid the node withdrew; with `strict` a frame that cannot be used.
        MissingFile, FileFormatError: scan, calibration or robot is missing or invalid; a frame cannot be read
            (with `strict`), or none can.
        kinematics.KinematicsError: no such robot.
    """
    check_area(area)
    if not isinstance(calibration, Calibration):
        calibration = _calibration(scan, calibration)
    if not isinstance(scan, Scan):
        scan = open_scan(scan)
    robot = robot_model(scan.robot if robot is None else robot)
    processor = run_scan(
        scan, calibration, robot, method, resolution, threshold=threshold, strict=strict, progress=progress
    )
    terrain = processor.finish(area)
    return with_pictures(terrain, processor) if pictures else terrain


def _calibration(scan: Scan | str | Path, given: str | Path | None) -> Calibration:
    if not isinstance(scan, Scan):
        return calibration_for(scan, given)
    if given is None:
        raise InvalidInput(f"{scan.source}: give its calibration; only a path can be searched for one")
    return load_calibration(given)
