"""Checks of a robot folder: files, the robot in its postures, and a simulated walk."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from guara_perception.app.robot_folder.collisions import touching
from guara_perception.app.robot_folder.finding import Finding, Weight, note, wrong
from guara_perception.app.robot_folder.postures import FOOT_OFFSETS
from guara_perception.app.robot_folder.scan_checks import scan_findings
from guara_perception.app.robot_folder.trial_walk import TrialWalk
from guara_perception.exceptions import FileFormatError, PerceptionError
from guara_perception.settings import Settings
from kinematics import (
    KinematicsError,
    RobotFileError,
    RobotFileWarning,
    RobotModel,
    Stance,
    load_robot,
    stability_margin,
)
from kinematics.model_checks import sole_above_foot
from kinematics.srdf import allowed_pairs
from kinematics.tree import RobotState
from kinematics.urdf import Link

# Largest distance of a sole frame above or below the lowest point of its foot [m]; a larger distance would exceed the
# noise of a cell's height.
SOLE_OFF_M = 0.002
# Smallest distance of a leg joint from its limits, so that the body can tilt on uneven ground [rad].
LIMIT_MARGIN = 0.05
# Smallest distance of the centre of mass from the edge of the support polygon [m].
BALANCE_M = 0.020
# Largest tilt of the body in its scan posture [rad].
LARGEST_TILT = 0.0175


def check_robot(folder: Path) -> tuple[RobotModel | None, list[Finding]]:
    """Run all checks of a robot, given by folder or name, except the simulated walk.

    Returns the robot, or None if it cannot be loaded, and the findings.
    """
    findings: list[Finding] = []
    robot: RobotModel | None = None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RobotFileWarning)
            robot = load_robot(folder)
        Settings.of(robot)
    except (RobotFileError, FileFormatError) as error:
        findings += [Finding(Weight.UNUSABLE, *_subject_and_text(text)) for text in error.findings]
    except (KinematicsError, PerceptionError) as error:
        findings.append(Finding(Weight.UNUSABLE, str(folder), str(error)))
    else:
        with warnings.catch_warnings():
            # Warnings of joints beyond their limits are suppressed: `_limits` reports those of the legs.
            warnings.simplefilter("ignore")
            findings += [*_file_findings(robot), *body_findings(robot), *scan_findings(robot)]
    return robot, findings


def _subject_and_text(text: str) -> tuple[str, str]:
    """Split a finding of `load_robot` into its subject (file and line) and the problem."""
    subject, separator, rest = text.partition(": ")
    return (subject, rest) if separator else ("robot folder", text)


def _file_findings(robot: RobotModel) -> Iterator[Finding]:
    for text in robot.notes:
        is_ignored = "the self-filter ignores it" in text
        yield wrong("urdf", text) if is_ignored else note("urdf", f"not used or not checked: {text}")
    for text in robot.doubts:
        subject, _, rest = text.partition(": ")
        yield wrong(f"robot.toml {subject}", rest)
    for key, what in robot.config.assumed.items():
        yield note(f"robot.toml [assumed] {key}", f"assumed, not measured: {what}")


def walk_findings(walk: TrialWalk) -> Iterator[Finding]:
    """Yield the findings of a simulated walk."""
    if walk.ended is not None:
        yield wrong("simulated walk", f"ended after {walk.pauses} pauses: {walk.ended}")
    if walk.unknown_called_safe:
        yield wrong("simulated walk", f"unknown cells called traversable: {walk.unknown_called_safe}")
    if walk.feet_on_hazard:
        yield wrong("simulated walk", f"{walk.feet_on_hazard} of {walk.feet} footholds were on a hazard")


def body_findings(robot: RobotModel) -> Iterator[Finding]:
    """Yield the findings of the robot in its postures."""
    for name in robot.posture_names:
        state = robot.state(robot.posture(name))
        yield from _collisions(robot, name, state)
        yield from _limits(robot, name, state)
    state = robot.state(robot.posture(robot.config.scan_posture))
    yield from _soles(robot, state)
    yield from _reach(robot, state)
    yield from _balance(robot)
    yield from _shapes(robot)


def _collisions(robot: RobotModel, posture: str, state: RobotState) -> Iterator[Finding]:
    srdf = robot.folder / "srdf" / f"{robot.name}.srdf"
    for first, second in touching(state, allowed_pairs(srdf)):
        yield wrong(
            f"posture {posture!r}",
            f"links {first!r} and {second!r} touch: choose another posture, or name the pair in "
            "<disable_collisions> of the SRDF if they touch by construction",
        )


def _limits(robot: RobotModel, posture: str, state: RobotState) -> Iterator[Finding]:
    tree = robot.tree
    room = np.minimum(state.positions - tree.lower_limits, tree.upper_limits - state.positions)
    leg_joints = {joint for leg in tree.legs.values() for joint in leg.joints}
    for joint, margin in zip(robot.joint_names, room.tolist(), strict=True):
        if margin < LIMIT_MARGIN and joint in leg_joints:
            yield wrong(
                f"posture {posture!r}",
                f"joint {joint!r} has a margin of {margin:.3f} rad to its limits; at least {LIMIT_MARGIN} rad is "
                "required so that the body can tilt: choose another height",
            )


def _soles(robot: RobotModel, state: RobotState) -> Iterator[Finding]:
    for name, leg in robot.tree.legs.items():
        above = sole_above_foot(robot.tree, leg, state)
        if above is None:
            yield note(
                f"legs.{name}", "its foot has no collision shape, so the position of the sole frame was not checked"
            )
        elif abs(above) > SOLE_OFF_M:
            where = "above" if above > 0 else "below"
            yield wrong(
                f"legs.{name}.sole",
                f"{leg.sole!r} is {1e3 * abs(above):.1f} mm {where} the lowest point of the foot in the scan posture: "
                "every foothold is off by as much; move the frame to where the foot touches the ground",
            )


def _reach(robot: RobotModel, state: RobotState) -> Iterator[Finding]:
    for name in robot.legs:
        sole = state.soles_in_base([name])[0]
        missed = FOOT_OFFSETS[~robot.reachable(name, sole + FOOT_OFFSETS)]
        if len(missed):
            x, y, z = (1e3 * value for value in missed[0])
            yield wrong(
                f"legs.{name}",
                f"does not reach {len(missed)} of {len(FOOT_OFFSETS)} positions of the gait around the "
                f"standing foot, such as {x:+.0f} mm ahead, {y:+.0f} mm to the left, {z:+.0f} mm up: choose "
                "another scan height",
            )


def _balance(robot: RobotModel) -> Iterator[Finding]:
    pose = robot.stance_pose(Stance(robot.posture(robot.config.scan_posture), robot.legs), find_unloaded=False)
    tilt = float(np.arccos(np.clip(pose.up_in_base[2], -1.0, 1.0)))
    if tilt > LARGEST_TILT:
        yield wrong(
            f"posture {robot.config.scan_posture!r}",
            f"the body is tilted by {np.degrees(tilt):.1f} degrees relative to the plane of its soles; the measured "
            "terrain would be tilted as well",
        )
    margin = stability_margin(pose)
    if margin < BALANCE_M:
        yield wrong(
            f"posture {robot.config.scan_posture!r}",
            f"the centre of mass is {1e3 * abs(margin):.0f} mm {'inside' if margin >= 0 else 'outside'} the polygon of "
            f"the soles; {1e3 * BALANCE_M:.0f} mm inside are needed: are the masses in the URDF right, and do the feet "
            "stand below the body?",
        )
    if robot.config.imu_frame is None:
        yield note(
            "frames.imu",
            "not set: gravity comes from the gait's message or from odometry; without either, from the soles",
        )


def _shapes(robot: RobotModel) -> Iterator[Finding]:
    tree = robot.tree
    for name, leg in tree.legs.items():
        links = [joint.child for joint in tree.urdf.path_to(leg.sole)]
        if not any(tree.links[link].shapes for link in links):
            yield wrong(
                f"legs.{name}",
                "none of its links has a collision shape, so the self-filter cannot remove it from scans",
            )
    # Links fixed to one another form one body, so a shape of any of them is sufficient.
    bodies: dict[tuple[str, ...], list[Link]] = {}
    for link in tree.urdf.links:
        carriers = tuple(joint.name for joint in tree.urdf.path_to(link.name) if joint.kind != "fixed")
        bodies.setdefault(carriers, []).append(link)
    bare = [links[0].name for links in bodies.values() if not any(link.shapes for link in links)]
    if bare:
        yield note("urdf", f"the self-filter ignores links without a collision shape: {', '.join(bare)}")
