"""Postures in which a robot stands level above its feet, and choice of the hip height for the reach of the feet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from guara_perception.app.robot_folder.legs import LegSolver
from guara_perception.arrays import Float
from guara_perception.exceptions import InvalidInput
from kinematics.leg import NumericLeg
from kinematics.tree import KinematicTree

# Footholds of the wave gait relative to the standing foot [m]. The distances fore and aft are half a swing plus the
# planner's search radius on level ground, half a swing on lower ground, and 30 mm more on an obstacle. Each of
# them, and zero, is combined with 40 mm to either side.
FOOT_OFFSETS = np.array(
    [
        (x, y, z)
        for reach, z in ((0.13, 0.0), (0.07, -0.02), (0.10, 0.06))
        for x in (-reach, 0.0, reach)
        for y in (-0.04, 0.04)
    ]
)
# Hip heights to try, measured from the tips of the feet, as fractions of the length of the shortest stretched leg.
SHARES = np.arange(0.86, 0.48, -0.02)
ROUNDS = 4


@dataclass(frozen=True, slots=True, eq=False)
class FoundPosture:
    """Posture of a standing robot.

    Attributes:
        hip_height: mean height of the pitch joints above the plane of the soles [m].
        base_height: height of the base's origin above that plane [m].
        joint_positions: position of each joint, by name [rad].
        soles: (3,) ground contact of each foot, by leg, in the base [m].
    """

    hip_height: float
    base_height: float
    joint_positions: dict[str, float]
    soles: dict[str, Float]


def stand(legs: tuple[LegSolver, ...], hip_height: float) -> FoundPosture | None:
    """Posture with the hips at `hip_height` [m] above the soles; None if out of reach.

    Each sole is at the x of its pitch joint, and at the y of its tip with all joints at zero.
    """
    top = float(np.mean([leg.pitch_joint[2] for leg in legs]))
    floor = top - hip_height
    joints: dict[str, float] = {}
    soles = {}
    for leg in legs:
        below = float(leg.foot.size.min()) / 2.0
        positions: Float | None = None
        for _ in range(ROUNDS):
            tip = np.array([leg.pitch_joint[0], leg.side, floor + below])
            positions = leg.stand_over(tip) if positions is None else leg.solve(positions, tip)
            if positions is None:
                return None
            found = leg.foot.lowest(leg.foot_rotation(positions))
            if abs(found - below) < 1e-9:
                break
            below = found
        assert positions is not None
        joints.update(zip(leg.leg.joints, positions.tolist(), strict=True))
        soles[leg.leg.name] = np.array([tip[0], tip[1], floor])
    return FoundPosture(hip_height, -floor, joints, soles)


def choose_height(legs: tuple[LegSolver, ...]) -> tuple[float, float]:
    """Choose the hip height [m] for the gait; return the height and the fraction of foot positions within reach.

    The result is the greatest height from which the feet reach all positions, or else the height from which they reach
    the largest number of them. Only the first and the last leg are tested.

    Raises:
        InvalidInput: the robot cannot stand, or its feet reach no position, at any height.
    """
    pair = (legs[0], legs[-1])
    length = min(leg.length for leg in legs)
    best = (0.0, -1.0)
    for share in SHARES:
        height = round(float(share) * length + float(legs[0].foot.size.min()) / 2.0, 3)
        posture = stand(pair, height)
        if posture is None:
            continue
        reached = float(np.mean([reach_share(leg, posture) for leg in pair]))
        if reached > best[1] + 1e-9:
            best = (height, reached)
        if reached == 1.0:
            break
    if best[0] == 0.0:
        raise InvalidInput(
            "the robot cannot stand level over its feet at any height: does x of its base point forward, z up, and can "
            "each foot be below its hip within the joint limits?"
        )
    if best[1] == 0.0:
        raise InvalidInput(
            "the robot stands, but its feet reach no position of the gait around them at any height: check the joint "
            "limits, or give a height with --height"
        )
    return best


def reach_share(leg: LegSolver, posture: FoundPosture) -> float:
    """Fraction of the positions FOOT_OFFSETS around the standing foot that the leg reaches."""
    start = np.array([posture.joint_positions[joint] for joint in leg.leg.joints])
    tip = posture.soles[leg.leg.name] + (0.0, 0.0, leg.foot.lowest(leg.foot_rotation(start)))
    found = leg.solver(start).solve(tip + FOOT_OFFSETS, np.zeros(len(FOOT_OFFSETS)))
    return float(np.mean(~np.isnan(found[:, 0])))


def raised(tree: KinematicTree, legs: tuple[LegSolver, ...], posture: FoundPosture, lift: float) -> FoundPosture | None:
    """Posture with the body `lift` [m] higher above the same sole frames; None if out of reach.

    Args:
        tree: the robot with its sole frames.
        legs: the robot's legs.
        posture: posture from which the body is lifted.
        lift: rise of the body [m].
    """
    joints, soles = dict(posture.joint_positions), {}
    for leg in legs:
        start = np.array([joints[joint] for joint in leg.leg.joints])
        target = posture.soles[leg.leg.name] - (0.0, 0.0, lift)
        found = NumericLeg(tree, leg.leg.name, start).solve(target[None], np.zeros(1))[0]
        if np.any(np.isnan(found)):
            return None
        joints.update(zip(leg.leg.joints, found.tolist(), strict=True))
        soles[leg.leg.name] = target
    return FoundPosture(posture.hip_height + lift, posture.base_height + lift, joints, soles)
