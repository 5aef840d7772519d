"""Stance pose of a robot from an independent URDF reader (forward kinematics of yourdfpy) and its definition."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np

from kinematics import RobotModel, Stance
from kinematics.arrays import Float

POSES = 5
# Standard deviations of joints from the scan posture, and of gravity from straight down [rad].
JOINT_SIGMA, TILT_SIGMA = 0.05, 0.05


def worst_difference(robot: RobotModel, source: Path) -> float:
    """Largest difference between entries of transform_base_to_footprint of both readers, over several stances.

    Args:
        robot: robot loaded from a folder that was made from `source`.
        source: stock URDF for the other reader; the positions of the soles on their links are taken from `robot`.
    """
    # yourdfpy warns about every mesh, although meshes are not loaded.
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
            # The lowest point of a ball is one radius below its centre, which is one radius above the frame along the
            # frame's z.
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
    """Compute transform_base_to_footprint (4, 4) by its definition: below base_link, with z = 0 at the mean sole."""
    ahead = np.array([1.0, 0.0, 0.0]) - up[0] * up
    ahead /= np.linalg.norm(ahead)
    transform = np.eye(4)
    transform[:3, :3] = ahead, np.cross(up, ahead), up
    transform[2, 3] = -float(up @ soles.mean(axis=0))
    return transform
