"""Scan without a calibration, for instance of a plate: pattern from robot.toml, verification on whole frames."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from drivers import LightCheck
from guara_perception.app.files.scan_folder import ScanFolderWriter
from guara_perception.app.node.rangefinder import FiringOrder, Rangefinder
from guara_perception.arrays import Image
from guara_perception.exceptions import MirrorSlipped, PerceptionError
from guara_perception.settings import Settings
from kinematics import RobotModel, Stance

# [s] Longest wait for the frame that gives the size of the images.
FRAME_SECONDS = 2.0


class PlateScanFailed(PerceptionError, RuntimeError):
    """Failed or incomplete scan without a calibration; the message gives the reason."""


def nominal_order(robot: RobotModel, mode: str = "standard") -> FiringOrder:
    """Firing order of (index, mirror angle [rad]) from `[scan]` of robot.toml, for a scan without a calibration."""
    settings = Settings.of(robot)
    angles = np.linspace(*settings.mirror_angles, settings.stripes)
    return [(index, float(angles[index])) for index in settings.pattern(mode)]


def scan_uncalibrated(
    rangefinder: Rangefinder,
    robot: RobotModel,
    stance: Stance,
    folder: Path,
    *,
    mode: str = "standard",
    on_stripe: Callable[[Image, int, int], None] | None = None,
) -> tuple[str, ...]:
    """Record one scan to a scan folder. Whole frames are verified, since the bands of the stripes are not known.

    Before the first stripe, the camera's locked settings are read back, since all plates must be scanned with the
    settings of their session. The light is checked in the first frames.

    Args:
        rangefinder: open devices.
        robot: robot whose pattern is swept.
        stance: stance of the robot.
        folder: scan folder to create.
        mode: "standard" or "coarse".
        on_stripe: called with the laser-on frame of each stripe, its number from 1, and the total number of stripes.

    Returns:
        Problems of the light, as sentences. The scan is nevertheless complete.

    Raises:
        PlateScanFailed: a setting has changed since it was locked or cannot be read, or a frame was lost or does not
            show its stripe.
        InvalidInput: the mode is unknown, the folder exists, or its parent folder does not exist.
        MirrorSlipped: the mirror lost steps.
        drivers.DriverError: a device failed.
    """
    changes = rangefinder.setting_changes()
    if changes:
        raise PlateScanFailed(f"{folder.name}: {'; '.join(changes)}")
    order = nominal_order(robot, mode)
    rangefinder.lost_steps(order)
    rows = np.asarray(rangefinder.camera.grab(FRAME_SECONDS).image).shape[0]
    stamp, done, light = time.time_ns(), 0, LightCheck()
    with ScanFolderWriter(folder) as writer:
        stripes = rangefinder.sweep(order, lambda index: (0, rows), lambda: False)
        with stripes:
            for group in stripes.groups():
                for capture in group:
                    if capture.on is None or not capture.verdict.in_step:
                        raise PlateScanFailed(
                            f"{folder.name}: stripe {capture.index}: frame {capture.verdict.value}; scan again"
                        )
                    light.look(capture, (0, rows))
                    writer.add(capture.index, capture.mirror_angle, capture.on, capture.off, dark=capture.dark)
                    done += 1
                    if on_stripe is not None:
                        on_stripe(capture.on, done, len(order))
        lost = rangefinder.lost_steps(order)
        if lost:
            raise MirrorSlipped(f"{folder.name}: steps lost by the mirror during the scan: {lost}; is it blocked?")
        writer.finish(
            robot=robot.name,
            mode=mode,
            stamp=stamp,
            step=0,
            stance=stance,
            dark_after=stripes.dark_after,
            camera_identity=rangefinder.camera.identity,
        )
    return light.problems
