"""Sessions and scans whose pictures a driver mirrors or turns: all are recognised, and no mirrored grid is good."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.app.files.calibration_session import open_session
from guara_perception.arrays import Image
from guara_perception.calibration.calibrate_session import calibrate_session
from guara_perception.calibration.calibration_input import CalibrationSession
from kinematics import RobotModel

Change = Callable[[Image], Image]
CHANGES: dict[str, Change] = {
    "left-right": lambda picture: picture[:, ::-1],
    "up-down": lambda picture: picture[::-1],
    "both axes": lambda picture: picture[::-1, ::-1],
    "turn 90": np.rot90,
}
SCANS = {
    "left-right": "grid degraded: .*mirrored left to right",
    "up-down": "grid degraded: .*frames are flipped top to bottom",
    "both axes": "grid degraded: .*frames are turned by 180 degrees",
    "turn 90": "refused: .*frames are turned by 90 degrees",
}
# Without and with known colours of the board.
SESSIONS = {
    "left-right": ("calibration usable.*look the same in mirrored pictures", "refused: .*pictures are mirrored"),
    "up-down": ("refused: .*rolled by 180 degrees.*bottom-up", "refused: .*pictures are mirrored"),
    "both axes": ("refused: .*rolled by 180 degrees.*upside down", "calibration usable.*rolled by 180 degrees"),
    "turn 90": ("refused: .*crosses is turned by 90 degrees",) * 2,
}


def changed_scan(scan: gp.Scan, change: Change) -> gp.Scan:
    """The scan as a driver that changes its frames records it."""
    return dataclasses.replace(scan, read_frame=lambda name: np.ascontiguousarray(change(scan.read_frame(name))))


def changed_session(session: CalibrationSession, change: Change) -> CalibrationSession:
    """The session as a driver that changes all pictures records it."""
    plates = tuple(dataclasses.replace(plate, scan=changed_scan(plate.scan, change)) for plate in session.plates)
    read = session.read_picture
    return dataclasses.replace(
        session, plates=plates, read_picture=lambda name: np.ascontiguousarray(change(read(name)))
    )


def outcome(calibration: gp.Calibration, scan: gp.Scan, robot: RobotModel) -> str:
    """Verdict of the calibration, health of the grid and reasons, or the message of the refusal."""
    quality = calibration.quality
    try:
        health = gp.process_scan(scan, calibration, robot, pictures=False).metadata["health"]
    except gp.PerceptionError as error:
        return f"refused: {error}"
    reasons = "; ".join([*quality["reasons"], *health["reasons"]])
    return f"calibration {quality['verdict']}, grid {health['level']}: {reasons}"


def outcomes(session: CalibrationSession, scan: gp.Scan, robot: RobotModel) -> Iterator[tuple[str, str, str]]:
    """Changed part, change and outcome, with scan, session or both changed."""
    true = calibrate_session(session, robot).calibration
    for name, change in CHANGES.items():
        yield "scan", name, outcome(true, changed_scan(scan, change), robot)
        try:
            calibration = calibrate_session(changed_session(session, change), robot).calibration
        except gp.PerceptionError as error:
            yield "session", name, f"refused: {error}"
            continue
        yield "session", name, outcome(calibration, scan, robot)
        yield "both", name, outcome(calibration, changed_scan(scan, change), robot)


@pytest.mark.heavy
def test_no_mirrored_grid_is_called_good(data: Path, robot: RobotModel) -> None:
    """Each change is named; where one makes a mirrored grid or a turned one, that is not called good."""
    session, scan = open_session(data / "calibration"), gp.open_scan(data / "scans" / "paper")
    mirrored, cases = set(), 0
    for known, first_square in enumerate((None, "white")):
        board = dataclasses.replace(session.board, first_square=first_square)
        for part, change, said in outcomes(dataclasses.replace(session, board=board), scan, robot):
            cases += 1
            assert not said.startswith("calibration good, grid ok"), (part, change)
            if part != "both":
                expected = SCANS[change] if part == "scan" else SESSIONS[change][known]
                assert re.search(expected, said), (part, change)
            if change in ("left-right", "up-down") and said.startswith("calibration"):
                mirrored.add((part, change, first_square))
    # Of a mirrored session no grid is made once the board's colours are known.
    assert mirrored == {
        *(("scan", change, square) for change in ("left-right", "up-down") for square in (None, "white")),
        *((part, "left-right", None) for part in ("session", "both")),
    }
    assert (cases, len(mirrored)) == (18, 6)
