"""Readers of an SRDF file: named postures, checked against the URDF, and disabled collision pairs."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from kinematics.findings import Findings
from kinematics.untrusted import Element, finite_numbers, parse_xml, read_xml
from kinematics.urdf import Urdf

# Joint whose seven values are the pose of the body: x y z [m] and quaternion x y z w.
ROOT_JOINT = "root_joint"


@dataclass(frozen=True, slots=True)
class Posture:
    """Named posture: position of every joint [rad] or [m], and the body's pose (7,) if the file gives it."""

    name: str
    joint_positions: dict[str, float]
    root: tuple[float, ...] | None


def read_srdf(path: Path, urdf: Urdf, text: str | None = None) -> tuple[Posture, ...]:
    """Read the `group_state` elements of an SRDF file.

    Args:
        path: the file.
        urdf: the URDF, which must contain the joints of all postures and the links of <chain> and <disable_collisions>.
        text: text of the file; None = read it.

    Raises:
        RobotFileError: the file cannot be read or is not XML, names unknown joints or links, omits or repeats a joint,
            has a value that is not a finite number or the wrong number of values, or repeats a posture.
    """
    root = read_xml(path)[0] if text is None else parse_xml(text, path)
    findings = Findings(path)
    _check_links(root, urdf, findings)
    postures = tuple(_posture(state, urdf, findings) for state in root.findall("group_state"))  # type: ignore[arg-type]
    for name, count in Counter(posture.name for posture in postures).items():
        if count > 1:
            findings.wrong(f"group_state {name!r} is defined {count} times")
    findings.refuse()
    return postures


def allowed_pairs(path: Path) -> list[tuple[str, str]]:
    """Pairs of links for which an SRDF disables collision checks.

    Raises:
        RobotFileError: the file cannot be read or is not XML.
    """
    root, _ = read_xml(path)
    return [(str(pair.get("link1")), str(pair.get("link2"))) for pair in root.iter("disable_collisions")]


def _check_links(root: Element, urdf: Urdf, findings: Findings) -> None:
    links = {link.name for link in urdf.links}
    for element, attributes in (
        ("disable_collisions", ("link1", "link2")),
        ("chain", ("base_link", "tip_link")),
    ):
        for found in root.iter(element):
            for attribute in attributes:
                if found.get(attribute) not in links:
                    findings.wrong(
                        f"<{element}>: {attribute} {found.get(attribute)!r} is not a link of {urdf.path.name}",
                        found.line,  # type: ignore[attr-defined]
                    )


def _posture(state: Element, urdf: Urdf, findings: Findings) -> Posture:
    name = state.get("name") or ""
    where = f"group_state {name!r}"
    moving = [joint.name for joint in urdf.joints if joint.kind != "fixed"]
    positions: dict[str, float] = {}
    root: tuple[float, ...] | None = None
    for element in state.findall("joint"):
        joint, line = element.get("name") or "", element.line  # type: ignore[attr-defined]
        values = finite_numbers(element.get("value", ""))
        if not values:
            findings.wrong(
                f"{where}: joint {joint!r}: value {element.get('value')!r} is not a list of finite numbers", line
            )
        elif joint == ROOT_JOINT and len(values) != 7:
            findings.wrong(
                f"{where}: {ROOT_JOINT} has {len(values)} numbers; seven are needed (x y z qx qy qz qw)", line
            )
        elif joint not in (ROOT_JOINT, *moving):
            findings.wrong(f"{where}: unknown joint {joint!r}; {urdf.path.name} has: {', '.join(moving)}", line)
        elif joint == ROOT_JOINT and root is not None:
            findings.wrong(f"{where}: {ROOT_JOINT} is given twice", line)
        elif joint in positions or (joint != ROOT_JOINT and len(values) != 1):
            findings.wrong(f"{where}: joint {joint!r} must be given once, with one value", line)
        if joint == ROOT_JOINT:
            root = values
        else:
            positions[joint] = values[0] if values else 0.0
    missing = [joint for joint in moving if joint not in positions]
    if missing:
        findings.wrong(f"{where}: no value for {', '.join(missing)}", state.line)
    return Posture(name, positions, root)
