"""Texts of robot.toml and README.md of a proposed robot, from two templates beside this module."""

from __future__ import annotations

from math import ceil
from pathlib import Path
from typing import Any

from guara_perception.app.robot_folder.postures import FoundPosture
from guara_perception.app.robot_folder.propose import Proposal, kind_of

# Wave gait: advance of a cycle [m], number of its pauses, its duration at the slowest pace without scans [s], and the
# duration of a scan [s].
CYCLE_M, PAUSES, CYCLE_S, SCAN_S = 0.140, 4, 18.7, 7.0
SWING_HEIGHT_M = 0.060


def assumed(proposal: Proposal) -> dict[str, str]:
    """Assumed fields of robot.toml, each with instructions for measuring it before the robot walks."""
    legs = {
        f"legs.{leg.leg.name}.sole": "check that the frame is where this foot touches the floor in the scan posture"
        for leg in proposal.legs
    }
    return {
        "sole": "measure the part of a foot that rests on the ground, along and across",
        **legs,
        "frames.camera": "mount the camera, measure its position, and calibrate: the calibration overrides it",
        "frames.laser": "mount the mirror, measure its position, and calibrate: the calibration overrides it",
        "traversability.slope_limit": "find the steepest ground on which a foot holds",
        "traversability.step_limit": "half the height to which a swing lifts a foot",
        "traversability.drop_limit": "find how far a foot may slip off an edge before the body tilts too much",
        "traversability.roughness_limit": "largest unevenness under one sole on which the robot stands",
        "heights.minimum": "one and a half times the highest step that the robot climbs down",
        "heights.maximum": "twice the height to which a swing lifts a foot",
        "stance.encoder_sigma": "set each joint to a known angle, and compare it with the reading",
        "stance.encoder_noise": "read the joints of the standing robot for a minute: standard deviation of one joint",
        "stance.centre_of_mass_sigma": "weigh the robot on its feet, and compare with the masses in the URDF",
    }


def toml_text(proposal: Proposal, source: str) -> str:
    """Text of robot.toml: every value with its reason, and the list of values that are not measured.

    Args:
        proposal: the proposed robot.
        source: name of the URDF from which the proposal was made.
    """
    p, m = proposal, proposal.mounts
    legs = (
        f"""
[legs.{leg.name}]
hip = "{leg.hip}"    # moved by the first joint that swings the foot fore and aft
sole = "{leg.sole}"    # under the foot where it touches the ground in the scan posture
joints = [{", ".join(f'"{joint}"' for joint in leg.joints)}]
"""
        for leg in p.leg_configs
    )
    hind = min(float(sole[0]) for sole in p.scan.soles.values())
    cycles = ceil((m.area_x[1] - hind) / CYCLE_M) + 1
    return _filled(
        "robot.toml.template",
        p,
        source,
        sole_reason=_sole_reason(p),
        sole_radius=_sole_radius(p),
        legs="".join(legs),
        height_reason=_height_reason(p),
        scan_camera=camera_height(p, p.scan),
        standing_camera=camera_height(p, p.standing),
        map_x=(round(hind - 0.30, 2), m.area_x[1] + 0.05),
        map_y=(m.area_y[0] - 0.08, m.area_y[1] + 0.08),
        maximum=2 * SWING_HEIGHT_M + 0.01,
        step=SWING_HEIGHT_M / 2,
        swing=1e3 * SWING_HEIGHT_M,
        minimum=-1.5 * SWING_HEIGHT_M - 0.01,
        # A foot that drops so far tilts the body by about 3 degrees or less if feet are as far apart as hips are high.
        drop=min(round(0.055 * p.scan.hip_height, 3), 0.020),
        # The sole enlarged by the disc covers a whole round foot, so that no ground below it rises by more than a step.
        disc=max(0.015, round(min(p.sole) / 4.0, 3), round(p.sole_radius - min(p.sole) / 2.0, 3)),
        pauses=min(cycles * PAUSES, 255),
        seconds=cycles * (CYCLE_S + PAUSES * SCAN_S),
        cycle=CYCLE_S,
        scan_time=SCAN_S,
        assumed="\n".join(f'"{key}" = "{how}"' for key, how in assumed(p).items()),
    )


def readme_text(proposal: Proposal, source: str, notes: tuple[str, ...]) -> str:
    """Text of README.md of the robot folder.

    Args:
        proposal: the proposed robot.
        source: name of the URDF from which the proposal was made.
        notes: unused parts of the URDF.
    """
    p = proposal
    legs = (
        f"| `{leg.name}` | {', '.join(leg.joints)} | `{leg.hip}` | {kind_of(found.leg, found.foot)} |"
        for leg, found in zip(p.leg_configs, p.legs, strict=True)
    )
    return _filled(
        "README.md.template",
        p,
        source,
        unused="\n".join(f"- {note}" for note in notes) or "- nothing",
        legs="\n".join(legs),
        camera=camera_height(p, p.scan),
        measure="\n".join(f"| `{key}` | {how} |" for key, how in assumed(p).items()),
    )


def _filled(template: str, proposal: Proposal, source: str, **values: Any) -> str:
    text = Path(__file__).with_name(template).read_text(encoding="utf-8")
    return text.format(p=proposal, m=proposal.mounts, source=source, **values)


def camera_height(proposal: Proposal, posture: FoundPosture) -> float:
    """Height of the optical centre above the plane of the soles in a posture [m]."""
    return float(proposal.mounts.camera[2]) + posture.base_height


def _sole_radius(p: Proposal) -> str:
    """Line of robot.toml with the radius of round feet; empty for other feet."""
    if not p.sole_radius:
        return ""
    return f"sole_radius = {p.sole_radius:.4f}    # of the round foot, which lifts the sole frame when it rolls\n"


def _sole_reason(p: Proposal) -> str:
    foot = p.legs[0].foot
    if not foot.shapes:
        return "a guess, since the foot has no shape in the URDF"
    return "contact of the round foot: 0.55 of its diameter" if foot.is_round else "the foot's collision shape"


def _height_reason(p: Proposal) -> str:
    if p.reach is None:
        return "given by --height"
    if p.reach >= 1.0:
        return "the greatest from which the feet reach 0.13 m fore and aft, 20 mm down and 60 mm up"
    return f"the one from which the feet reach the most positions of the gait: {p.reach:.0%}"
