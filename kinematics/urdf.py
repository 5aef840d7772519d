"""Content of a URDF file as dataclasses."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kinematics.arrays import Float

# Attributes that give the size of each shape, with the number of values in each attribute.
SIZES = {
    "box": {"size": 3},
    "cylinder": {"radius": 1, "length": 1},
    "capsule": {"radius": 1, "length": 1},
    "sphere": {"radius": 1},
}


@dataclass(frozen=True, slots=True)
class Shape:
    """Collision shape of a link. A mesh or capsule is replaced by an enclosing box, cylinder or sphere.

    Attributes:
        kind: "box", "cylinder" (axis z) or "sphere".
        size: box (x, y, z), cylinder (radius, length), sphere (radius,) [m].
        transform_shape_to_link: (4, 4) pose of the shape in the frame of the link.
    """

    kind: str
    size: tuple[float, ...]
    transform_shape_to_link: Float


@dataclass(frozen=True, slots=True)
class Link:
    """Link with mass [kg], centre of mass (3,) [m], inertia (3, 3) about that point [kg m^2], and collision shapes.

    `mass` is None if the link has no <inertial>. `line` is the line of the <link> element in the file.
    """

    name: str
    mass: float | None
    centre_of_mass: Float
    inertia: Float
    shapes: tuple[Shape, ...]
    line: int = 0


@dataclass(frozen=True, slots=True)
class Joint:
    """Joint with `axis` (3,) in the joint's frame and limits [rad] or [m], which are zero for a fixed joint.

    `kind` is "fixed", "revolute" or "prismatic"; a continuous joint is revolute with the limits -pi and pi. `line` is
    the line of the <joint> element in the file.
    """

    name: str
    kind: str
    parent: str
    child: str
    transform_child_to_parent: Float
    axis: Float
    lower: float
    upper: float
    line: int = 0


@dataclass(frozen=True, slots=True)
class Urdf:
    """Content of a URDF file: links and joints in the order of the file, and its text.

    Attributes:
        path: the file.
        name: name of the robot.
        links, joints: all links and joints, in the order of the file.
        text: text of the file.
        notes: one note for each kind of content that is not used, except for common elements such as <visual>.
    """

    path: Path
    name: str
    links: tuple[Link, ...]
    joints: tuple[Joint, ...]
    text: str
    notes: tuple[str, ...] = ()

    def path_to(self, link: str) -> tuple[Joint, ...]:
        """Joints from the root to a link, in that order."""
        above = {joint.child: joint for joint in self.joints}
        chain: list[Joint] = []
        while link in above:
            chain.insert(0, above[link])
            link = above[link].parent
        return tuple(chain)

    def transform_at_zero(self, link: str) -> Float:
        """Transform (4, 4) from a link to the root link with all joints at zero."""
        transform = np.eye(4)
        for joint in self.path_to(link):
            transform = transform @ joint.transform_child_to_parent
        return transform


def rotation_from_rpy(roll: float, pitch: float, yaw: float) -> Float:
    """Rotation (3, 3) by roll, pitch, yaw [rad] about the fixed axes x, y, z, as in the attribute `rpy` of URDF."""
    import pinocchio

    return np.array(pinocchio.rpy.rpyToMatrix(roll, pitch, yaw))
