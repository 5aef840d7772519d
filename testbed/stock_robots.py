"""Stock quadruped robots, from URDF files in the packages of the extra `robots-test`."""

from __future__ import annotations

import tempfile
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from guara_perception.app.robot_folder.new_robot import new_robot
from kinematics import RobotModel, load_robot

# Folder of each package, and package and path of each robot's URDF.
EXAMPLES, BULLET = "example-robot-data", "pybullet"
FOLDERS = {EXAMPLES: "cmeel.prefix/share/example-robot-data/robots", BULLET: "pybullet_data"}
FILES = {
    "a1": (EXAMPLES, "a1_description/urdf/a1.urdf"),
    "a1_bullet": (BULLET, "a1/a1.urdf"),
    "aliengo": (BULLET, "aliengo/aliengo.urdf"),
    "mini_cheetah": (BULLET, "mini_cheetah/mini_cheetah.urdf"),
    "laikago": (EXAMPLES, "laikago_description/urdf/laikago.urdf"),
    "vision60": (BULLET, "quadruped/vision60.urdf"),
    "spirit40": (BULLET, "quadruped/spirit40.urdf"),
    "go1": (EXAMPLES, "go1_description/urdf/go1.urdf"),
    "go2": (EXAMPLES, "go2_description/urdf/go2.urdf"),
    "b1": (EXAMPLES, "b1_description/urdf/b1.urdf"),
    "hyq": (EXAMPLES, "hyq_description/robots/hyq_no_sensors.urdf"),
    "anymal_b": (EXAMPLES, "anymal_b_simple_description/robots/anymal.urdf"),
    "anymal_c": (EXAMPLES, "anymal_c_simple_description/urdf/anymal.urdf"),
    "solo12": (EXAMPLES, "solo_description/robots/solo12.urdf"),
}


class StockRobotsMissing(RuntimeError):
    """A package with URDF files is not installed."""


def stock_urdf(name: str) -> Path:
    """Path of the URDF file of a robot.

    Raises:
        StockRobotsMissing: its package is not installed.
    """
    package, file = FILES[name]
    try:
        path = Path(str(distribution(package).locate_file(f"{FOLDERS[package]}/{file}")))
    except PackageNotFoundError:
        raise StockRobotsMissing(f"{package} is not installed; it comes with the extra `robots-test`") from None
    if not path.is_file():
        raise StockRobotsMissing(f"{package} has no {file}; install the version that the extra `robots-test` requires")
    return path


@lru_cache(maxsize=4)
def stock_robot(name: str) -> RobotModel:
    """Load the robot folder that `guara robot new` makes from the URDF of a robot.

    Raises:
        StockRobotsMissing: its package is not installed.
    """
    with tempfile.TemporaryDirectory() as folder:
        new_robot(stock_urdf(name), Path(folder) / name)
        return load_robot(Path(folder) / name)


def has_stock_robot(name: str) -> bool:
    """Check that the URDF of a robot is installed."""
    try:
        return stock_urdf(name).is_file()
    except StockRobotsMissing:
        return False
