"""The recorded calibration session and what it gives, calibrated by one of the processes that share the tests."""

from __future__ import annotations

import dataclasses
import pickle
from pathlib import Path

import pytest

from guara_perception.app.files.calibration_session import open_session
from guara_perception.calibration.calibrate_session import calibrate_session
from guara_perception.calibration.result import CalibrationResult
from kinematics import load_robot
from tests.made_once import made_once

SESSION = Path(__file__).parent / "data" / "calibration"


def calibrated_session(factory: pytest.TempPathFactory) -> CalibrationResult:
    """What the whole session gives; immutable."""
    session = open_session(SESSION)

    def make(folder: Path) -> None:
        folder.mkdir()
        # The session reads its pictures by functions, which cannot be pickled.
        found = dataclasses.replace(calibrate_session(session, load_robot("guara")), session=None)  # type: ignore[arg-type]
        (folder / "result.pickle").write_bytes(pickle.dumps(found))

    folder = made_once(factory, "calibration-result", make)
    found: CalibrationResult = pickle.loads((folder / "result.pickle").read_bytes())
    return dataclasses.replace(found, session=session)
