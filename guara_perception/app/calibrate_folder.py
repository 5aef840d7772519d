"""Calibration from a session folder, with an error if the verdict is `refused`."""

from __future__ import annotations

from pathlib import Path

from guara_perception.app.files.calibration_session import open_session
from guara_perception.app.files.camera_info import read_camera_info
from guara_perception.calibration.calibrate_session import calibrate_session
from guara_perception.calibration.calibration import Calibration
from guara_perception.calibration.result import CalibrationResult
from guara_perception.exceptions import CalibrationRefused
from guara_perception.progress import Progress
from guara_perception.settings import RobotLike, robot_model


def calibrate(
    session_folder: str | Path,
    robot: RobotLike | None = None,
    *,
    distortion: str = "k1k2",
    camera_info: str | Path | None = None,
    square: float | None = None,
    not_mirrored: bool = False,
    force: bool = False,
) -> Calibration:
    """Calibrate camera, mount and laser from a session folder.

    Args:
        session_folder: folder with `session.json` (docs/files.md).
        robot: model, name or folder of the robot; None = the robot named in the session.
        distortion: lens coefficients to estimate: "k1k2", "k1k2p1p2" or "k1k2p1p2k3".
        camera_info: file with known intrinsics (OpenCV, ROS or Kalibr); images of the board are then optional: they
            verify the intrinsics but do not change them. None = estimate the intrinsics.
        square: edge of the board's squares [m]; None = as in the session.
        not_mirrored: True to assert that the images are not mirrored; the colours of the board are then not checked.
        force: True to return a calibration even if its verdict is `refused`.

    Raises:
        CalibrationRefused: the verdict is `refused` and `force` is False, or no calibration can be computed; the
            message gives the reasons.
        CalibrationMismatch: the session belongs to another robot, images differ in size from each other or from
            the known intrinsics, or plates were scanned by different cameras.
        MissingFile, FileFormatError, InvalidInput: an argument is invalid, or the session cannot be read.
        kinematics.KinematicsError: the robot does not exist, or the stance does not fit it.
    """
    result = calibrate_folder(session_folder, robot, camera_info, square, distortion, not_mirrored)
    if not force:
        refuse(result)
    return result.calibration


def calibrate_folder(
    session_folder: str | Path,
    robot: RobotLike | None,
    camera_info: str | Path | None,
    square: float | None,
    distortion: str,
    not_mirrored: bool,
    progress: Progress | None = None,
) -> CalibrationResult:
    """Calibrate like `calibrate` with `force=True`, but return the complete result, for reports."""
    session = open_session(session_folder, square)
    model = robot_model(session.robot if robot is None else robot)
    camera = None if camera_info is None else read_camera_info(camera_info)
    return calibrate_session(
        session, model, distortion=distortion, camera=camera, not_mirrored=not_mirrored, progress=progress
    )


def refuse(result: CalibrationResult) -> None:
    """Raise an error if the verdict of a calibration is `refused`.

    Raises:
        CalibrationRefused: the verdict is `refused`; the message gives the reasons.
    """
    if result.verdict == "refused":
        raise CalibrationRefused(f"{result.session.source}: calibration refused: {'; '.join(result.reasons)}")
