"""Errors of heights after the mount has moved.

`python -m benchmarks calibration mount`. Calibration measures the mount as it was built, so a constant error costs
nothing; what counts is what changes afterwards: a loose screw, a shifted home switch, a mirror that has not
settled.

The recorded frames are those of the mount as it was calibrated. Heights are computed from them with the calibration of
the moved mount; on a robot it is the other way round, frames of the moved mount and the calibration from before, and
for changes this small its error is the same with the opposite sign. The robot's error is what is printed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import guara_perception as gp
from benchmarks.command import Table, options
from guara_perception.simulation.specimen import rotation
from testbed import scenes
from testbed.moved_mount import moved, moved_about

SCAN = Path(__file__).resolve().parents[1] / "tests" / "data" / "scans" / "paper"
# The mirror's axis in base_link [m], parallel to y.
AXIS = np.array([0.600, 0.0, 0.110])
# One step of the mirror's motor [rad of the mirror].
MOTOR_STEP = 490874e-9


@dataclass(frozen=True, slots=True)
class Change:
    """A change of the mount: of every laser plane, and of the camera.

    Attributes:
        name: what the table calls it.
        mirror_turn: angle by which the laser planes turn about the mirror's axis [rad].
        tilt: angle by which they turn about x [rad].
        shift: vector by which they move in base_link [m].
        pitch: angle by which camera and laser planes turn together about y [rad].
        camera_shift: distance by which the camera alone moves upwards [m].
    """

    name: str
    mirror_turn: float = 0.0
    tilt: float = 0.0
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    pitch: float = 0.0
    camera_shift: float = 0.0


CHANGES = (
    Change("home switch off by one step", mirror_turn=2 * MOTOR_STEP),
    Change("mirror not settled by a tenth of a stripe", mirror_turn=2 * 0.00068),
    Change("mirror axis tilted by 0.1 degrees", tilt=np.radians(0.1)),
    Change("laser and mirror 0.2 mm forward", shift=(0.0002, 0.0, 0.0)),
    Change("laser and mirror 0.2 mm up", shift=(0.0, 0.0, 0.0002)),
    Change("camera 0.2 mm up, laser not", camera_shift=0.0002),
    Change("whole head pitched by 0.1 degrees", pitch=np.radians(0.1)),
)


def changed(calibration: gp.Calibration, change: Change) -> gp.Calibration:
    """The calibration of the mount after a change."""
    head = moved_about(rotation((0.0, change.pitch, 0.0)), calibration.transform_camera_to_base[:3, 3])
    lift = moved_about(np.eye(3), np.zeros(3), (0.0, 0.0, change.camera_shift))
    turn = rotation((change.tilt, 0.0, 0.0)) @ rotation((0.0, -change.mirror_turn, 0.0))
    return moved(calibration, camera=head @ lift, laser=head @ moved_about(turn, AXIS, change.shift))


def heights(scan: scenes.ScanInMemory, calibration: gp.Calibration) -> np.ndarray:
    """The elevation that the frames of a scan give with a calibration [m]."""
    processor = replace(scan, calibration=calibration).processor()
    processor.add_all([gp.FramePair(*frames) for frames in scan.frames])
    return processor.finish().elevation


def measure(scan: scenes.ScanInMemory) -> list[tuple[str, float, float]]:
    """Rows (name of the change, median error of a robot's heights after it, scatter of that error) [m].

    The scatter is 1.4826 times the median absolute deviation.
    """
    right = heights(scan, scan.calibration)
    rows = []
    for change in CHANGES:
        error = right - heights(scan, changed(scan.calibration, change))
        known = error[np.isfinite(error)]
        median = float(np.median(known))
        rows.append((change.name, median, 1.4826 * float(np.median(np.abs(known - median)))))
    return rows


def main() -> None:
    """Errors of heights after the mount has moved."""
    options(__doc__)
    table = Table("change after calibration:<42 | median error mm:+.2f | scatter mm:.2f")
    for name, offset, scatter in measure(scenes.recorded(SCAN)):
        table.row(name, 1e3 * offset, 1e3 * scatter)
