"""Recorded scans with all their frames, the robot and its true calibration, read once for all tests."""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np

import guara_perception as gp
from kinematics import RobotModel, load_robot
from testbed.truth import truth_calibration

DATA = Path("tests/data")
Frames = tuple[int, np.ndarray, np.ndarray | None]


@functools.cache
def guara() -> RobotModel:
    """The robot."""
    return load_robot("guara")


@functools.cache
def truth() -> gp.Calibration:
    """The true calibration of the recorded scans."""
    return truth_calibration(DATA)


@functools.cache
def recorded_scan(name: str) -> tuple[gp.Scan, tuple[Frames, ...]]:
    """A scan and the frames of its stripes: index, laser on, laser off."""
    scan = gp.open_scan(DATA / "scans" / name)
    return scan, tuple((stripe.index, on, off) for stripe, on, off in scan.frames())
