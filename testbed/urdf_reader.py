"""The stance pose of a robot by an independent reader of URDF: yourdfpy's forward kinematics, and the definition."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np

from kinematics import RobotModel, Stance
from kinematics.arrays import Float

POSES = 5
# Joints about the scan posture, and gravity about straight down [rad].
JOINT_SIGMA, TILT_SIGMA = 0.05, 0.05


def worst_difference(robot: RobotModel, source: Path) -> float:
    """The largest difference of an entry of transform_base_to_footprint over several stances of a robot.

    Args:
        robot: loaded from a folder that was made of `source`.
        source: the stock URDF, which the other reader reads; the folder says where a sole lies on its foot's link.
    """
    # yourdfpy warns of every mesh that it is asked not to load.
    logging.getLogger("yourdfpy.urdf").setLevel(logging.ERROR)
    import yourdfpy

    other = yourdfpy.URDF.load(str(source), load_meshes=False, build_scene_graph=True)
    rng = np.random.default_rng(0)
    worst = 0.0
    for number in range(POSES):
        sigma = 0.0 if number == 0 else JOINT_SIGMA
        joints = _joints(robot, sigma, rng)
        down = np.array([0.0, 0.0, -1.0]) + (TILT_SIGMA * rng.standard_normal(3) if number else 0.0)
        down /= np.linalg.norm(down)
        other.update_cfg(joints)
        soles = []
        for leg in robot.config.legs:
            mount = robot.tree.urdf.path_to(leg.sole)[-1]
            foot = np.asarray(other.get_transform(mount.parent, robot.config.base_frame))
            sole = foot @ mount.transform_child_to_parent
            # A ball is as deep as its centre, which is above the frame along the frame's z, less its radius.
            radius = robot.config.sole_radius
            soles.append([*sole[:2, 3], sole[2, 3] + radius * sole[2, 2] - radius])
        pose = robot.stance_pose(
            Stance(joints, robot.legs, (float(down[0]), float(down[1]), float(down[2]))), find_unloaded=False
        )
        expected = _footprint(np.array(soles), -down)
        worst = max(worst, float(np.abs(pose.transform_base_to_footprint - expected).max()))
    return worst


def _joints(robot: RobotModel, sigma: float, rng: np.random.Generator) -> dict[str, float]:
    tree = robot.tree
    posture = robot.posture(robot.config.scan_posture)
    return {
        joint: float(
            np.clip(
                posture[joint] + sigma * rng.standard_normal(),
                tree.lower_limits[tree.joint_index(joint)],
                tree.upper_limits[tree.joint_index(joint)],
            )
        )
        for joint in robot.joint_names
    }


def _footprint(soles: Float, up: Float) -> Float:
    """transform_base_to_footprint (4, 4) by its definition: straight below the base, z = 0 at the mean of the soles."""
    ahead = np.array([1.0, 0.0, 0.0]) - up[0] * up
    ahead /= np.linalg.norm(ahead)
    transform = np.eye(4)
    transform[:3, :3] = ahead, np.cross(up, ahead), up
    transform[2, 3] = -float(up @ soles.mean(axis=0))
    return transform
