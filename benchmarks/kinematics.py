"""Median time of each call of the package `kinematics`; its errors are held by tests/kinematics.

`python -m benchmarks kinematics [--quick]`.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial

import numpy as np

from kinematics import LegOdometry, SelfFilter, Stance, load_robot, reach_from_pose
from testbed.analytic_walk import Ground, walk


def median_ms(call: Callable[[], object], repeats: int) -> float:
    """Median time of a call [ms], after one to warm up."""
    call()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return 1e3 * float(np.median(times))


def cold_load_seconds(repeats: int) -> float:
    """Time of importing the package and loading the robot in a fresh process [s]."""
    code = "import time; t = time.perf_counter(); import kinematics; kinematics.load_robot('guara')"
    code += "; print(time.perf_counter() - t)"
    return float(
        np.median([float(subprocess.check_output([sys.executable, "-c", code], timeout=120)) for _ in range(repeats)])
    )


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer repeats: for a first impression, not for figures")
    quick = parser.parse_args().quick
    repeats = 5 if quick else 50
    rows = [("loading the robot, cold, fresh process", f"{cold_load_seconds(2 if quick else 5):.2f} s", "1.2 s")]
    robot = load_robot("guara")
    stance = Stance(robot.posture("scan"), robot.legs, (0.0, 0.0, -1.0))
    feet_only = Stance(robot.posture("scan"), robot.legs)
    for what, given in (("gravity known", stance), ("feet only", feet_only)):
        spent = median_ms(partial(robot.stance_pose, given), 4 * repeats)
        rows.append((f"whole stance pose, {what}", f"{spent:.2f} ms", "1 ms"))
    pose = robot.stance_pose(stance)
    x, y = np.meshgrid(0.50 + 0.005 * (np.arange(90) + 0.5), -0.27 + 0.005 * (np.arange(108) + 0.5))
    grid = np.stack([x, y, np.zeros_like(x)], axis=-1)
    spent = median_ms(lambda: reach_from_pose(pose, "lf", grid), repeats)
    rows.append(("reach of one leg, 108 x 90 cells", f"{spent:.2f} ms", "5 ms"))
    points = np.random.default_rng(0).uniform((0.5, -0.27, -0.40), (0.95, 0.27, -0.25), (40_000, 3))
    near = np.random.default_rng(0).uniform((-0.5, -0.4, -0.40), (0.9, 0.40, 0.10), (40_000, 3))
    camera, laser = robot.transform_camera_to_base[:3, 3], robot.transform_laser_to_base[:3, 3]
    own = SelfFilter(pose.state)
    for what, cloud in (("before the robot", points), ("all around it", near)):
        on = median_ms(partial(own.contains, cloud), repeats)
        rows.append((f"self-filter, 40,000 points {what}: on the robot", f"{on:.1f} ms", "10 ms"))
        for name, origin in (("camera", camera), ("laser", laser)):
            shadow = median_ms(partial(own.blocks, origin, cloud), repeats)
            rows.append((f"self-filter, 40,000 points {what}: hidden from {name}", f"{shadow:.1f} ms", "10 ms"))
    stances = [pause.stance for pause in walk(robot, Ground.random(0), 1, 0, has_gravity=False)]
    spent = float(np.median([ms_per_update(LegOdometry(robot), stances) for _ in range(repeats)]))
    rows.append(("odometry, one pause, feet only", f"{spent:.2f} ms", ""))
    width = max(len(what) for what, _, _ in rows)
    print(f"{'figure':<{width}}  {'measured':>22}  {'limit':>12}")
    for what, value, limit in rows:
        print(f"{what:<{width}}  {value:>22}  {limit:>12}")


def ms_per_update(odometry: LegOdometry, stances: list[Stance]) -> float:
    """Mean time [ms] of one update over a cycle."""
    start = time.perf_counter()
    for stance in stances:
        odometry.update(stance)
    return 1e3 * (time.perf_counter() - start) / len(stances)


if __name__ == "__main__":
    main()
