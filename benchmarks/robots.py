"""Any robot: how the stock quadruped URDFs of the package index load, become folders, are checked and walk.

`python -m benchmarks.robots [--no-walk] [NAME ...]`; needs the extra `robots-test`.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
import warnings
from dataclasses import dataclass
from pathlib import Path

from guara_perception.app.main import ENVIRONMENT

# As the command does: before numpy is loaded.
os.environ.update(ENVIRONMENT)

import cv2
import numpy as np

from benchmarks.urdf_reader import worst_difference
from guara_perception.app.robot_folder.check import check_robot
from guara_perception.app.robot_folder.finding import Weight
from guara_perception.app.robot_folder.new_robot import new_robot
from guara_perception.app.robot_folder.trial_walk import TrialWalk, trial_walk
from guara_perception.exceptions import PerceptionError
from kinematics import KinematicsError, load_robot
from kinematics.read_urdf import read_urdf
from tests.stock_robots import FILES, StockRobotsMissing, stock_urdf


@dataclass(frozen=True, slots=True)
class StockResult:
    """What came of one URDF.

    Attributes:
        name: of the robot.
        notes: things in the file that are not used, named in one warning.
        seconds: processor time of `robot new`.
        findings: of `robot check` that are more than notes.
        difference: of the stance pose from an independent reader, the largest number of the 4 x 4 matrices [m or -].
        walk: ten pauses in simulation, None where it was not asked for or nothing loads.
        error: why it ended early, empty when it did not.
    """

    name: str
    notes: int
    seconds: float
    findings: tuple[str, ...]
    difference: float
    walk: TrialWalk | None
    error: str

    @property
    def is_passed(self) -> bool:
        """Whether it loads, is sound, and walks where it was to walk."""
        return not self.error and not self.findings and (self.walk is None or self.walk.is_passed)


def stock_result(name: str, folder: Path, *, with_walk: bool) -> StockResult:
    """Make a folder of a stock URDF, check it, and let it walk.

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
        checked = check_robot(folder)
        findings = tuple(str(finding) for finding in checked.findings if finding.weight is not Weight.NOTE)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            robot = load_robot(folder)
        difference = worst_difference(robot, source)
        walk = trial_walk(robot) if with_walk else None
    except (PerceptionError, KinematicsError, UserWarning) as error:
        return StockResult(name, notes, seconds, (), float("nan"), None, f"{type(error).__name__}: {error}")
    return StockResult(name, notes, seconds, findings, difference, walk, "")


def line(result: StockResult) -> str:
    """One robot in one line."""
    if result.error:
        return f"{result.name:<13} {result.error}"
    text = (
        f"{result.name:<13} {result.notes} notes  new {result.seconds:4.1f} s  "
        f"{'sound' if not result.findings else f'{len(result.findings)} findings'}  stance {result.difference:.0e} m"
    )
    if result.walk is not None:
        walk = result.walk
        text += (
            f"  walk {walk.pauses} pauses, {walk.feet} feet, {walk.feet_on_hazard} on a hazard, "
            f"{walk.unknown_called_safe} unknown called safe, known {walk.known:.0%}"
        )
        text += f"  ended: {walk.ended}" if walk.ended else ""
    return "\n".join([text, *(f"    {finding}" for finding in result.findings)])


def main() -> None:
    """Print every robot and how many pass; exit 1 when a must is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", default=list(FILES), metavar="NAME", help=f"of: {', '.join(FILES)}")
    parser.add_argument("--no-walk", action="store_true", help="without the simulated walk (15 s of processor each)")
    options = parser.parse_args()
    unknown = sorted(set(options.names) - set(FILES))
    if unknown:
        parser.error(f"no stock robot {unknown[0]!r}; there are: {', '.join(FILES)}")
    cv2.setNumThreads(1)
    results = []
    with tempfile.TemporaryDirectory() as made:
        for name in options.names:
            try:
                results.append(stock_result(name, Path(made) / name, with_walk=not options.no_walk))
            except StockRobotsMissing as error:
                print(error, file=sys.stderr)
                sys.exit(2)
            print(line(results[-1]), flush=True)
    loaded = sum(not result.error for result in results)
    sound = sum(not result.error and not result.findings for result in results)
    print(f"{loaded} of {len(results)} load, {sound} are sound", end="")
    if not options.no_walk:
        walked = sum(result.walk is not None and result.walk.is_passed for result in results)
        print(f", {walked} walk ten pauses with nothing unknown called safe and no foot on a hazard", end="")
    worst = np.nanmax([result.difference for result in results], initial=0.0)
    print(f"; stance pose within {worst:.0e} m of yourdfpy's")
    sys.exit(0 if all(result.is_passed for result in results) else 1)


if __name__ == "__main__":
    main()
