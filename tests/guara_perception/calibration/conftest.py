"""One good calibration of the recorded session, and the means to break a copy of the session."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from guara_perception.app.calibration_session import open_session
from guara_perception.calibration.calibrate import calibrate_session
from guara_perception.calibration.result import CalibrationResult
from guara_perception.calibration.session import CalibrationSession, Plate
from kinematics import RobotModel

Picture = np.ndarray[Any, Any]
Change = Callable[[Picture], Picture]


@pytest.fixture(scope="session")
def session(data: Path) -> CalibrationSession:
    """The recorded session: 14 boards, four crosses, plates at 0, 40, 80 mm."""
    return open_session(data / "calibration")


@pytest.fixture(scope="session")
def result(session: CalibrationSession, robot: RobotModel) -> CalibrationResult:
    """What it gives; immutable."""
    return calibrate_session(session, robot)


def with_pictures(session: CalibrationSession, change: Callable[[str, Picture], Picture]) -> CalibrationSession:
    """The session with its still pictures changed as they are read."""
    return dataclasses.replace(session, read_picture=lambda name: change(name, session.read_picture(name)))


def with_plate(session: CalibrationSession, number: int, **changes: Any) -> CalibrationSession:
    """The session with one plate changed: `height`, or fields of its scan."""
    plates = list(session.plates)
    height = changes.pop("height", plates[number].height)
    plates[number] = Plate(plates[number].name, height, dataclasses.replace(plates[number].scan, **changes))
    return dataclasses.replace(session, plates=tuple(plates))


def with_frames(session: CalibrationSession, number: int, change: Change) -> CalibrationSession:
    """The session with every frame of one plate changed as it is read."""
    scan = session.plates[number].scan
    return with_plate(session, number, read_frame=lambda name: change(scan.read_frame(name)))
