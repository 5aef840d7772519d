"""Proposal of a robot folder, derived from a URDF alone: legs, soles, postures, mounts and scan pattern."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from guara_perception.app.robot_folder.legs import Foot, FoundLeg, LegSolver, find_foot, find_legs, tree_of, with_frame
from guara_perception.app.robot_folder.mounts import FoundMounts, find_mounts
from guara_perception.app.robot_folder.postures import FoundPosture, choose_height, raised, stand
from guara_perception.exceptions import InvalidInput
from kinematics.robot_toml import LegConfig
from kinematics.scan_pattern import mirror_angle_for
from kinematics.transforms import inverse, translation
from kinematics.urdf import Urdf
from kinematics.urdf_checks import root_link

STANDING_HIGHER = (1.05, 1.03, 1.01)
STRIPES_PER_M = 70 / 0.45
# The first and the last stripe fall this far outside the area [m].
PATTERN_MARGIN_M = 0.006
# Side of a sole if the foot has no shape [m].
UNKNOWN_SOLE_M = 0.030
LEAST_SOLE_M = 0.020
# Part of a ball's diameter that can touch the ground: on level ground, the contact of a standing foot rolls by up to a
# sixth of the diameter to either side, and rubber flattens by a tenth on either side.
CONTACT_SHARE = 0.55
HALF_SWING_M = 0.07
# Plausible lengths of a leg [m]; other lengths are probably not in metres.
LEG_M = (0.05, 5.0)
# Joint limits between two turns in radians and two turns in degrees are probably in degrees. Larger ones mean "no
# limit".
DEGREES = (4.0 * np.pi, 720.0)


@dataclass(frozen=True, slots=True, eq=False)
class Proposal:
    """Proposed contents of a robot folder.

    Attributes:
        urdf: the given URDF with added frames for soles, camera and laser.
        name: name of the robot.
        base: root link of the robot.
        legs: the legs found, each with its foot and solver.
        leg_configs: legs for robot.toml.
        sole: length and width of a sole [m].
        sole_radius: radius of round feet [m]; 0 if a foot is flat or has no shape.
        scan, standing: postures. In both, joints outside the legs are as close to zero as their limits allow.
        reach: fraction of the gait's foot positions that are within reach; None if the hip height was given.
        mounts: camera, laser and scanned area.
        mirror_angles: first and last mirror angle of the scan pattern [rad].
        stripes: number of stripes of the pattern.
        camera_frame, laser_frame: names in the URDF.
    """

    urdf: Urdf
    name: str
    base: str
    legs: tuple[LegSolver, ...]
    leg_configs: tuple[LegConfig, ...]
    sole: tuple[float, float]
    sole_radius: float
    scan: FoundPosture
    standing: FoundPosture
    reach: float | None
    mounts: FoundMounts
    mirror_angles: tuple[float, float]
    stripes: int
    camera_frame: str
    laser_frame: str


def propose(urdf: Urdf, name: str, hip_height: float | None = None) -> Proposal:
    """Propose a robot folder.

    Args:
        urdf: URDF, read and checked.
        name: name of the robot.
        hip_height: height of the hips above the soles in the scan posture [m]; None = chosen for the reach of the feet.

    Raises:
        InvalidInput: fewer than three legs are found, legs share joints, lengths or limits have the wrong unit, the
            robot cannot stand on its legs, or its feet reach no position of the gait.
    """
    found = find_legs(urdf)
    legs = tuple(LegSolver(urdf, leg, find_foot(urdf, leg)) for leg in found)
    _check_units(urdf, legs)
    height, reach = choose_height(legs) if hip_height is None else (hip_height, None)
    scan = stand(legs, height)
    if scan is None:
        raise InvalidInput(f"the legs cannot stand with the hips {height} m above the soles: give another --height")
    rest = {
        joint.name: float(np.clip(0.0, joint.lower, joint.upper))
        for joint in urdf.joints
        if joint.kind != "fixed" and joint.name not in scan.joint_positions
    }
    scan = replace(scan, joint_positions={**scan.joint_positions, **rest})
    extended, leg_configs = _with_soles(replace(urdf, name=name), legs, scan)
    sole = _sole([leg.foot for leg in legs])
    tree = tree_of(extended, leg_configs, sole)
    higher = (raised(tree, legs, scan, round(height * share - height, 3)) for share in STANDING_HIGHER)
    standing = next((posture for posture in higher if posture is not None), scan)
    mounts = find_mounts(tree, scan, sole, _half_swings(legs, scan))
    camera_frame, laser_frame = (_free(extended, wanted) for wanted in ("rangefinder_camera", "rangefinder_laser"))
    extended = with_frame(extended, root_link(urdf), camera_frame, mounts.transform_camera_to_base)
    extended = with_frame(extended, root_link(urdf), laser_frame, translation(mounts.mirror))
    mirror_height = float(mounts.mirror[2]) + scan.base_height
    first, last = (
        round(mirror_angle_for(float(mounts.mirror[0]), mirror_height, x), 5)
        for x in (mounts.area_x[0] - PATTERN_MARGIN_M, mounts.area_x[1] + PATTERN_MARGIN_M)
    )
    return Proposal(
        urdf=extended,
        name=name,
        base=root_link(urdf),
        legs=legs,
        leg_configs=leg_configs,
        sole=sole,
        sole_radius=_sole_radius([leg.foot for leg in legs]),
        scan=scan,
        standing=standing,
        reach=reach,
        mounts=mounts,
        mirror_angles=(first, last),
        stripes=round(STRIPES_PER_M * (mounts.area_x[1] - mounts.area_x[0])),
        camera_frame=camera_frame,
        laser_frame=laser_frame,
    )


def _check_units(urdf: Urdf, legs: tuple[LegSolver, ...]) -> None:
    """Check that lengths can be metres and joint limits radians."""
    for leg in legs:
        if not LEG_M[0] <= leg.length <= LEG_M[1]:
            raise InvalidInput(
                f"{urdf.path}: the leg of {leg.leg.foot!r} is {leg.length:.3g} m long, allowed: {LEG_M[0]:g} ... "
                f"{LEG_M[1]:g} m. Lengths in a URDF are in metres (<mesh scale> too): convert them in a copy"
            )
        for joint in urdf.joints:
            largest = max(abs(joint.lower), abs(joint.upper))
            if joint.name in leg.leg.joints and joint.kind == "revolute" and DEGREES[0] < largest <= DEGREES[1]:
                raise InvalidInput(
                    f"{urdf.path}:{joint.line}: joint {joint.name!r} has the limits {joint.lower:g} ... "
                    f"{joint.upper:g} rad, more than two turns. Limits in a URDF are in radians: convert them in a copy"
                )


def _free(urdf: Urdf, wanted: str) -> str:
    """Free name for a new link: `wanted`, with a number appended if a link or joint already uses that name."""
    taken = {link.name for link in urdf.links} | {joint.name for joint in urdf.joints}
    names = [wanted, *(f"{wanted}_{number}" for number in range(2, 100))]
    return next(name for name in names if name not in taken and f"{name}_joint" not in taken)


def _with_soles(urdf: Urdf, legs: tuple[LegSolver, ...], scan: FoundPosture) -> tuple[Urdf, tuple[LegConfig, ...]]:
    """Add a sole frame to each foot, at its ground contact in the scan posture and parallel to the base.

    Returns:
        The URDF with these frames, and the legs for robot.toml.
    """
    configs = []
    for leg in legs:
        name = _free(urdf, f"{leg.leg.name}_sole")
        positions = np.array([scan.joint_positions[joint] for joint in leg.leg.joints])
        to_base = leg.transforms(positions)[-1]
        urdf = with_frame(urdf, leg.foot.link, name, inverse(to_base) @ translation(scan.soles[leg.leg.name]))
        configs.append(LegConfig(leg.leg.name, leg.hip, name, leg.leg.joints))
    return urdf, tuple(configs)


def _sole(feet: list[Foot]) -> tuple[float, float]:
    """Length and width of a sole [m], each the smallest over all feet, but at least LEAST_SOLE_M.

    Length and width of a flat foot are its two longer sides. For a round foot, both are the part of its diameter that
    can touch the ground.
    """
    lengths: list[tuple[float, ...]] = []
    for foot in feet:
        if not foot.shapes:
            lengths.append((UNKNOWN_SOLE_M, UNKNOWN_SOLE_M))
        elif foot.is_round:
            lengths.append((min(foot.size.min(), CONTACT_SHARE * foot.size.max()),) * 2)
        else:
            lengths.append(tuple(np.sort(foot.size)[:0:-1]))
    length, width = (max(round(float(side) - 0.0005, 3), LEAST_SOLE_M) for side in np.min(lengths, axis=0))
    return length, width


def _sole_radius(feet: list[Foot]) -> float:
    """Radius of round feet [m]; 0 if a foot is flat or has no shape.

    The radius is half the largest extent of the smallest foot, since a mesh may contain only the lower half of a ball.
    """
    if not all(foot.is_round and foot.shapes for foot in feet):
        return 0.0
    return float(min(foot.size.max() for foot in feet)) / 2.0


def _half_swings(legs: tuple[LegSolver, ...], scan: FoundPosture) -> tuple[dict[str, float], ...]:
    """Joint positions with the front feet half a swing forward, and half a swing back; feet out of reach stay."""
    front = max(float(sole[0]) for sole in scan.soles.values())
    found = []
    for offset in (HALF_SWING_M, -HALF_SWING_M):
        joints = dict(scan.joint_positions)
        for leg in legs:
            sole = scan.soles[leg.leg.name]
            if sole[0] < front - 0.05:
                continue
            start = np.array([scan.joint_positions[joint] for joint in leg.leg.joints])
            tip = sole + (offset, 0.0, leg.foot.lowest(leg.foot_rotation(start)))
            moved = leg.solve(start, tip)
            if moved is not None:
                joints.update(zip(leg.leg.joints, moved.tolist(), strict=True))
        found.append(joints)
    return tuple(found)


def kind_of(leg: FoundLeg, foot: Foot) -> str:
    """Short description of a leg: number of joints, and type of foot."""
    return f"{len(leg.joints)} joints, {'point foot' if foot.is_round else 'flat sole'}"
