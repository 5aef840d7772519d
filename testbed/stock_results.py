"""Test of a stock URDF: robot folder made from it, its check, and its stance pose compared with another reader."""

from __future__ import annotations

import time
import warnings
from dataclasses import dataclass
from pathlib import Path

from guara_perception.app.robot_folder.check import check_robot
from guara_perception.app.robot_folder.finding import Weight
from guara_perception.app.robot_folder.new_robot import new_robot
from guara_perception.exceptions import PerceptionError
from kinematics import KinematicsError, load_robot
from kinematics.read_urdf import read_urdf
from testbed.stock_robots import stock_urdf
from testbed.urdf_reader import worst_difference


@dataclass(frozen=True, slots=True)
class StockResult:
    """Result for one URDF.

    Attributes:
        name: name of the robot.
        notes: number of unused elements in the file, which one warning lists.
        seconds: processor time of `robot new` [s].
        findings: findings of `robot check` that are more than notes.
        difference: largest difference between the entries of the stance pose (4, 4) and those of an independent reader
            [m or -].
        error: error that ended the test; empty if there was none.
    """

    name: str
    notes: int
    seconds: float
    findings: tuple[str, ...]
    difference: float
    error: str

    @property
    def is_passed(self) -> bool:
        """True if the robot loads without errors and findings."""
        return not self.error and not self.findings


def stock_result(name: str, folder: Path) -> StockResult:
    """Make a robot folder from a stock URDF and check it.

    Raises:
        StockRobotsMissing: the package of the robot is not installed.
    """
    source = stock_urdf(name)
    notes, seconds = 0, float("nan")
    try:
        before = time.process_time()
        new_robot(source, folder)
        seconds = time.process_time() - before
        notes = len(read_urdf(source).notes)
        _, found = check_robot(folder)
        findings = tuple(str(finding) for finding in found if finding.weight is not Weight.NOTE)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            robot = load_robot(folder)
        difference = worst_difference(robot, source)
    except (PerceptionError, KinematicsError, UserWarning) as error:
        return StockResult(name, notes, seconds, (), float("nan"), f"{type(error).__name__}: {error}")
    return StockResult(name, notes, seconds, findings, difference, "")


def line(result: StockResult) -> str:
    """Format a result in one line, with further lines for its findings."""
    if result.error:
        return f"{result.name:<13} {result.error}"
    text = (
        f"{result.name:<13} {result.notes} notes  new {result.seconds:4.1f} s  "
        f"{'sound' if not result.findings else f'{len(result.findings)} findings'}  stance {result.difference:.0e} m"
    )
    return "\n".join([text, *(f"    {finding}" for finding in result.findings)])
