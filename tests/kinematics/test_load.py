"""Loading of robot folders: all errors at once, doubtful content as warnings, and added folders."""

from __future__ import annotations

import base64
import json
import math
import re
import shutil
import subprocess
import sys
import warnings
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from kinematics import (
    JointLimitWarning,
    JointPositionError,
    RobotFileError,
    RobotFileWarning,
    RobotModel,
    describe_robot,
    load_robot,
    robot_from_description,
)
from kinematics.scan_pattern import plane_on_floor
from kinematics.untrusted import parse_xml

ROOT = Path(__file__).parents[2]


def edit(path: Path, *changes: tuple[str, str]) -> None:
    text = path.read_text(encoding="utf-8")
    for old, new in changes:
        assert old in text, f"{old!r} is not in {path.name}"
        text = text.replace(old, new, 1)
    path.write_text(text, encoding="utf-8")


def test_what_is_wrong_in_all_three_files_comes_at_once(broken_folder: Callable[..., Path]) -> None:
    """Eight faults in robot.toml, URDF and SRDF give eight findings, each with its file and line."""
    folder = broken_folder("robot.toml", "encoder_sigma = 0.0035", "encoder_sigma = -1.0")
    edit(
        folder / "robot.toml",
        ('scan_posture = "scan"', 'scan_posture = "sit"'),
        ('camera = "camera_optical_frame"', 'camera = "eye"'),
        ('["rf_haa_joint",', '["lf_haa_joint",'),
        ("slip_sigmas = 4.5", 'slip_sigmas = "4"'),
        ("hip_height = 0.360 ", "hip_heigth = 0.360 "),
    )
    edit(
        folder / "srdf" / "guara.srdf",
        ('link2="lf_hip_link"', 'link2="lf_hip"'),
        ('"lf_haa_joint" value="0"', '"lf_haa_joint" value="zero"'),
    )
    with pytest.raises(RobotFileError) as caught:
        load_robot(folder)
    wanted = {
        "robot.toml": [
            '"sit"',
            '"eye"',
            '["lf_haa_joint", "rf_hfe',
            "encoder_sigma = -1",
            "slip_sigmas",
            "[postures.scan]",
        ],
        "guara.srdf": ['link2="lf_hip"', 'value="zero"'],
    }
    assert len(caught.value.findings) == 8, caught.value.findings
    for file, texts in wanted.items():
        lines = next(folder.rglob(file)).read_text().splitlines()
        reported = [
            re.match(rf".*{file}:(\d+): ", finding) for finding in caught.value.findings if f"{file}:" in finding
        ]
        found = [lines[int(match[1]) - 1] for match in reported if match]
        for text in texts:
            assert any(text in line for line in found), (text, caught.value.findings)


def test_geometry_is_reported_beside_wrong_settings(broken_folder: Callable[..., Path]) -> None:
    """A sole frame 20 mm too high and a wrong setting are both reported."""
    folder = broken_folder("robot.toml", "margin = 0.010", "margin = -1.0")
    edit(folder / "urdf" / "guara.urdf", ('<origin xyz="0 0 -0.100"', '<origin xyz="0 0 -0.080"'))
    with pytest.raises(RobotFileError) as caught:
        load_robot(folder)
    assert any("[self_filter] margin is -1.0" in finding for finding in caught.value.findings)
    assert any("20.0 mm above the lowest point" in finding for finding in caught.value.findings)


def test_a_broken_urdf_does_not_hide_robot_toml(broken_folder: Callable[..., Path]) -> None:
    """Findings in both files are reported."""
    folder = broken_folder("robot.toml", "hold_time = 0.2", "hold_time = 0")
    edit(folder / "urdf" / "guara.urdf", ("<axis xyz", "<axes xyz"))
    with pytest.raises(RobotFileError) as caught:
        load_robot(folder)
    assert any("[pause] hold_time is 0; a number above 0" in finding for finding in caught.value.findings)
    assert any("<axes>" in finding for finding in caught.value.findings)


@pytest.mark.parametrize(
    ("old", "new", "found"),
    [
        ("mirror_angle_last = 0.325", "mirror_angle_last = 0.200", r"x = 0.495 to 0.799 m .* from 0.5 to 0.95"),
        ("mirror_angle_first = -0.110", "mirror_angle_first = 0.110", r"x = 0.705 to 0.957 m"),
        ("x = [0.50, 0.95]", "x = [0.50, 1.10]", r"\[grid.footprint\] extends from 0.5 to 1.1"),
    ],
)
def test_a_scan_pattern_off_the_area_gives_a_warning(
    old: str, new: str, found: str, broken_folder: Callable[..., Path], guara: RobotModel
) -> None:
    """The robot loads, since a calibration has its own angles; the warning suggests two angles."""
    folder = broken_folder("robot.toml", old, new)
    with pytest.warns(RobotFileWarning, match=found) as caught:
        robot = load_robot(folder)
    assert len(caught) == 1 and len(robot.doubts) == 1 and guara.doubts == ()
    remedy = dict(re.findall(r"(mirror_angle_\w+) = (-?[\d.]+)", str(caught[0].message)))
    text = (folder / "robot.toml").read_text()
    for key, value in remedy.items():
        text = re.sub(rf"{key} = -?[\d.]+", f"{key} = {value}", text)
    (folder / "robot.toml").write_text(text)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mended = load_robot(folder)
    near, far = mended.config.root.table("grid").table("footprint").pair("x")
    first, last = (plane_on_floor(0.600, 0.470, float(remedy[f"mirror_angle_{end}"])) for end in ("first", "last"))
    assert near - 0.01 < first <= near + 0.001 and far - 0.001 <= last < far + 0.01


def test_a_robot_loads_without_its_scan_pattern(broken_folder: Callable[..., Path]) -> None:
    """A robot without [scan] loads, because only perception reads [scan] and [grid]."""
    robot = load_robot(broken_folder("robot.toml", "[scan]", "[scam]"))
    assert robot.doubts == ()


def test_joints_in_degrees_are_refused(robot: RobotModel) -> None:
    """A hip at 20 rad is rejected, with the joint, its limits and its value if given in degrees."""
    posture = robot.posture("scan")
    in_degrees = {joint: math.degrees(value) for joint, value in posture.items()}
    first = next(joint for joint in robot.joint_names if abs(in_degrees[joint]) > 10.0)
    with pytest.raises(JointPositionError, match=rf"{first} is at .* rad, half a turn or more beyond .* in radians \("):
        robot.state(in_degrees)


def test_joints_beyond_their_limits_are_reported_in_one_warning(robot: RobotModel) -> None:
    """If every joint is beyond its limits, one warning names three joints and counts the others."""
    with pytest.warns(JointLimitWarning) as caught:
        state = robot.state(robot.tree.upper_limits + 0.1)
    assert len(caught) == 1 and len(state.beyond_limits) == len(robot.joint_names)
    assert str(caught[0].message).endswith(f"; and {len(robot.joint_names) - 3} more joints")
    assert str(caught[0].message).count("beyond its limits") == 3


@pytest.mark.slow
def test_a_folder_that_is_added_to_robots_is_tested(tmp_path: Path) -> None:
    """In a copy of the checkout with one more robot, the table-driven tests cover it, and fail where it is wrong."""
    for folder in ("kinematics", "robots", "tests/kinematics", "tests/robots"):
        shutil.copytree(ROOT / folder, tmp_path / folder, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copytree(ROOT / "tests" / "robots" / "tapir", tmp_path / "robots" / "mine")
    for file in (tmp_path / "robots" / "mine").rglob("tapir*"):
        file.write_text(file.read_text().replace('<robot name="tapir"', '<robot name="mine"'))
        file.rename(file.with_stem("mine"))
    edit(tmp_path / "robots" / "mine" / "robot.toml", ('name = "tapir"', 'name = "mine"'))
    arguments = ["-m", "pytest", "-q", "-p", "no:cacheprovider", "tests/kinematics/test_model.py", "-k", "mine"]

    def tested() -> str:
        done = subprocess.run([sys.executable, *arguments], cwd=tmp_path, capture_output=True, text=True, check=False)
        return done.stdout + done.stderr

    said = tested()
    assert (passed := re.search(r"(\d+) passed", said)) and int(passed[1]) >= 8 and "failed" not in said, said
    toml = tmp_path / "robots" / "mine" / "robot.toml"
    toml.write_text(re.sub(r"mirror_angle_last = [\d.]+", "mirror_angle_last = 0.1", toml.read_text()))
    assert "test_scan_pattern_covers_the_area[mine]" in tested()


def test_the_same_robot_comes_out(robot: RobotModel, monkeypatch: pytest.MonkeyPatch) -> None:
    """Names, limits, postures, frames and shapes are those of the folder; no file is opened."""
    description = describe_robot(robot)
    monkeypatch.setattr(Path, "open", None)
    other = robot_from_description(description)
    monkeypatch.undo()
    assert (other.name, other.legs, other.joint_names, other.sole) == (
        robot.name,
        robot.legs,
        robot.joint_names,
        robot.sole,
    )
    np.testing.assert_array_equal(other.tree.lower_limits, robot.tree.lower_limits)
    for posture in robot.posture_names:
        guara_state, other_state = robot.state(robot.posture(posture)), other.state(other.posture(posture))
        for frame in robot.tree.links:
            np.testing.assert_allclose(
                guara_state.transform_to_base(frame), other_state.transform_to_base(frame), atol=1e-12
            )
    for link, description in robot.tree.links.items():
        assert [shape.size for shape in description.shapes] == [shape.size for shape in other.tree.links[link].shapes]


def test_it_is_small(robot: RobotModel) -> None:
    """The description has less than 12 kB, about a hundredth of a grid."""
    assert len(describe_robot(robot)) < 12_000


def packed(files: object) -> str:
    """Description with arbitrary content."""
    return base64.b64encode(zlib.compress(json.dumps(files).encode())).decode()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("not base64!", "corrupt"),
        (base64.b64encode(b"no zlib").decode(), "corrupt"),
        (packed({"name": "x"}), "corrupt"),
        (packed([1, 2]), "corrupt"),
        (
            packed({"name": "x", "toml": "", "urdf": "<mesh filename='/etc/passwd'/>", "srdf": ""}),
            "mesh files, which are not read",
        ),
        (packed({"name": "x", "toml": "", "urdf": "", "srdf": ""}), "the table [frames] is missing"),
        (packed({"name": "x", "toml": "#" * 1_100_000, "urdf": "", "srdf": ""}), "it has more than 1048576 characters"),
        (packed({"name": "x", "toml": "a" * 9_000_000, "urdf": "", "srdf": ""}), "longer than 8000000 bytes"),
        ("A" * 1_000_001, "at most 1000000 are read"),
    ],
)
def test_a_damaged_or_hostile_description_is_refused(text: str, message: str) -> None:
    """Decompression is bounded, and no other file is written or read."""
    with pytest.raises(RobotFileError) as caught:
        robot_from_description(text)
    assert message in str(caught.value)


def test_a_text_that_is_no_unicode_is_refused() -> None:
    """A received description may contain a lone surrogate, as JSON allows."""
    with pytest.raises(RobotFileError, match="is not valid XML"):
        parse_xml('<robot name="\ud800"/>', Path("guara.urdf"))


def test_entities_are_not_expanded(broken_folder: Callable[..., Path], guara: RobotModel) -> None:
    """Nested entities ("billion laughs") are rejected at the first definition."""
    files = json.loads(zlib.decompress(base64.b64decode(describe_robot(guara))))
    files["srdf"] = '<!DOCTYPE r [<!ENTITY a "ha"><!ENTITY b "&a;&a;">]><robot>&b;</robot>'
    with pytest.raises(RobotFileError, match="entity 'a' is defined; entities are not read"):
        robot_from_description(packed(files))


def test_the_description_outlives_its_folder(broken_folder: Callable[..., Path]) -> None:
    """The description is made from the content that was read, not from the present files of the folder."""
    folder = broken_folder("robot.toml", "name", "name")
    robot = load_robot(folder)
    (folder / "robot.toml").unlink()
    assert robot_from_description(describe_robot(robot)).legs == robot.legs
