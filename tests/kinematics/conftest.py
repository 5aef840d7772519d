"""Fixtures of the tests of kinematics: every robot, broken copies of a robot folder, and a kinematic crawl."""

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

import kinematics
from kinematics import RobotModel, Stance, load_robot
from kinematics.load import ROBOTS_FOLDER

SECOND_ROBOT = Path(__file__).parent.parent / "robots" / "tapir"
# Every robot folder of the repository; a new folder is tested without any change here.
ROBOT_FOLDERS = sorted(
    path.parent for path in (*ROBOTS_FOLDER.glob("*/robot.toml"), *SECOND_ROBOT.parent.glob("*/*.toml"))
)


@pytest.fixture(scope="session")
def guara() -> RobotModel:
    return load_robot("guara")


@pytest.fixture(scope="session")
def tapir() -> RobotModel:
    return load_robot(SECOND_ROBOT)


@pytest.fixture(scope="session", params=ROBOT_FOLDERS, ids=lambda folder: folder.name)
def robot(request: pytest.FixtureRequest) -> RobotModel:
    """Every robot of the repository; tests with this fixture run once per robot."""
    return load_robot(request.param)


@pytest.fixture
def broken_folder(guara: RobotModel, tmp_path: Path) -> Callable[..., Path]:
    """Copy of the Guará's folder in which one text of one file is replaced."""

    def make(file: str, old: str, new: str) -> Path:
        folder = tmp_path / "guara"
        shutil.copytree(guara.folder, folder, dirs_exist_ok=True)
        text = (folder / file).read_text(encoding="utf-8")
        assert old in text, f"{old!r} is not in {file}"
        (folder / file).write_text(text.replace(old, new, 1), encoding="utf-8")
        return folder

    return make


@pytest.fixture(scope="session")
def standing(robot: RobotModel) -> kinematics.StancePose:
    """Pose of the scan posture on all feet."""
    return robot.stance_pose(Stance(robot.posture(robot.config.scan_posture), robot.legs))


@pytest.fixture(scope="session")
def put_feet() -> Callable[..., dict[str, float]]:
    """Joint positions that place soles in `odom` for a given pose of the body, by inverse kinematics."""

    def joints(robot: RobotModel, soles: dict[str, np.ndarray], transform_base_to_odom: np.ndarray) -> dict[str, float]:
        positions: dict[str, float] = {}
        rotation = transform_base_to_odom[:3, :3]
        pitch = float(np.arctan2(rotation[2, 0], rotation[2, 2]))
        for leg, sole in soles.items():
            in_base = rotation.T @ (sole - transform_base_to_odom[:3, 3])
            found = robot.reach(leg, in_base, pitch)
            assert found.is_reachable, (leg, in_base)
            positions.update(zip(robot.tree.leg(leg).joints, found.joint_positions.tolist(), strict=True))
        return positions

    return joints


@pytest.fixture(scope="session")
def crawl(guara: RobotModel, put_feet: Callable[..., dict[str, float]]) -> Callable[..., Iterator[tuple]]:
    """Kinematic crawl on a flat floor; yields transform_base_to_odom, joint positions and the leg set down."""

    def walk(cycles: int, *, turn: float = 0.0, sway: float = 0.03) -> Iterator[tuple]:
        order, swing, height = ("rh", "rf", "lh", "lf"), 0.14, 0.36
        nominal = guara.state(guara.posture("scan"))
        soles = {leg: nominal.soles_in_base([leg])[0] * (1.0, 1.0, 0.0) for leg in guara.legs}
        for number, leg in enumerate(order):
            soles[leg] = soles[leg] + ((number - 1.5) * swing / 4.0, 0.0, 0.0)
        heading, position = 0.0, np.zeros(2)
        for _ in range(cycles):
            for leg in order:
                heading += turn / 4.0
                cosine, sine = np.cos(heading), np.sin(heading)
                position = position + swing / 4.0 * np.array([cosine, sine])
                rotation = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
                body = np.eye(4)
                body[:3, :3] = rotation
                body[:3, 3] = (*position, height)
                # Set down three eighths of a cycle ahead of the hip, in the present heading.
                hip = nominal.position_in_base(guara.tree.leg(leg).hip)
                ahead = rotation @ (hip + (3.0 * swing / 8.0, 0.0, 0.0)) + (*position, 0.0)
                soles[leg] = ahead * (1.0, 1.0, 0.0)
                shifted = body.copy()
                shifted[:3, 3] += rotation @ (0.0, -sway if leg[0] == "l" else sway, 0.0)
                yield shifted, put_feet(guara, soles, shifted), leg

    return walk
