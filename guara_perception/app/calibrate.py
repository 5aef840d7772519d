"""Calibration from a session folder, or a refusal with its reasons."""

from __future__ import annotations

from pathlib import Path

from guara_perception.app.files.calibration_session import open_session
from guara_perception.calibration.calibrate import calibrate_session
from guara_perception.calibration.calibration import Calibration
from guara_perception.calibration.result import CalibrationResult
from guara_perception.exceptions import CalibrationRefused
from guara_perception.settings import RobotLike, robot_model


def calibrate(
    session_folder: str | Path,
    robot: RobotLike | None = None,
    *,
    distortion: str = "k1k2",
    not_mirrored: bool = False,
    force: bool = False,
) -> Calibration:
    """Calibrate camera, mount and laser from one session folder.

    Args:
        session_folder: a folder with `session.json` (docs/files.md).
        robot: its model, name or folder; None = the robot that the session names.
        distortion: lens coefficients to estimate: "k1k2", "k1k2p1p2" or "k1k2p1p2k3".
        not_mirrored: assert that the images are not mirrored, whatever the colours of the board.
        force: return a calibration whose verdict is `refused` instead of raising.

    Raises:
        CalibrationRefused: the verdict is `refused`, or a fault leaves nothing to compute; the message has the reasons.
        CalibrationMismatch: another robot, pictures of different sizes.
        MissingFile, FileFormatError, InvalidInput: the session cannot be read; the message names file and field.
        kinematics.KinematicsError: no such robot, or the stance does not fit it.
    """
    session = open_session(session_folder)
    model = robot_model(session.robot if robot is None else robot)
    result = calibrate_session(session, model, distortion=distortion, not_mirrored=not_mirrored)
    if not force:
        refuse(result)
    return result.calibration


def refuse(result: CalibrationResult) -> None:
    """Raise if the verdict is `refused`.

    Raises:
        CalibrationRefused: it is.
    """
    if result.verdict == "refused":
        raise CalibrationRefused(f"{result.session.source}: calibration refused: {'; '.join(result.reasons)}")
