"""Mirrored and turned pictures: verdicts on sessions and scans that a driver flips.

`python -m benchmarks calibration mirrored DATA ... [--scan NAME]`; its last line counts the mirrored grids called good.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

import guara_perception as gp
from benchmarks.command import options
from guara_perception.app.files.calibration_session import open_session
from guara_perception.arrays import Image
from guara_perception.calibration.calibrate_session import calibrate_session
from guara_perception.calibration.calibration_input import CalibrationSession
from kinematics import RobotModel, load_robot

Change = Callable[[Image], Image]
CHANGES: dict[str, Change] = {
    "left-right": lambda picture: picture[:, ::-1],
    "up-down": lambda picture: picture[::-1],
    "both axes": lambda picture: picture[::-1, ::-1],
    "turn 90": np.rot90,
}
MIRRORING = ("left-right", "up-down")


class Outcome(NamedTuple):
    """Outcome of one case.

    Attributes:
        case: what was changed, and how.
        said: verdict of the calibration, health of the grid, and reasons; or the message of the refusal.
        is_mirrored: True for a mirrored grid.
        is_called_good: True for a grid with a good calibration and the health ok.
    """

    case: str
    said: str
    is_mirrored: bool
    is_called_good: bool


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


def outcomes(session: CalibrationSession, scan: gp.Scan, robot: RobotModel) -> Iterator[Outcome]:
    """Outcomes of session, scan or both changed in each way; of the session with and without its board's colours."""
    boards = {session.board, dataclasses.replace(session.board, first_square=None)}
    for board in sorted(boards, key=lambda each: each.first_square or ""):
        kind = "" if board.first_square is None else f", first square {board.first_square}"
        coloured = dataclasses.replace(session, board=board)
        true = calibrate_session(coloured, robot).calibration
        for name, change in CHANGES.items():
            yield _outcome(f"scan {name}{kind}", true, changed_scan(scan, change), robot, name in MIRRORING)
            try:
                calibration = calibrate_session(changed_session(coloured, change), robot).calibration
            except gp.PerceptionError as error:
                yield Outcome(f"session {name}{kind}", f"refused: {error}", False, False)
                continue
            for where, seen in (("session", scan), ("both", changed_scan(scan, change))):
                yield _outcome(f"{where} {name}{kind}", calibration, seen, robot, name in MIRRORING)


def _outcome(case: str, calibration: gp.Calibration, scan: gp.Scan, robot: RobotModel, is_mirrored: bool) -> Outcome:
    verdict, reasons = calibration.quality["verdict"], calibration.quality["reasons"]
    try:
        health = gp.process_scan(scan, calibration, robot, pictures=False).metadata["health"]
    except gp.PerceptionError as error:
        return Outcome(case, f"refused: {error}", False, False)
    said = f"calibration {verdict}, grid {health['level']}: {'; '.join([*reasons, *health['reasons']])}"
    return Outcome(case, said, is_mirrored, verdict == "good" and health["level"] == "ok")


def main() -> None:
    """Verdicts about mirrored and turned pictures of DATA ... [--scan NAME]."""
    asked = options(
        main.__doc__,
        DATA=(Path, "data folders with calibration/ and scans/", {"nargs": "+"}),
        scan=("paper", "name of the scan"),
    )
    robot = load_robot("guara")
    cases = mirrored = good = 0
    for data in asked.data:
        session, scan = open_session(data / "calibration"), gp.open_scan(data / "scans" / asked.scan)
        for case, said, is_mirrored, is_called_good in outcomes(session, scan, robot):
            print(f"{data.name}: {case}: {said}", flush=True)
            cases, mirrored, good = cases + 1, mirrored + is_mirrored, good + (is_mirrored and is_called_good)
    print(f"{cases} cases; grids mirrored and called good: {good} of {mirrored}")
