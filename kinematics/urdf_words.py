"""Which elements and attributes of a URDF are read, and what is done about the others.

Readers of URDF skip names that they do not know and take the default: a misspelt <origin> puts a link somewhere else
without a warning. So an unknown name that resembles one that is read is refused, any other is reported as unused.
"""

from __future__ import annotations

from difflib import get_close_matches

from kinematics.findings import Findings
from kinematics.xml_file import Element

READ = {
    "robot": ("link", "joint"),
    "link": ("inertial", "collision"),
    "inertial": ("origin", "mass", "inertia"),
    "collision": ("origin", "geometry"),
    "geometry": ("box", "cylinder", "sphere", "capsule", "mesh"),
    "joint": ("origin", "parent", "child", "axis", "limit"),
}
ATTRIBUTES = {
    "link": ("name",),
    "joint": ("name", "type"),
    "origin": ("xyz", "rpy"),
    "axis": ("xyz",),
    "mass": ("value",),
    "inertia": ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"),
    "limit": ("lower", "upper", "effort", "velocity"),
    "parent": ("link",),
    "child": ("link",),
    "box": ("size",),
    "cylinder": ("radius", "length"),
    "capsule": ("radius", "length"),
    "sphere": ("radius",),
    "mesh": ("filename", "scale"),
}
# Names of the URDF specification and of simulators that say nothing about where the robot is: skipped in silence.
COMMON = {
    "robot": {"material", "mujoco", "gazebo", "transmission", "drake", "sensor"},
    "link": {"visual"},
    "joint": {"dynamics", "safety_controller", "calibration"},
    "collision": {"material"},
    "visual": {"origin", "geometry", "material"},
}
LIKE_AN_ELEMENT, LIKE_AN_ATTRIBUTE = 0.75, 0.6


def check_words(element: Element, where: str, findings: Findings) -> None:
    """Check the names of an element's attributes and of all elements below it; links and joints below it are left out.

    Args:
        element: an element that is read.
        where: what it belongs to, for messages.
        findings: gets names that look misspelt as wrong, and other unknown names as unused.
    """
    known = ATTRIBUTES.get(element.tag)
    for attribute in element.attrib:
        if known is not None and attribute not in known:
            like = get_close_matches(attribute, known, 1, LIKE_AN_ATTRIBUTE)
            if like and like[0] not in element.attrib:
                findings.wrong(
                    f"{where}: attribute {attribute!r} of <{element.tag}> is unknown; is {like[0]!r} meant?",
                    element.line,
                )
            else:
                findings.unused(f"attribute {attribute!r} of <{element.tag}>")
    read = READ.get(element.tag, ())
    for child in element:
        assert isinstance(child, Element)
        if child.tag in ("link", "joint"):
            continue
        if child.tag in read:
            check_words(child, where, findings)
        elif child.tag not in COMMON.get(element.tag, ()):
            like = get_close_matches(child.tag, read, 1, LIKE_AN_ELEMENT)
            if like:
                findings.wrong(
                    f"{where}: element <{child.tag}> is not allowed in <{element.tag}>; is <{like[0]}> meant?",
                    child.line,
                )
            else:
                findings.unused(f"element <{child.tag}> in <{element.tag}>")
