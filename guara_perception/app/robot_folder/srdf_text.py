"""Writes the SRDF of a proposed robot: leg groups, postures, and links that touch by construction."""

from __future__ import annotations

from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from guara_perception.app.robot_folder.collisions import neighbours
from guara_perception.app.robot_folder.propose import Proposal


def srdf_text(proposal: Proposal) -> str:
    """The text of the SRDF."""
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
