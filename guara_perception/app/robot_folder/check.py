"""Checks a robot folder: lists everything that is wrong or doubtful in it."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from guara_perception.app.robot_folder.body_checks import body_findings
from guara_perception.app.robot_folder.finding import Finding, Weight, note, wrong
from guara_perception.app.robot_folder.scan_checks import scan_findings
from guara_perception.app.robot_folder.trial_walk import TrialWalk
from guara_perception.exceptions import FileFormatError, PerceptionError
from guara_perception.settings import Settings
from kinematics import KinematicsError, RobotFileError, RobotFileWarning, RobotModel, load_robot


@dataclass(frozen=True, slots=True, eq=False)
class RobotCheck:
    """The robot of a folder and what is wrong or doubtful in it.

    Attributes:
        robot: the robot; None where it does not load.
        findings: what was found, the gravest first.
    """

    robot: RobotModel | None
    findings: tuple[Finding, ...]

    @property
    def worst(self) -> Weight:
        """The gravest weight of all findings; NOTE where there are none."""
        weights = [finding.weight for finding in self.findings]
        return next((weight for weight in Weight if weight in weights), Weight.NOTE)


def check_robot(folder: Path) -> RobotCheck:
    """Check a robot folder, or a robot by name."""
    findings: list[Finding] = []
    robot: RobotModel | None = None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RobotFileWarning)
            robot = load_robot(folder)
        Settings.of(robot)
    except (RobotFileError, FileFormatError) as error:
        findings += [Finding(Weight.UNUSABLE, *_subject_and_text(text)) for text in error.findings]
    except (KinematicsError, PerceptionError) as error:
        findings.append(Finding(Weight.UNUSABLE, str(folder), str(error)))
    if robot is None or findings:
        return RobotCheck(robot, tuple(findings))
    with warnings.catch_warnings():
        # A joint beyond its limits is a finding of its own.
        warnings.simplefilter("ignore")
        findings += [*_file_findings(robot), *body_findings(robot), *scan_findings(robot)]
    order = list(Weight)
    return RobotCheck(robot, tuple(sorted(findings, key=lambda finding: order.index(finding.weight))))


def _subject_and_text(text: str) -> tuple[str, str]:
    """Split a finding of `load_robot` into file with line and what is wrong there."""
    subject, separator, rest = text.partition(": ")
    return (subject, rest) if separator else ("robot folder", text)


def _file_findings(robot: RobotModel) -> Iterator[Finding]:
    for text in robot.notes:
        yield wrong("urdf", text) if "left without its shape" in text else note("urdf", f"not used: {text}")
    for text in robot.doubts:
        subject, _, rest = text.partition(": ")
        yield wrong(f"robot.toml {subject}", rest)
    for key, what in robot.config.assumed.items():
        yield note(f"robot.toml [assumed] {key}", f"nobody has measured it: {what}")


def walk_findings(walk: TrialWalk) -> Iterator[Finding]:
    """What a simulated walk shows to be wrong."""
    if walk.ended is not None:
        yield wrong("simulated walk", f"ended after {walk.pauses} pauses: {walk.ended}")
    if walk.unknown_called_safe:
        yield wrong("simulated walk", f"{walk.unknown_called_safe} unknown cells were called traversable")
    if walk.feet_on_hazard:
        yield wrong("simulated walk", f"{walk.feet_on_hazard} of {walk.feet} feet were set on a hazard")
