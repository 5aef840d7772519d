"""Inverse kinematics of a leg of which only the joints are known, and the place where its foot touches the ground."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np

from guara_perception.app.robot_folder.find_legs import FoundLeg
from guara_perception.arrays import Float
from kinematics.leg import NumericLeg
from kinematics.model_checks import extent_along
from kinematics.robot_toml import LegConfig, RobotToml
from kinematics.toml_table import Table
from kinematics.tree import KinematicTree
from kinematics.urdf import Joint, Link, Shape, Urdf
from kinematics.urdf_checks import root_link

# Angles from which the search starts, besides the centre of the limits [rad].
STARTS = (-1.6, -0.8, 0.0, 0.8, 1.6)
TIP = "tip of the leg"
# Longer than wide by more than this, a shape is a bone with the foot at its end, else it is the foot.
BONE_RATIO = 1.5


class LegSolver:
    """One leg with its foot's tip as sole.

    Attributes:
        leg: leg as found in the URDF.
        foot: the foot of this leg.
        pitch_joint: (3,) origin in the base of the first joint that swings the foot fore and aft, all at zero [m].
        hip: the link which that joint carries.
        side: the tip's y with the hip's roll at zero [m].
        length: length of the stretched leg from the pitch joint to the tip [m].
    """

    def __init__(self, urdf: Urdf, leg: FoundLeg, foot: Foot) -> None:
        """Measure the leg with all joints at zero."""
        self.leg, self.foot = leg, foot
        self._last: Float | None = None
        self._tree = _with_tip(urdf, leg, foot)
        joints = {joint.name: joint for joint in urdf.joints}
        origins, axes = [], []
        transform = np.eye(4)
        for joint in self._tree.urdf.path_to(TIP):
            transform = transform @ joint.transform_child_to_parent
            if joint.kind != "fixed":
                origins.append(transform[:3, 3].copy())
                axes.append(transform[:3, :3] @ joint.axis)
        swings = [i for i, axis in enumerate(axes) if abs(axis[1]) > 0.7]
        first = swings[0] if swings else 0
        self.pitch_joint: Float = origins[first]
        self.hip = joints[leg.joints[first]].child
        self.side = float(transform[1, 3])
        points = [*origins[first:], transform[:3, 3]]
        self.length = float(sum(np.linalg.norm(b - a) for a, b in zip(points, points[1:], strict=False)))

    def solver(self, start: Float) -> NumericLeg:
        """The numeric solver that starts from joint positions."""
        return NumericLeg(self._tree, self.leg.name, start)

    def stand_over(self, tip: Float) -> Float | None:
        """Joint positions that put the tip at (3,) in the base [m], knees inwards; None = out of reach."""
        columns = [self._tree.joint_index(joint) for joint in self.leg.joints]
        lower, upper = self._tree.lower_limits[columns], self._tree.upper_limits[columns]
        best, found = np.inf, None
        pitch = np.zeros(1)
        if self._last is not None:
            again = self.solver(self._last).solve(tip[None], pitch)[0]
            if not np.any(np.isnan(again)):
                self._last = again
                return again
        starts = [
            (lower + upper) / 2.0,
            *(np.array([0.0, *angles]) for angles in product(STARTS, repeat=len(columns) - 1)),
        ]
        for start in starts:
            solution = self.solver(start).solve(tip[None], pitch)[0]
            if np.any(np.isnan(solution)):
                continue
            cost = self._cost(solution, tip)
            if cost < best - 1e-6:
                best, found = cost, solution
        self._last = found
        return found

    def _cost(self, positions: Float, tip: Float) -> float:
        """Least for a hip that does not roll and a knee on the side of the body's centre."""
        state = self.transforms(positions)
        knee = state[-1][:3, 3] if len(state) < 4 else state[2][:3, 3]
        outward = float(np.sign(self.leg.start[0]) * (knee[0] - (tip[0] + self.pitch_joint[0]) / 2.0))
        return outward * 2.0 + float(np.abs(positions[0])) + 0.01 * float(np.abs(positions).sum())

    def transforms(self, positions: Float) -> list[Float]:
        """transform_link_to_base (4, 4) of the links that the joints of the leg carry, one after the other."""
        angles = dict(zip(self.leg.joints, positions.tolist(), strict=True))
        transform, found = np.eye(4), []
        for joint in self._tree.urdf.path_to(self.foot.link):
            transform = transform @ joint.transform_child_to_parent
            if joint.kind != "fixed":
                transform = transform @ _moved(joint, angles.get(joint.name, 0.0))
                found.append(transform)
        return found

    def foot_rotation(self, positions: Float) -> Float:
        """Rotation (3, 3) of the last link in the base."""
        return np.asarray(self.transforms(positions)[-1][:3, :3])


def _moved(joint: Joint, value: float) -> Float:
    transform = np.eye(4)
    if joint.kind == "prismatic":
        transform[:3, 3] = joint.axis * value
        return transform
    x, y, z = joint.axis / np.linalg.norm(joint.axis)
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    transform[:3, :3] = np.eye(3) + np.sin(value) * k + (1.0 - np.cos(value)) * k @ k
    return transform


def _with_tip(urdf: Urdf, leg: FoundLeg, foot: Foot) -> KinematicTree:
    placed = np.eye(4)
    placed[:3, 3] = foot.tip
    link = Link(TIP, None, np.zeros(3), np.zeros((3, 3)), ())
    mount = Joint(TIP, "fixed", foot.link, TIP, placed, np.array([1.0, 0.0, 0.0]), 0.0, 0.0)
    extended = replace(urdf, links=(*urdf.links, link), joints=(*urdf.joints, mount))
    root = root_link(urdf)
    config = RobotToml(
        path=Path(urdf.path),
        name=urdf.name,
        sole=(0.01, 0.01),
        scan_posture="",
        base_frame=root,
        camera_frame=root,
        laser_frame=root,
        imu_frame=None,
        legs=(LegConfig(leg.name, foot.link, TIP, leg.joints),),
        postures=(),
        root=Table(urdf.path, "", {}),
    )
    return KinematicTree(extended, config)


@dataclass(frozen=True, slots=True, eq=False)
class Foot:
    """The end of a leg, in the frame of the last moving link.

    Attributes:
        link: the last moving link.
        tip: (3,) centre of the foot, or of the round end of the bone [m].
        shapes: what moves rigidly with it, each with transform_shape_to_link (4, 4).
        is_round: whether the foot is a ball or the end of a bone: it touches in a point.
        size: (3,) extents of the foot along its own axes; a ball's diameter, a bone's width [m].
    """

    link: str
    tip: Float
    shapes: tuple[tuple[Shape, Float], ...]
    is_round: bool
    size: Float

    def lowest(self, rotation: Float) -> float:
        """How far the lowest point of all shapes is below the tip, with the link turned by a rotation (3, 3) [m]."""
        down = np.array([0.0, 0.0, -1.0])
        depths = [
            extent_along(shape, rotation @ m[:3, :3], down) + float(down @ (rotation @ (m[:3, 3] - self.tip)))
            for shape, m in self.shapes
        ]
        return max(depths, default=0.0)


def find_foot(urdf: Urdf, leg: FoundLeg) -> Foot:
    """The foot of a leg: of the shapes on its last moving link the one that ends farthest from the last joint."""
    link = next(joint.child for joint in urdf.joints if joint.name == leg.joints[-1])
    shapes = tuple(rigid_shapes(urdf, link))
    if not shapes:
        return Foot(link, _farthest_frame(urdf, link), (), True, np.zeros(3))

    def reach(item: tuple[Shape, Float]) -> float:
        shape, m = item
        distance = float(np.linalg.norm(m[:3, 3]))
        direction = m[:3, 3] / distance if distance > 1e-9 else np.array([0.0, 0.0, -1.0])
        return distance + extent_along(shape, m[:3, :3], direction)

    shape, m = max(shapes, key=reach)
    full = _full_size(shape)
    long_axis = int(np.argmax(full))
    width = float(np.median(full))
    if full[long_axis] <= BONE_RATIO * width:
        return Foot(link, m[:3, 3].copy(), shapes, shape.kind == "sphere" or len(leg.joints) < 4, full)
    along = m[:3, long_axis] * np.sign(m[:3, long_axis] @ m[:3, 3] or 1.0)
    if len(leg.joints) >= 4 and abs(along[2]) < 0.5:
        return Foot(link, m[:3, 3].copy(), shapes, False, full)
    tip = m[:3, 3] + along * (full[long_axis] - width) / 2.0
    return Foot(link, tip, shapes, True, np.full(3, width))


def rigid_shapes(urdf: Urdf, link: str) -> list[tuple[Shape, Float]]:
    """The shapes of a link and of all links fixed below it, each with transform_shape_to_link (4, 4)."""
    links: dict[str, Link] = {item.name: item for item in urdf.links}
    fixed: dict[str, list[Joint]] = {}
    for joint in urdf.joints:
        if joint.kind == "fixed":
            fixed.setdefault(joint.parent, []).append(joint)
    found: list[tuple[Shape, Float]] = []
    open_links = [(link, np.eye(4))]
    while open_links:
        name, transform = open_links.pop()
        found += [(shape, transform @ shape.transform_shape_to_link) for shape in links[name].shapes]
        open_links += [(joint.child, transform @ joint.transform_child_to_parent) for joint in fixed.get(name, [])]
    return found


def _full_size(shape: Shape) -> Float:
    if shape.kind == "box":
        return np.asarray(shape.size, dtype=np.float64)
    if shape.kind == "cylinder":
        return np.array([2.0 * shape.size[0], 2.0 * shape.size[0], shape.size[1]])
    return np.full(3, 2.0 * shape.size[0])


def _farthest_frame(urdf: Urdf, link: str) -> Float:
    """Origin of the frame farthest down a chain without shapes."""
    best, open_links = np.zeros(3), [(link, np.eye(4))]
    while open_links:
        name, transform = open_links.pop()
        if np.linalg.norm(transform[:3, 3]) > np.linalg.norm(best):
            best = transform[:3, 3].copy()
        for joint in urdf.joints:
            if joint.parent == name and joint.kind == "fixed":
                open_links.append((joint.child, transform @ joint.transform_child_to_parent))
    return best
