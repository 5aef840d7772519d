"""Detection of wrong joint readings: jumps, wrong zeros, and false alarms on clean walks.

`python -m benchmarks joints [--pauses 500] [--robot guara go2]`. Guará, and Go2 from its stock URDF (extra
`robots-test`), walk on level ground with 0.2 degrees of joint noise fresh in every pause and feet that creep by 1.4 mm
per axis between two pauses. The gait declares the ground below the first stance, or not. Clean pauses are one walk, and
as many in walks of two cycles.

Sigmas, and shares derived from them, are those of a wrong zero after one and two cycles. Attainable is the share of
errors of 0.1 rad that the best test with as few alarms detects (Neyman and Pearson: `STATED_SIGMAS`), first with the
noise stated in robot.toml, then with the noise of these walks, which the check does not know.
"""

from __future__ import annotations

import copy
import math
import warnings
from collections import defaultdict
from collections.abc import Callable, Sequence
from statistics import NormalDist
from unittest.mock import patch

import numpy as np

from benchmarks.command import Table, options
from guara_perception.simulation.walk import WalkPause
from kinematics import JointCheck, RobotModel, joint_check
from testbed.misread_joints import CREEP, ERROR, alarms, ground_of, is_named, load, misread, walk

# Pauses after which a cycle, and two, are over.
CYCLES = (4, 8)
# Noise of these walks as `JointCheck` states it: creep between two pauses as noise of each, and no sinkage.
WALKED_SLIP, WALKED_SINK = CREEP / math.sqrt(2.0), 1e-4


# Values of a joint by kind and pause: True for each "zero" that was detected by then; "sigma" of its zero by the stated
# noise, and as "walked" by that of the walks [rad]. Of all pauses: True for each "jump" that was detected; number of
# joints "named" together with a zero.
Told = dict[tuple[str, int], list[float]]


def detect_jumps(robot: RobotModel, pauses: Sequence[WalkPause], found: dict[str, Told]) -> None:
    """Let each joint jump at each pause after the first cycle in which its foot stands."""
    check = JointCheck(robot)
    for before, pause in zip((None, *pauses), pauses, strict=False):
        if before is not None and pause.step > CYCLES[0]:
            for leg in robot.legs:
                for joint in robot.tree.leg(leg).joints if leg != before.next_leg else ():
                    for error in (ERROR, -ERROR):
                        report = copy.copy(check).update(misread(pause.stance, joint, error))
                        found[joint]["jump", 0].append(is_named(report.faults, joint, "jump"))
        check.update(pause.stance, ground_of(pause))


def detect_zeros(robot: RobotModel, pauses: Sequence[WalkPause], found: dict[str, Told]) -> None:
    """Give each joint a wrong zero from the start of a walk."""
    for joint, of_joint in found.items():
        for error in (ERROR, -ERROR):
            check, told = JointCheck(robot), False
            for pause in pauses[: CYCLES[-1] + 1]:
                faults = check.update(misread(pause.stance, joint, error), ground_of(pause)).faults
                if not told and is_named(faults, joint, "offset"):
                    told = True
                    of_joint["named", 0] += [len(fault.joints) for fault in faults if joint in fault.joints]
                if pause.step in CYCLES:
                    of_joint["zero", pause.step].append(told)


def measured(robot: RobotModel, walks: Sequence[list[WalkPause]]) -> dict[str, Told]:
    """Errors of every joint on some walks."""
    found: dict[str, Told] = {joint: defaultdict(list) for joint in robot.joint_names}
    for pauses in walks:
        detect_jumps(robot, pauses[:9], found)
        detect_zeros(robot, pauses, found)
        check = JointCheck(robot)
        for pause in pauses[: CYCLES[-1] + 1]:
            check.update(pause.stance, ground_of(pause))
            if pause.step in CYCLES:
                sigmas = check.sigmas
                with patch.multiple(joint_check, SLIP_SIGMA=WALKED_SLIP, SINK_SIGMA=WALKED_SINK):
                    walked = check.sigmas
                for joint, told in found.items():
                    told["sigma", pause.step].append(sigmas[joint])
                    told["walked", pause.step].append(walked[joint])
    return found


def attainable(sigmas: Sequence[float]) -> float:
    """Share [%] of errors of size ERROR detected by the best test with its threshold at STATED_SIGMAS."""
    return 100.0 * float(np.mean([NormalDist().cdf(ERROR / sigma - joint_check.STATED_SIGMAS) for sigma in sigmas]))


def shown(told: Told, what: str, form: Callable[[list[float]], str]) -> str:
    """One word for each cycle."""
    return " ".join(f"{form(told[what, cycle]):>5}" for cycle in CYCLES)


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
        for has_imu, is_declared in ((True, True), (True, False), (False, True), (False, False)):
            walking = {"has_imu": has_imu, "is_declared": is_declared}
            short = [walk(robot, CYCLES[-1] + 1, 1000 + seed, **walking) for seed in range(asked.pauses // 9)]
            clean = [walk(robot, asked.pauses, 0, **walking), *short]
            print(
                f"{name}, {'IMU' if has_imu else 'no IMU'}, {'declared' if is_declared else 'unknown'} ground: "
                f"{sum(alarms(robot, pauses) for pauses in clean)} alarms in {sum(map(len, clean))} clean pauses"
            )
            table = Table(
                "joint:<15 | sigma:<12 | attainable %:<12 | of these walks %:<16 | zeros:<12 | named:.1f | jumps:8"
            )
            walks = [walk(robot, 13, 100 + seed, **walking) for seed in range(asked.walks)]
            for joint, told in measured(robot, walks).items():
                jumps, named = told["jump", 0], told["named", 0]
                table.row(
                    joint,
                    shown(told, "sigma", lambda each: f"{np.median(each):.3f}" if np.median(each) < 1 else "-"),
                    *(shown(told, what, lambda each: f"{attainable(each):.0f}") for what in ("sigma", "walked")),
                    shown(told, "zero", lambda each: f"{sum(each)}/{len(each)}"),
                    np.mean(named or [0]),
                    f"{sum(jumps)}/{len(jumps)}",
                )


if __name__ == "__main__":
    main()
