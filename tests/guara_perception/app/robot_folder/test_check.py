"""`guara robot check` names every fault of a robot folder, with the exit code of its severity."""

from __future__ import annotations

import dataclasses
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from guara_perception.app.main import run
from guara_perception.app.robot_folder.check import check_robot, walk_findings
from guara_perception.app.robot_folder.finding import Weight
from guara_perception.app.robot_folder.show import robot_moment
from guara_perception.app.robot_folder.trial_walk import TrialWalk, trial_walk
from kinematics import load_robot
from testbed.altered_robot import altered_guara

ROOT = Path(__file__).parents[4]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Copy of the Guará's folder that a test may damage."""
    return Path(shutil.copytree(ROOT / "robots" / "guara", tmp_path / "guara"))


# Edits of files and the resulting findings; WRONG exits 1, UNUSABLE exits 2.
SPOILED = {
    "sole frame 20 mm too high": (
        "urdf/guara.urdf",
        r'<origin xyz="0 0 -0.100"',
        '<origin xyz="0 0 -0.080"',
        "mm above the lowest point of its foot",
        Weight.UNUSABLE,
    ),
    "pattern off the area": (
        "robot.toml",
        r"mirror_angle_last = 0\.325",
        "mirror_angle_last = 0.200",
        "the pattern sweeps x = 0.495 to",
        Weight.WRONG,
    ),
    "camera that looks backwards": (
        "urdf/guara.urdf",
        r'rpy="3.141592653589793 1.029744258676654 0"',
        'rpy="3.141592653589793 1.9 0"',
        "of the scanned area is out of view",
        Weight.WRONG,
    ),
    "camera behind the body": (
        "robot.toml",
        r'camera = "camera_optical_frame"',
        'camera = "imu_link"',
        "camera_height is",
        Weight.UNUSABLE,
    ),
    "laser across": (
        "urdf/guara.urdf",
        r'<origin xyz="0.600 0 0.110" rpy="0 0 0"/>',
        '<origin xyz="0.600 0 0.110" rpy="0 0 1.57"/>',
        "is not parallel to y of the base",
        Weight.WRONG,
    ),
    "a body that hides the area": (
        "urdf/guara.urdf",
        r'<geometry><box size="0.60 0.40 0.05"/></geometry>\s*</collision>',
        '<geometry><box size="1.02 0.40 0.05"/></geometry></collision>',
        "hides",
        Weight.WRONG,
    ),
    "camera inside a shape": (
        "urdf/guara.urdf",
        r'<geometry><box size="0.60 0.40 0.05"/></geometry>\s*</collision>',
        '<geometry><box size="1.00 0.40 0.30"/></geometry></collision>',
        "lies inside the shape of link 'base_link'",
        Weight.WRONG,
    ),
    "short joints": (
        "urdf/guara.urdf",
        r'lower="0" upper="2.2"',
        'lower="0.7" upper="1.2"',
        "positions of the gait around the standing foot",
        Weight.WRONG,
    ),
    "a heavy camera": (
        "urdf/guara.urdf",
        r'<link name="laser_link">',
        '<link name="laser_link"><inertial><mass value="20"/></inertial>',
        "inside the polygon of the soles",
        Weight.WRONG,
    ),
    "legs that touch": (
        "urdf/guara.urdf",
        r'<box size="0.08 0.06 0.02"/></geometry>\s*</collision>',
        '<box size="0.70 0.06 0.02"/></geometry></collision>',
        "touch: choose another posture",
        Weight.WRONG,
    ),
    "a mesh that is not there": (
        "urdf/guara.urdf",
        r'<box size="0.60 0.40 0.05"/></geometry>\s*</collision>',
        '<mesh filename="body.stl"/></geometry></collision>',
        "link 'base_link': a mesh is not used, so the self-filter",
        Weight.WRONG,
    ),
    "limits of nothing": (
        "robot.toml",
        r"slope_limit = 0\.35",
        "slope_limit = 9.0",
        "slope_limit is 9.0",
        Weight.UNUSABLE,
    ),
}


@pytest.mark.parametrize("case", SPOILED)
def test_what_is_wrong_is_found(case: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One fault in a sound folder: it is named, with the exit code of its severity."""
    file, old, new, message, weight = SPOILED[case]
    text, count = re.subn(old, new, (folder / file).read_text())
    assert count
    (folder / file).write_text(text)
    assert run(["robot", "check", str(folder)]) == (2 if weight is Weight.UNUSABLE else 1)
    printed = capsys.readouterr().out
    assert any(line.startswith(f"{weight.value}: ") and message in line for line in printed.splitlines()), printed


def test_the_robots_of_this_repository_are_sound(folder: Path) -> None:
    """The Guará has no finding; the tapir's round feet are off by 4 mm, because its frames are along the shanks."""
    assert all(finding.weight is Weight.NOTE for finding in check_robot(folder)[1])
    _, found = check_robot(ROOT / "tests" / "robots" / "tapir")
    wrong = [finding for finding in found if finding.weight is not Weight.NOTE]
    assert len(wrong) == 4 and all("4.0 mm above the lowest point" in finding.text for finding in wrong)


def test_a_pattern_beyond_the_travel_of_the_board_is_noted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """For a mirror far ahead of the area: the folder is sound, but the firmware must be configured for it."""
    folder = altered_guara(tmp_path, ("mirror_angle_first = -0.110", "mirror_angle_first = -0.310"))
    assert run(["robot", "check", str(folder)]) == 0
    noted = [line for line in capsys.readouterr().out.splitlines() if "but the firmware of this project" in line]
    assert len(noted) == 1 and noted[0].startswith(
        "note: robot.toml [scan]: the mirror turns from -17.8 to 18.6 degrees"
    )
    assert "from -15.0 to 25.0: set MIN_STEP, MAX_STEP and ZERO_STEP" in noted[0]
    assert run(["robot", "check", "guara"]) == 0
    assert "MIN_STEP" not in capsys.readouterr().out


def test_a_folder_without_robot_is_unusable(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Exit 2 with the names of the available robots."""
    assert run(["robot", "check", str(tmp_path)]) == 2
    assert "one of the names guara" in capsys.readouterr().out


@pytest.mark.slow
def test_findings_as_json(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One object with the verdict and every finding; the exit code is the same as with text."""
    toml = folder / "robot.toml"
    toml.write_text(toml.read_text().replace("mirror_angle_last = 0.325", "mirror_angle_last = 0.200"))
    picture = folder.parent / "guara.png"
    assert run(["robot", "check", str(folder), "--json", "--picture", str(picture)]) == 1
    captured = capsys.readouterr()
    said = json.loads(captured.out)
    assert (said["folder"], said["robot"], said["verdict"]) == (str(folder), "guara", "wrong")
    assert [f["place"] for f in said["findings"] if f["weight"] == "wrong"] == ["robot.toml [scan]"]
    assert "set mirror_angle_first = " in said["findings"][0]["text"] and captured.err == f"picture: {picture}\n"
    toml.write_text(toml.read_text().replace('name = "guara"', "name = 3"))
    assert run(["robot", "check", str(folder), "--json"]) == 2
    said = json.loads(capsys.readouterr().out)
    assert said["verdict"] == "unusable" and said["robot"] is None
    assert said["findings"][0]["place"].endswith("robot.toml:3")
    assert run(["robot", "check", "guara", "--json", "--view"]) == 2
    assert "--json and --view are mutually exclusive" in capsys.readouterr().err


def test_all_that_makes_it_unusable_is_listed(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Faults in the perception settings are listed together, one per line."""
    toml = folder / "robot.toml"
    toml.write_text(toml.read_text().replace("pauses = 40", "pauses = 0").replace("stripes = 70", "stripes = 1"))
    assert run(["robot", "check", str(folder)]) == 2
    lines = capsys.readouterr().out.splitlines()
    assert sum(line.startswith("unusable: ") for line in lines) == 2 and lines[-1].endswith(": 2 findings, 0 notes")


@pytest.mark.slow
def test_picture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Picture of robot, area, camera and laser."""
    picture = tmp_path / "guara.png"
    assert run(["robot", "check", "guara", "--picture", str(picture)]) == 0
    assert picture.read_bytes().startswith(b"\x89PNG") and f"picture: {picture}" in capsys.readouterr().out


def test_the_view_shows_the_area_the_cone_and_the_laser_planes() -> None:
    """Grid of the scanned area, known where it is seen, and lines from camera and mirror to its corners."""
    robot = load_robot("guara")
    moment = robot_moment(robot)
    grid, lines = moment.grids["footprint"], moment.stripes()
    assert float(np.isfinite(grid.elevation).mean()) > 0.98
    assert moment.joint_positions == robot.posture("scan")
    assert len(lines) == 4 + 2 * 3
    np.testing.assert_allclose(lines[0][0], [0.400, 0.0, 0.500], atol=1e-6)
    np.testing.assert_allclose(lines[0][-1], [0.50, -0.27, 0.0], atol=1e-9)


@pytest.mark.heavy
@pytest.mark.slow
def test_a_walk_of_two_pauses(guara_walk: TrialWalk) -> None:
    """It scans and walks, and treats nothing unknown or hazardous as safe; a failed walk gives findings."""
    assert guara_walk.pauses == 2 and guara_walk.feet >= 1 and guara_walk.known > 0.9
    assert list(walk_findings(guara_walk)) == []
    bad = dataclasses.replace(guara_walk, ended="OutOfReach: leg 'lf'", unknown_called_safe=3, feet_on_hazard=1)
    assert [str(finding).split(": ")[0] for finding in walk_findings(bad)] == ["wrong"] * 3


@pytest.fixture(scope="module")
def guara_walk() -> TrialWalk:
    """Two pauses of the Guará on its trial ground."""
    return trial_walk(load_robot("guara"), pauses=2)
