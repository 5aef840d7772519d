"""A robot described in one line of text."""

import base64
import json
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from kinematics import RobotFileError, RobotModel, describe_robot, load_robot, robot_from_description


def test_the_same_robot_comes_out(robot: RobotModel) -> None:
    """Names, limits, postures, frames and shapes are those of the folder."""
    other = robot_from_description(describe_robot(robot))
    assert (other.name, other.legs, other.joint_names, other.sole) == (
        robot.name,
        robot.legs,
        robot.joint_names,
        robot.sole,
    )
    np.testing.assert_array_equal(other.tree.lower_limits, robot.tree.lower_limits)
    for posture in robot.posture_names:
        guara_state, other_state = robot.state(robot.posture(posture)), other.state(other.posture(posture))
        for frame in robot.frame_names:
            np.testing.assert_allclose(
                guara_state.transform_to_base(frame), other_state.transform_to_base(frame), atol=1e-12
            )
    for link, description in robot.tree.links.items():
        assert [shape.size for shape in description.shapes] == [shape.size for shape in other.tree.links[link].shapes]


def test_it_is_small(robot: RobotModel) -> None:
    """A grid has a megabyte: the robot in it is a hundredth of that."""
    assert len(describe_robot(robot)) < 12_000


def packed(files: object) -> str:
    """A description with any content."""
    return base64.b64encode(zlib.compress(json.dumps(files).encode())).decode()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("not base64!", "is damaged"),
        (base64.b64encode(b"no zlib").decode(), "is damaged"),
        (packed({"name": "x"}), "is damaged"),
        (packed([1, 2]), "is damaged"),
        (packed({"name": "../x", "toml": "", "urdf": "", "srdf": ""}), "neither is read"),
        (packed({"name": "x", "toml": "", "urdf": "<mesh filename='/etc/passwd'/>", "srdf": ""}), "neither is read"),
        (packed({"name": "x", "toml": "", "urdf": "", "srdf": ""}), "the table [frames] is missing"),
        (packed({"name": "x", "toml": "a" * 9_000_000, "urdf": "", "srdf": ""}), "longer than 8000000 bytes"),
        ("A" * 1_000_001, "at most 1000000 are read"),
    ],
)
def test_a_damaged_or_hostile_description_is_refused(text: str, message: str) -> None:
    """Nothing is unpacked without end, no file beside its own is written or read."""
    with pytest.raises(RobotFileError) as caught:
        robot_from_description(text)
    assert message in str(caught.value)


def test_entities_are_not_expanded(broken_folder: Callable[..., Path], guara: RobotModel) -> None:
    """Nested entities ("billion laughs") are refused at the first definition."""
    files = json.loads(zlib.decompress(base64.b64decode(describe_robot(guara))))
    files["srdf"] = '<!DOCTYPE r [<!ENTITY a "ha"><!ENTITY b "&a;&a;">]><robot>&b;</robot>'
    with pytest.raises(RobotFileError, match="entity 'a' is defined; entities are not read"):
        robot_from_description(packed(files))


def test_the_description_outlives_its_folder(broken_folder: Callable[..., Path]) -> None:
    """It is made of what was read, not of what lies in the folder now."""
    folder = broken_folder("robot.toml", "name", "name")
    robot = load_robot(folder)
    (folder / "robot.toml").unlink()
    assert robot_from_description(describe_robot(robot)).legs == robot.legs
