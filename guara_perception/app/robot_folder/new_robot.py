"""Creation of a robot folder from a URDF: URDF, SRDF, robot.toml and README.md."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from guara_perception.app.robot_folder.collisions import neighbours
from guara_perception.app.robot_folder.folder_texts import readme_text, toml_text
from guara_perception.app.robot_folder.propose import Proposal, propose
from guara_perception.exceptions import InvalidInput
from guara_perception.files import whole_folder
from kinematics.load import plain_urdf
from kinematics.read_urdf import read_urdf
from kinematics.urdf_checks import check_urdf


def new_robot(source: Path, folder: Path, *, name: str | None = None, hip_height: float | None = None) -> Proposal:
    """Create a robot folder atomically.

    Args:
        source: URDF file.
        folder: folder to create, which must not exist or must be empty.
        name: name of the robot; None = that of the folder, with "_" for characters that are not allowed.
        hip_height: height of the hips in the scan posture [m]; None = chosen.

    Raises:
        InvalidInput: `folder` is a file or not empty, the name is invalid, or no legs are found on which the robot can
            stand.
        OSError: the folder cannot be written.
        kinematics.RobotFileError: the URDF is invalid; the message lists all findings with their lines.
    """
    name = name or re.sub(r"[^A-Za-z0-9_-]", "_", folder.resolve().name)
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]*", name):
        raise InvalidInput(
            f"the name of the robot is {name!r}; allowed: letters, digits, '_' and '-', with a letter or digit first. "
            "Give another name with --name"
        )
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InvalidInput(f"{folder} already exists and will not be overwritten; give another name")
    urdf = read_urdf(source)
    check_urdf(urdf)
    proposal = propose(urdf, name, hip_height)
    texts = {
        f"urdf/{name}.urdf": plain_urdf(proposal.urdf),
        f"srdf/{name}.srdf": srdf_text(proposal),
        "robot.toml": toml_text(proposal, source.name),
        "README.md": readme_text(proposal, source.name, urdf.notes),
    }
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        # An empty folder of this name is replaced.
        with whole_folder(folder) as made:
            for file, text in texts.items():
                (made / file).parent.mkdir(exist_ok=True)
                (made / file).write_text(text, encoding="utf-8")
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(folder)) from error
    return proposal


def srdf_text(proposal: Proposal) -> str:
    """Text of the SRDF file of a proposed robot."""
    root = Element("robot", name=proposal.name)
    for leg in proposal.leg_configs:
        group = SubElement(root, "group", name=leg.name)
        SubElement(group, "chain", base_link=proposal.base, tip_link=leg.sole)
    legs = SubElement(root, "group", name="legs")
    for leg in proposal.leg_configs:
        SubElement(legs, "group", name=leg.name)
    for name, posture in (("scan", proposal.scan), ("standing", proposal.standing)):
        state = SubElement(root, "group_state", name=name, group="legs")
        SubElement(state, "joint", name="root_joint", value=f"0 0 {posture.base_height!r} 0 0 0 1")
        for joint, value in posture.joint_positions.items():
            SubElement(state, "joint", name=joint, value=repr(float(value)))
    for first, second in neighbours(proposal.urdf):
        SubElement(root, "disable_collisions", link1=first, link2=second, reason="Adjacent")
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"
