"""Detection of a robot's legs in its URDF."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np

from guara_perception.exceptions import InvalidInput
from kinematics.urdf import Joint, Urdf

# Smallest number of joints with which a leg can place its foot at any point within reach.
LEAST_JOINTS = 3
LEAST_LEGS = 3


@dataclass(frozen=True, slots=True)
class FoundLeg:
    """Leg: a chain of joints that ends in a foot.

    Attributes:
        name: lf, rf, lh or rh if the robot has four legs, else the name of the foot.
        joints: names of the moving joints from the body to the foot.
        foot: name of the foot's link.
        start: (3,) origin of the first joint in the base, with all joints at zero [m].
    """

    name: str
    joints: tuple[str, ...]
    foot: str
    start: tuple[float, float, float]


def find_legs(urdf: Urdf) -> tuple[FoundLeg, ...]:
    """Find the legs: chains of three or more moving joints, each with a mirror image on the other side of the x axis.

    Raises:
        InvalidInput: fewer than three legs are found, or chains share joints; the message states what was found.
    """
    below: dict[str, list[Joint]] = {}
    for joint in urdf.joints:
        below.setdefault(joint.parent, []).append(joint)
    paths = [
        tuple(each for each in urdf.path_to(joint.child) if each.kind != "fixed")
        for joint in urdf.joints
        if joint.kind != "fixed"
    ]
    inner = {joint.name for path in paths for joint in path[:-1]}
    chains = [path for path in paths if path[-1].name not in inner and len(path) >= LEAST_JOINTS]
    counts = Counter(joint.name for chain in chains for joint in chain)
    shared = sorted(name for name, count in counts.items() if count > 1)
    if shared:
        raise InvalidInput(
            f"{urdf.path}: joint {shared[0]!r} moves more than one leg (a body that bends, or fingers): make "
            "it a fixed joint in a copy of the URDF"
        )
    legs = [_leg(urdf, chain, below) for chain in chains]
    paired = [leg for leg in legs if _has_twin(leg, legs)]
    if len(paired) < LEAST_LEGS:
        names = ", ".join(repr(leg.foot) for leg in legs) or "none"
        raise InvalidInput(
            f"{urdf.path}: number of legs found: {len(paired)}; allowed: {LEAST_LEGS} or more. A leg is a chain of "
            f"{LEAST_JOINTS} or more moving joints with a mirror image on the other side of the x axis. Chains end at: "
            f"{names}"
        )
    return _named(paired)


def _leg(urdf: Urdf, chain: tuple[Joint, ...], below: dict[str, list[Joint]]) -> FoundLeg:
    x, y, z = urdf.transform_at_zero(chain[0].child)[:3, 3].tolist()
    # Follow the links fixed to the last moving link up to the first branch. The last of them with a shape is the foot.
    # If none of them has a shape, the foot is a child of the last moving link, with a shape and with foot, toe or tip
    # in its name. Without such a child, the foot is the last moving link.
    foot, link = chain[-1].child, chain[-1].child
    links = {item.name: item for item in urdf.links}
    while len(below.get(link, [])) == 1:
        link = below[link][0].child
        foot = link if links[link].shapes else foot
    for joint in below.get(chain[-1].child, []) if foot == chain[-1].child else []:
        if links[joint.child].shapes and any(word in joint.child.lower() for word in ("foot", "toe", "tip")):
            foot = joint.child
    return FoundLeg(foot, tuple(joint.name for joint in chain), foot, (x, y, z))


def _has_twin(leg: FoundLeg, legs: list[FoundLeg]) -> bool:
    mirrored = np.array(leg.start) * (1.0, -1.0, 1.0)
    return any(
        other is not leg
        and len(other.joints) == len(leg.joints)
        and float(np.linalg.norm(np.array(other.start) - mirrored)) < 0.01
        for other in legs
    )


def _named(legs: list[FoundLeg]) -> tuple[FoundLeg, ...]:
    """Name the legs and sort them from front to hind, left before right; four legs are lf, rf, lh and rh."""
    ordered = sorted(legs, key=lambda leg: (-round(leg.start[0], 2), -leg.start[1]))
    names = ("lf", "rf", "lh", "rh") if len(ordered) == 4 else tuple(leg.foot for leg in ordered)
    return tuple(replace(leg, name=name) for name, leg in zip(names, ordered, strict=True))
