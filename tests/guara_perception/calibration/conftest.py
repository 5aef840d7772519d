"""The recorded session and one good calibration of it, made once."""

import dataclasses
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from guara_perception.app.files.calibration_session import open_session
from guara_perception.calibration import calibrate_session
from guara_perception.calibration.board import BoardSpec, BoardView
from guara_perception.calibration.calibration_input import CalibrationSession
from guara_perception.calibration.result import CalibrationResult
from tests.calibrated_session import calibrated_session


@pytest.fixture(scope="session", autouse=True)
def boards_found_once() -> Iterator[None]:
    """Search each board once, since the sessions of these tests share most of their pictures."""
    real, found = calibrate_session.find_board, {}

    def once(picture: np.ndarray, board: BoardSpec, name: str = "") -> BoardView:
        key = picture.tobytes(), picture.shape, picture.dtype, board
        if key not in found:
            found[key] = real(picture, board, name)
        return dataclasses.replace(found[key], name=name)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(calibrate_session, "find_board", once)
        yield


@pytest.fixture(scope="session")
def session(data: Path) -> CalibrationSession:
    """The recorded session: 14 boards, four crosses, plates at 0, 40, 80 mm."""
    return open_session(data / "calibration")


@pytest.fixture(scope="session")
def few_stripes(session: CalibrationSession) -> CalibrationSession:
    """The same with every third stripe of its plates, for tests that do not depend on their number."""
    plates = (
        dataclasses.replace(plate, scan=dataclasses.replace(plate.scan, stripes=plate.scan.stripes[::3]))
        for plate in session.plates
    )
    return dataclasses.replace(session, plates=tuple(plates))


@pytest.fixture(scope="session")
def result(tmp_path_factory: pytest.TempPathFactory) -> CalibrationResult:
    """Calibration of the session; immutable."""
    return calibrated_session(tmp_path_factory)
