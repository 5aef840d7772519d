"""Joints that read wrong: jumps and wrong zeros that are told, and alarms on clean walks.

`python -m benchmarks joints [--pauses 500] [--robot guara go2]`. Guará, and Go2 from its stock URDF (extra
`robots-test`), walk on level ground with 0.2 degrees of joint noise fresh in every pause and feet that creep by 1.4 mm
per axis between two pauses.
"""

from __future__ import annotations

import copy
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from unittest.mock import patch

from benchmarks.command import Table, options
from guara_perception.simulation.walk import WalkPause
from kinematics import JointCheck, RobotModel, joint_check
from testbed.misread_joints import ERROR, alarms, is_named, load, misread, walk

# Pauses after which a cycle, and two, are over.
CYCLES = (4, 8)
# Creep and sinkage of feet that do neither [m].
STANDING = 1e-4


@dataclass(slots=True)
class Told:
    """Of one joint after each of `CYCLES`: sigma of its zero, and the least wrong zero told on each walk [rad].

    `still` is the sigma if no foot crept or sank. Jumps and zeros are those told, and tried.
    """

    sigmas: tuple[float, ...] = ()
    still: tuple[float, ...] = ()
    bars: dict[int, list[float]] = field(default_factory=lambda: {cycle: [] for cycle in CYCLES})
    jumps: list[bool] = field(default_factory=list)
    zeros: dict[int, list[bool]] = field(default_factory=lambda: {cycle: [] for cycle in CYCLES})


def jumps_told(robot: RobotModel, pauses: Sequence[WalkPause], found: dict[str, Told]) -> None:
    """Let each joint jump at each pause after the first cycle at which its foot stands."""
    check = JointCheck(robot)
    for before, pause in zip((None, *pauses), pauses, strict=False):
        if before is not None and pause.step > CYCLES[0]:
            for leg in robot.legs:
                for joint in robot.tree.leg(leg).joints if leg != before.next_leg else ():
                    for error in (ERROR, -ERROR):
                        report = copy.copy(check).update(misread(pause.stance, joint, error))
                        found[joint].jumps.append(is_named(report.faults, joint, "jump"))
        check.update(pause.stance)


def zeros_told(robot: RobotModel, pauses: Sequence[WalkPause], found: dict[str, Told]) -> None:
    """Give each joint a wrong zero from the start of a walk."""
    for joint in robot.joint_names:
        for error in (ERROR, -ERROR):
            check, told = JointCheck(robot), False
            for pause in pauses[: CYCLES[-1] + 1]:
                told |= is_named(check.update(misread(pause.stance, joint, error)).faults, joint, "offset")
                if pause.step in CYCLES:
                    found[joint].zeros[pause.step].append(told)


def measured(robot: RobotModel, *, has_imu: bool, walks: int) -> dict[str, Told]:
    """Errors of every joint on some walks of three cycles."""
    found = {joint: Told() for joint in robot.joint_names}
    for seed in range(walks):
        pauses = walk(robot, 13, 100 + seed, has_imu=has_imu)
        jumps_told(robot, pauses[:9], found)
        zeros_told(robot, pauses, found)
        check = JointCheck(robot)
        for pause in pauses[: CYCLES[-1] + 1]:
            check.update(pause.stance)
            if pause.step in CYCLES:
                for joint, bar in check.bars.items():
                    found[joint].bars[pause.step].append(bar)
                if seed == walks - 1:
                    sigmas = check.sigmas
                    with patch.multiple(joint_check, SLIP_SIGMA=STANDING, SINK_SIGMA=STANDING):
                        still = check.sigmas
                    for joint, told in found.items():
                        told.sigmas += (sigmas[joint],)
                        told.still += (still[joint],)
    return found


def main() -> None:
    """Command line."""
    asked = options(
        __doc__,
        pauses=(500, "pauses of clean walks"),
        walks=(5, "walks on which each joint reads wrong, either way"),
        robot=(["guara", "go2"], "names of robots"),
    )
    warnings.simplefilter("ignore")
    for name in asked.robot:
        robot = load(name)
        for has_imu in (True, False):
            clean = walk(robot, asked.pauses, 0, has_imu=has_imu)
            given = "IMU" if has_imu else "no IMU"
            print(f"{name}, {given}: {alarms(robot, clean)} alarms in {len(clean)} clean pauses")
            print(
                "sigma of a zero, and if no foot crept, least told on the walks (rad), zeros told; after 1, 2 cycles:"
            )
            table = Table("joint:<16 | sigma:<12 | no creep:<12 | told from:<32 | jumps:8 | zeros:10")
            for joint, told in measured(robot, has_imu=has_imu, walks=asked.walks).items():
                sigmas, still = (
                    " ".join(f"{sigma:.3f}" if sigma < 1 else "-" for sigma in each)
                    for each in (told.sigmas, told.still)
                )
                zeros = " ".join(f"{sum(each)}/{len(each)}" for each in told.zeros.values())
                bars = ", ".join(f"{min(each):.3f} to {max(each):.3f}" for each in told.bars.values())
                table.row(joint, sigmas, still, bars, f"{sum(told.jumps)}/{len(told.jumps)}", zeros)


if __name__ == "__main__":
    main()
