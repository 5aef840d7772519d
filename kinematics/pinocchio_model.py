"""Builds Pinocchio's model of a robot from what was read of its URDF.

Pinocchio's own reader of URDF is not used: it gives a continuous joint two coordinates, and answers with an error
where a link and a joint share a name. Only frames of links are made, so every name is unique.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from kinematics.urdf import Joint, Urdf


def build_model(urdf: Urdf, only: tuple[str, ...] | None = None) -> Any:
    """A `pinocchio.Model` with a BODY frame for every link.

    Args:
        urdf: what was read; a checked tree.
        only: joints that move, on a base that stands still; None = all of them, on a free-flyer `root_joint`.

    Raises:
        ValueError, RuntimeError: Pinocchio refuses a value.
    """
    import pinocchio

    model = pinocchio.Model()
    model.name = urdf.name
    below: dict[str, list[Joint]] = {}
    for joint in urdf.joints:
        below.setdefault(joint.parent, []).append(joint)
    children = {joint.child for joint in urdf.joints}
    root = next(link.name for link in urdf.links if link.name not in children)
    links = {link.name: link for link in urdf.links}
    first = 0
    if only is None:
        first = model.addJoint(0, pinocchio.JointModelFreeFlyer(), pinocchio.SE3.Identity(), "root_joint")
    # Name of a link, index of the joint that carries it, and its pose on that joint.
    open_links = [(root, first, pinocchio.SE3.Identity())]
    while open_links:
        name, carrier, placement = open_links.pop()
        link = links[name]
        if link.mass:
            inertia = pinocchio.Inertia(float(link.mass), link.centre_of_mass, link.inertia)
            model.appendBodyToJoint(carrier, inertia, placement)
        model.addFrame(pinocchio.Frame(name, carrier, placement, pinocchio.FrameType.BODY), False)
        for joint in reversed(below.get(name, [])):
            origin = placement * pinocchio.SE3(np.array(joint.transform_child_to_parent))
            if joint.kind == "fixed" or (only is not None and joint.name not in only):
                open_links.append((joint.child, carrier, origin))
                continue
            number = model.addJoint(carrier, _joint_model(joint), origin, joint.name)
            index = model.joints[number].idx_q
            model.lowerPositionLimit[index], model.upperPositionLimit[index] = joint.lower, joint.upper
            open_links.append((joint.child, number, pinocchio.SE3.Identity()))
    return model


def _joint_model(joint: Joint) -> Any:
    import pinocchio

    axis = joint.axis / np.linalg.norm(joint.axis)
    for index, letter in enumerate("XYZ"):
        if axis[index] == 1.0:
            return getattr(pinocchio, f"JointModel{'P' if joint.kind == 'prismatic' else 'R'}{letter}")()
    if joint.kind == "prismatic":
        return pinocchio.JointModelPrismaticUnaligned(axis)
    return pinocchio.JointModelRevoluteUnaligned(axis)
