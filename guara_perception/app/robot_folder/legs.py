"""Legs of a robot: detection in its URDF, their feet, and inverse kinematics before the soles are defined."""

from __future__ import annotations

import warnings
from collections import Counter
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np

from guara_perception.arrays import Float
from guara_perception.exceptions import InvalidInput
from kinematics import JointLimitWarning
from kinematics.leg import NumericLeg
from kinematics.load import rpy_from_rotation
from kinematics.model_checks import extent_along, frames_fixed_to
from kinematics.robot_toml import LegConfig, RobotToml
from kinematics.toml_table import Table
from kinematics.transforms import translation
from kinematics.tree import KinematicTree, RobotState
from kinematics.urdf import Joint, Link, Shape, Urdf, rotation_from_rpy
from kinematics.urdf_checks import root_link

# Smallest number of joints with which a leg can place its foot at any point within reach.
LEAST_JOINTS = 3
LEAST_LEGS = 3
# Angles [rad] from which the search starts, for each joint but the first, which starts at 0. The centre of the limits
# is another start.
STARTS = (-1.6, -0.8, 0.0, 0.8, 1.6)
TIP = "tip of the leg"
# Ratio of length to width above which a shape is a bone with the foot at its end. A shorter shape is the foot itself,
# and so is a longer one that lies flat at the end of a leg with four or more joints.
BONE_RATIO = 1.5


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


class LegSolver:
    """Inverse kinematics of one leg, for the tip of its foot.

    Attributes:
        leg: leg found in the URDF.
        foot: foot of this leg.
        pitch_joint: (3,) origin of the first joint that swings the foot fore and aft, or of the first joint of the leg
            if none does, in the base, with all joints at zero [m].
        hip: link moved by the pitch joint.
        side: y of the tip in the base, with all joints at zero [m].
        length: length of the stretched leg from the pitch joint to the tip [m].
    """

    def __init__(self, urdf: Urdf, leg: FoundLeg, foot: Foot) -> None:
        """Measure the leg with all joints at zero."""
        self.leg, self.foot = leg, foot
        self._last: Float | None = None
        extended = with_frame(urdf, foot.link, TIP, translation(foot.tip))
        self._tree = tree_of(extended, (LegConfig(leg.name, foot.link, TIP, leg.joints),))
        self._columns = [self._tree.joint_index(joint) for joint in leg.joints]
        self._moving = moving = [joint for joint in self._tree.urdf.path_to(TIP) if joint.kind != "fixed"]
        frames = self.transforms(np.zeros(len(moving)))
        swings = [i for i, joint in enumerate(moving) if abs((frames[i][:3, :3] @ joint.axis)[1]) > 0.7]
        first = swings[0] if swings else 0
        tip = frames[-1] @ np.append(foot.tip, 1.0)
        self.pitch_joint: Float = frames[first][:3, 3]
        self.hip = moving[first].child
        self.side = float(tip[1])
        points = np.array([*(frame[:3, 3] for frame in frames[first:]), tip[:3]])
        self.length = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())

    def solver(self, start: Float) -> NumericLeg:
        """Numeric solver that starts from the joint positions `start`."""
        return NumericLeg(self._tree, self.leg.name, start)

    def solve(self, start: Float, tip: Float) -> Float | None:
        """Joint positions that place the tip at (3,) in the base [m], searched from `start`; None if out of reach."""
        found = self.solver(start).solve(tip[None], np.zeros(1))[0]
        return None if np.any(np.isnan(found)) else found

    def stand_over(self, tip: Float) -> Float | None:
        """Joint positions that place the tip at `tip` (3,) in the base [m]; None if not found.

        The search starts from the last result. If that fails, it starts from many positions, and the solution of the
        lowest cost is returned: little hip roll, and the knee towards the body's centre.
        """
        if self._last is not None:
            again = self.solve(self._last, tip)
            if again is not None:
                self._last = again
                return again
        centre = (self._tree.lower_limits + self._tree.upper_limits)[self._columns] / 2.0
        grid = (np.array([0.0, *angles]) for angles in product(STARTS, repeat=len(self._columns) - 1))
        self._last, best = None, np.inf
        for start in (centre, *grid):
            solution = self.solve(start, tip)
            if solution is not None and (cost := self._cost(solution, tip)) < best - 1e-6:
                best, self._last = cost, solution
        return self._last

    def _cost(self, positions: Float, tip: Float) -> float:
        """Cost of a posture; low if the hip does not roll and the knee points to the body's centre."""
        frames = self.transforms(positions)
        knee = frames[-1][:3, 3] if len(frames) < 4 else frames[2][:3, 3]
        outward = float(np.sign(self.leg.start[0]) * (knee[0] - (tip[0] + self.pitch_joint[0]) / 2.0))
        return outward * 2.0 + float(np.abs(positions[0])) + 0.01 * float(np.abs(positions).sum())

    def transforms(self, positions: Float) -> list[Float]:
        """transform_link_to_base (4, 4) of each link moved by a joint of the leg, from hip to foot."""
        whole = np.zeros(len(self._tree.joint_names))
        whole[self._columns] = positions
        with warnings.catch_warnings():
            # No warning here: zero may be outside the limits of a joint.
            warnings.simplefilter("ignore", JointLimitWarning)
            state = RobotState(self._tree, whole)
        return [state.transform_to_base(joint.child) for joint in self._moving]

    def foot_rotation(self, positions: Float) -> Float:
        """Rotation (3, 3) of the last link in the base."""
        return np.asarray(self.transforms(positions)[-1][:3, :3])


def with_frame(urdf: Urdf, parent: str, name: str, transform: Float) -> Urdf:
    """Add a link fixed to `parent`. Its rotation is converted to roll, pitch and yaw and back, as in a URDF file."""
    placed = np.array(transform)
    placed[:3, :3] = rotation_from_rpy(*rpy_from_rotation(placed[:3, :3]))
    link = Link(name, None, np.zeros(3), np.zeros((3, 3)), ())
    joint = Joint(f"{name}_joint", "fixed", parent, name, placed, np.array([1.0, 0.0, 0.0]), 0.0, 0.0)
    return replace(urdf, links=(*urdf.links, link), joints=(*urdf.joints, joint))


def tree_of(urdf: Urdf, legs: tuple[LegConfig, ...], sole: tuple[float, float] = (0.01, 0.01)) -> KinematicTree:
    """Kinematic tree with the given legs and sole size. The root link stands in for the frames of camera and laser."""
    root = root_link(urdf)
    config = RobotToml(
        path=Path(urdf.path),
        name=urdf.name,
        sole=sole,
        scan_posture="",
        base_frame=root,
        camera_frame=root,
        laser_frame=root,
        imu_frame=None,
        legs=legs,
        postures=(),
        root=Table(urdf.path, "", {"self_filter": {"margin": 0.01, "ignore": []}}),
    )
    return KinematicTree(urdf, config)


@dataclass(frozen=True, slots=True, eq=False)
class Foot:
    """Foot at the end of a leg, in the frame of the last moving link.

    Attributes:
        link: the last moving link.
        tip: (3,) centre of the foot or of the round end of the bone; without a shape, origin of the farthest frame [m].
        shapes: shapes that move rigidly with the link, each with transform_shape_to_link (4, 4).
        is_round: True if the foot has a point contact: a ball, the end of a bone, any short foot of a leg with fewer
            than four joints, or a foot without a shape.
        size: (3,) extents of the foot along its own axes [m]: the diameter of a ball, the width of a bone; zeros if the
            foot has no shape.
    """

    link: str
    tip: Float
    shapes: tuple[tuple[Shape, Float], ...]
    is_round: bool
    size: Float

    def lowest(self, rotation: Float) -> float:
        """Distance from the tip down to the lowest point of all shapes [m] if the link is rotated by `rotation`.

        The distance is 0 if the foot has no shape.
        """
        down = np.array([0.0, 0.0, -1.0])
        depths = [
            extent_along(shape, rotation @ m[:3, :3], down) + float(down @ (rotation @ (m[:3, 3] - self.tip)))
            for shape, m in self.shapes
        ]
        return max(depths, default=0.0)


def find_foot(urdf: Urdf, leg: FoundLeg) -> Foot:
    """Find the foot of a leg: the shape farthest from the last joint among those that move with the last link.

    Without a shape, the foot is the frame farthest from that joint.
    """
    link = next(joint.child for joint in urdf.joints if joint.name == leg.joints[-1])
    frames = dict(frames_fixed_to(urdf, link))
    shapes = tuple(
        (shape, frames[item.name] @ shape.transform_shape_to_link)
        for item in urdf.links
        for shape in (item.shapes if item.name in frames else ())
    )
    if not shapes:
        farthest = max(frames.values(), key=lambda transform: float(np.linalg.norm(transform[:3, 3])))
        return Foot(link, farthest[:3, 3].copy(), (), True, np.zeros(3))

    def reach(item: tuple[Shape, Float]) -> float:
        shape, m = item
        distance = float(np.linalg.norm(m[:3, 3]))
        direction = m[:3, 3] / distance if distance > 1e-9 else np.array([0.0, 0.0, -1.0])
        return distance + extent_along(shape, m[:3, :3], direction)

    shape, m = max(shapes, key=reach)
    full = 2.0 * np.array([extent_along(shape, np.eye(3), axis) for axis in np.eye(3)])
    long_axis = int(np.argmax(full))
    width = float(np.median(full))
    if full[long_axis] <= BONE_RATIO * width:
        return Foot(link, m[:3, 3].copy(), shapes, shape.kind == "sphere" or len(leg.joints) < 4, full)
    along = m[:3, long_axis] * np.sign(m[:3, long_axis] @ m[:3, 3] or 1.0)
    if len(leg.joints) >= 4 and abs(along[2]) < 0.5:
        return Foot(link, m[:3, 3].copy(), shapes, False, full)
    tip = m[:3, 3] + along * (full[long_axis] - width) / 2.0
    return Foot(link, tip, shapes, True, np.full(3, width))
