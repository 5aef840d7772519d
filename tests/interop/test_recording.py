"""A recording of the demo in other people's software: every message decoded, everything found where it should be."""

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from transport.messages.typestore import message_files, type_hash

pytestmark = pytest.mark.interop
TOPICS = 24


def test_rclpy_decodes_every_message(read_by_ros: dict[str, Any], counts: dict[str, int]) -> None:
    """Real rosidl and Fast-CDR, also for guara_msgs; written again nothing differs."""
    assert len(counts) == TOPICS and read_by_ros["counts"] == counts
    assert read_by_ros["differing"] == {}
    assert read_by_ros["facts"]["/guara/occupancy"] == 108 * 90
    assert read_by_ros["facts"]["/guara/map/occupancy"] == 140 * 320
    assert read_by_ros["facts"]["/tf"] > 16 and read_by_ros["facts"]["/guara/scan/points"] > 10_000


def test_rosidl_computes_the_same_type_hashes(read_by_ros: dict[str, Any]) -> None:
    """For every type that is recorded, of guara_msgs and of ROS."""
    assert len(read_by_ros["hashes"]) >= 14
    assert read_by_ros["hashes"] == {name: type_hash(name) for name in read_by_ros["hashes"]}


def test_the_message_package_holds_every_definition(ros: Path) -> None:
    """guara_msgs was built by ament and rosidl, with all that transport speaks: Python, C and C++."""
    overlay = ros / "overlay"
    for name in message_files():
        package, _, short = name.split("/")
        assert (overlay / "share" / package / "msg" / f"{short}.msg").is_file()
    assert (overlay / "include" / "guara_msgs" / "guara_msgs" / "msg" / "terrain.hpp").is_file()


def test_the_robot_is_a_ros_package(ros: Path) -> None:
    """guara_description was built by ament: its URDF lies where `package://` looks for it."""
    share = ros / "overlay" / "share" / "guara_description"
    for file in ("package.xml", "urdf/guara.urdf", "srdf/guara.srdf", "mjcf/guara.xml"):
        assert (share / file).is_file()


def test_foxglove_decodes_every_message(read_by_foxglove: dict[str, Any], counts: dict[str, int]) -> None:
    """With Foxglove's own MCAP reader, its parser of the schemas in the file, and its CDR."""
    assert read_by_foxglove["profile"] == "ros2"
    assert read_by_foxglove["counts"] == counts


def test_foxglove_and_ros_read_the_same(read_by_foxglove: dict[str, Any], read_by_ros: dict[str, Any]) -> None:
    """Points, cells and transforms of the last message of each topic."""
    assert read_by_foxglove["facts"] == read_by_ros["facts"] != {}


def test_rerun_finds_nothing_wrong(recording: Path) -> None:
    """No chunk out of order on any timeline."""
    pytest.importorskip("rerun", reason="extra `rerun` is not installed")
    command = [sys.executable, "-m", "rerun", "mcap", "check", "--full", recording]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0 and "PROBLEM" not in done.stdout
    assert done.stdout.count("\nok ") == TOPICS


def test_the_layout_for_foxglove_is_what_its_classes_make(root: Path, counts: dict[str, int]) -> None:
    """Its topics are in the recording; made again with foxglove-sdk it is the same file."""
    text = (root / "docs" / "foxglove-layout.json").read_text()
    named = set(re.findall(r'"(/[a-z_/]+)"', text))
    assert len(named) == 8 and named <= set(counts)
    pytest.importorskip("foxglove", reason="extra `interop` is not installed")
    from tests.interop.foxglove_layout import layout

    assert json.loads(layout().to_json()) == json.loads(text)
