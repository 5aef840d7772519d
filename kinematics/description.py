"""A robot in one line of text: what a grid carries, so that whoever receives it can ask about its legs.

The text holds robot.toml, SRDF and what is used of the URDF, compressed. It may come from anywhere: its size is
limited, its files are read by the same checks as a folder's, and no other file of this machine is opened for it.
"""

from __future__ import annotations

import base64
import binascii
import json
import re
import tempfile
import zlib
from functools import lru_cache
from pathlib import Path

from kinematics.exceptions import RobotFileError
from kinematics.load import load_robot
from kinematics.model import RobotModel
from kinematics.plain_urdf import plain_urdf

# [byte] The description of a stock robot has some 5 kB, and 100 kB unpacked.
LARGEST_TEXT = 1_000_000
LARGEST_UNPACKED = 8_000_000
SOURCE = "robot description"


@lru_cache(maxsize=8)
def describe_robot(robot: RobotModel) -> str:
    """The description of a robot; `robot_from_description` makes the same robot of it."""
    files = {"name": robot.name, "toml": robot.toml_text, "urdf": plain_urdf(robot.tree.urdf), "srdf": robot.srdf_text}
    return base64.b64encode(zlib.compress(json.dumps(files).encode("utf-8"), 9)).decode("ascii")


def robot_from_description(text: str) -> RobotModel:
    """The robot of a description.

    Raises:
        RobotFileError: the text is damaged or too long, or the robot in it is not sound.
    """
    if len(text) > LARGEST_TEXT:
        raise RobotFileError(f"{SOURCE}: {len(text)} characters; at most {LARGEST_TEXT} are read")
    try:
        unpacker = zlib.decompressobj()
        content = unpacker.decompress(base64.b64decode(text, validate=True), LARGEST_UNPACKED)
        files = json.loads(content)
        name, toml, urdf, srdf = (str(files[key]) for key in ("name", "toml", "urdf", "srdf"))
    except (binascii.Error, zlib.error, ValueError, KeyError, TypeError, RecursionError) as error:
        raise RobotFileError(f"{SOURCE}: is damaged, or longer than {LARGEST_UNPACKED} bytes: {error}") from error
    if re.fullmatch(r"[A-Za-z0-9_-]+", name) is None or "<mesh" in urdf:
        raise RobotFileError(
            f"{SOURCE}: the robot's name is {name[:40]!r}, or its URDF names mesh files; neither is read"
        )
    with tempfile.TemporaryDirectory(prefix="robot-") as made:
        folder = Path(made)
        for file, content_of in (("robot.toml", toml), (f"urdf/{name}.urdf", urdf), (f"srdf/{name}.srdf", srdf)):
            (folder / file).parent.mkdir(exist_ok=True)
            (folder / file).write_text(content_of, encoding="utf-8")
        return load_robot(folder)
