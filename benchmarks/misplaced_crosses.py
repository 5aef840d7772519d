"""Effect of misplaced crosses on the grid: a session calibrated with wrong positions, one scan with each result.

`python -m benchmarks calibration crosses`, on the session and a scan of the tests.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

import guara_perception as gp
from benchmarks.command import Table, options
from guara_perception.app.files.calibration_session import open_session
from guara_perception.calibration.calibrate_session import calibrate_session
from guara_perception.calibration.calibration_input import CalibrationSession
from guara_perception.settings import Settings
from kinematics import RobotModel, load_robot

DATA = Path(__file__).resolve().parents[1] / "tests" / "data"
# A cell is floor when its height, with the right positions of the crosses, is within this of 0 [m].
FLOOR_M = 0.003


def shifted(x: float, y: float) -> Callable[[np.ndarray], np.ndarray]:
    """All crosses are off by the same vector [m]."""
    return lambda points: points + (x, y)


def turned(degrees: float) -> Callable[[np.ndarray], np.ndarray]:
    """All crosses are turned about the origin of base_footprint."""
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    return lambda points: points @ np.array([[c, s], [-s, c]])


def one_off(x: float) -> Callable[[np.ndarray], np.ndarray]:
    """The first cross alone is off, along x [m]."""
    return lambda points: points + np.outer(np.arange(len(points)) == 0, (x, 0.0))


CASES: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "all 2 mm too far ahead": shifted(0.002, 0.0),
    "all 5 mm to the left": shifted(0.0, 0.005),
    "all turned by 0.5 degrees": turned(0.5),
    "one 3 mm too far ahead": one_off(0.003),
}


def effect(
    session: CalibrationSession,
    scan: gp.Scan,
    robot: RobotModel,
    known: gp.Calibration,
    change: Callable[[np.ndarray], np.ndarray],
) -> tuple[float, float, float, float, str]:
    """Calibrate with changed positions of the crosses, and compare with the calibration `known`.

    Returns:
        How far two points of the area move: the centre of its near edge and its far left corner [m]; median change of
        the floor's height in the grid, and half of the range of that change over 90 % of the floor [m]; verdict of the
        calibration, with the first of its reasons.
    """
    marks = session.fiducials
    moved = replace(
        session, fiducials=replace(marks, points_in_footprint=change(np.asarray(marks.points_in_footprint)))
    )
    result = calibrate_session(moved, robot)
    wrong = result.calibration
    turn = wrong.transform_camera_to_base @ np.linalg.inv(known.transform_camera_to_base)
    to_base = np.linalg.inv(robot.stance_pose(session.stance).transform_base_to_footprint)
    settings = Settings.of(robot)
    x, y = settings.footprint_x, settings.footprint_y
    points = np.array([[x[0], 0.0, 0.0, 1.0], [x[1], y[1], 0.0, 1.0]]) @ to_base.T
    near, far = np.linalg.norm((points @ turn.T - points)[:, :2], axis=1)
    right, wrong_heights = (gp.process_scan(scan, each, robot, pictures=False).elevation for each in (known, wrong))
    is_floor = np.abs(right) < FLOOR_M
    change_of_height = (wrong_heights - right)[is_floor & np.isfinite(wrong_heights)]
    low, median, high = np.percentile(change_of_height, (5, 50, 95))
    verdict = ": ".join([result.verdict, *result.reasons[:1]])
    return float(near), float(far), float(median), float((high - low) / 2), verdict


def main() -> None:
    """Effect of misplaced crosses on the grid."""
    options(__doc__)
    robot = load_robot("guara")
    session, scan = open_session(DATA / "calibration"), gp.open_scan(DATA / "scans" / "paper")
    known = calibrate_session(session, robot).calibration
    head = "crosses: | near edge moves mm:.1f | far corner moves mm:.1f | floor's height mm:+.1f | over the area mm:.1f"
    table = Table(f"{head} | verdict:", markdown=True)
    for name, change in CASES.items():
        *lengths, verdict = effect(session, scan, robot, known, change)
        table.row(name, *(1e3 * np.array(lengths)), verdict)
