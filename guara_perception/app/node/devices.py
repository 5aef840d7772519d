"""Chooses the rangefinder of a live command: the real devices of this machine, or simulated ones."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from drivers import AcquireOptions, LaserBoard, OffFrames, OpenCvCamera
from guara_perception.app.node.rangefinder import STRIPES_TOGETHER, Rangefinder
from guara_perception.calibration.calibration import Calibration
from guara_perception.calibration.file import load_calibration
from guara_perception.exceptions import InvalidInput
from kinematics import RobotModel, load_robot

if TYPE_CHECKING:
    from guara_perception.app.node.simulated import SimulatedRobot


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """What a live command works with.

    Attributes:
        robot: model.
        calibration: of the rangefinder.
        rangefinder: not yet open.
        simulation: behind it, None for real devices.
    """

    robot: RobotModel
    calibration: Calibration
    rangefinder: Rangefinder
    simulation: SimulatedRobot | None


def choose_rig(
    *,
    simulated: bool,
    calibration: Path | None,
    robot: str | None,
    camera: str,
    fps: float | None,
    off_frames: str,
) -> Rig:
    """Make the rig that the options of a command ask for.

    Args:
        simulated: simulated robot, world and devices.
        calibration: file; needed unless simulated.
        robot: name or folder; None = the calibration's, or the Guara.
        camera: number of the camera, device path, or a GStreamer pipeline.
        fps: frames per second to ask for, or None for the camera's own.
        off_frames: "one", "per stripe" or "none".

    Raises:
        InvalidInput: neither a calibration nor a simulation.
        MissingFile, FileFormatError: the calibration cannot be read.
        kinematics.KinematicsError: the robot cannot be loaded.
    """
    if simulated:
        from guara_perception.app.node.simulated import SimulatedRobot

        made = SimulatedRobot(robot or "guara", calibration)
        return Rig(made.robot, made.calibration, made.rangefinder, made)
    if calibration is None:
        raise InvalidInput("no calibration: give -c calibration.json (`guara calibrate` makes it), or --simulated")
    calibrated = load_calibration(calibration)
    model = load_robot(robot or calibrated.robot)
    return Rig(model, calibrated, _real(calibrated, camera, fps, off_frames), None)


def _real(calibration: Calibration, camera: str, fps: float | None, off_frames: str) -> Rangefinder:

    source: int | str = int(camera) if camera.isdigit() else camera
    return Rangefinder(
        board=LaserBoard(),
        camera=OpenCvCamera(source, size=calibration.camera.size, fps=fps),
        options=AcquireOptions(off=OffFrames(off_frames), together=STRIPES_TOGETHER),
    )
