"""What a stock URDF leads to: a folder, its check, its stance pose beside that of another reader."""

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
    """The result of one URDF.

    Attributes:
        name: name of the robot.
        notes: things in the file that are not used, named in one warning.
        seconds: processor time of `robot new`.
        findings: findings of `robot check` that are more than notes.
        difference: largest difference of the stance pose from that of an independent reader, over the entries of the 4
            x 4 matrices [m or -].
        error: why it ended early, empty when it did not.
    """

    name: str
    notes: int
    seconds: float
    findings: tuple[str, ...]
    difference: float
    error: str

    @property
    def is_passed(self) -> bool:
        """Whether it loads and is sound."""
        return not self.error and not self.findings


def stock_result(name: str, folder: Path) -> StockResult:
    """Make a folder of a stock URDF and check it.

    Raises:
        StockRobotsMissing: the packages of the extra are not installed.
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
    """One robot in one line."""
    if result.error:
        return f"{result.name:<13} {result.error}"
    text = (
        f"{result.name:<13} {result.notes} notes  new {result.seconds:4.1f} s  "
        f"{'sound' if not result.findings else f'{len(result.findings)} findings'}  stance {result.difference:.0e} m"
    )
    return "\n".join([text, *(f"    {finding}" for finding in result.findings)])
