"""Prints the figures of the package `kinematics` as a table: legs, poses, odometry, and what each call costs.

Run it from the root of the checkout: `.venv/bin/python -m benchmarks.kinematics [--quick]`. Everything is computed here
from the robot's model; no recorded scan is needed. Times are medians on the machine at hand.
"""

import argparse
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from kinematics import LegOdometry, RobotModel, SelfFilter, Stance, load_robot, reach_from_pose
from kinematics.footprint import fit_support_plane, transform_base_to_footprint
from kinematics.leg import find_leg_geometry
from kinematics.stance_pose import sole_covariances

CYCLE = 0.140  # one cycle, four swings [m]
HEIGHT = 0.360  # of the hips in the scan posture [m]


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


def leg_agreement(robot: RobotModel, count: int) -> tuple[float, float]:
    """Largest differences [m]: closed form against Pinocchio, and the sole after inverse and forward kinematics."""
    rng, forward, back = np.random.default_rng(0), 0.0, 0.0
    for leg in robot.legs:
        geometry = find_leg_geometry(robot.tree, leg)
        if geometry is None:
            raise SystemExit(f"the closed form does not fit leg {leg}")
        positions = rng.uniform(geometry.lower, geometry.upper, (count, 4))
        soles = geometry.soles_in_base(positions)
        # Below the hip: for a sole above it another roll of the hip is the answer.
        positions, soles = positions[soles[:, 2] < -0.02], soles[soles[:, 2] < -0.02]
        for row in range(len(soles)):
            joints = robot.posture("scan") | dict(zip(robot.tree.leg(leg).joints, positions[row].tolist(), strict=True))
            forward = max(forward, float(np.abs(robot.state(joints).soles_in_base([leg])[0] - soles[row]).max()))
        found = geometry.solve(soles, positions[:, 1:].sum(axis=1))
        back = float(np.maximum(back, np.abs(geometry.soles_in_base(found) - soles).max()))  # NaN stays NaN
    return forward, back


def covariance_ratio(robot: RobotModel, with_gravity: bool, count: int) -> tuple[float, float]:
    """Smallest and largest ratio of predicted to sampled sigma of the camera's pose, body tilted by 3 and 2 degrees."""
    gravity = (0.052335956, -0.034851668, -0.998021197)
    level = robot.stance_pose(Stance(robot.posture("scan"), robot.legs, gravity), find_unloaded=False)
    floor = robot.state(robot.posture("scan")).soles_in_base()
    joints = joints_for(robot, floor @ level.transform_base_to_footprint[:3, :3])
    stance = Stance(joints, robot.legs, gravity if with_gravity else None)
    pose = robot.stance_pose(stance, find_unloaded=False)
    rng, noise, state = np.random.default_rng(1), robot.noise, robot.state(stance.joint_positions)
    soles = state.soles_in_base()
    roots = np.linalg.cholesky(sole_covariances(state, robot.legs, noise))
    samples = np.zeros((count, 6))
    nominal = pose.transform_camera_to_footprint
    for row in range(count):
        noisy = soles + np.einsum("nij,nj->ni", roots, rng.normal(size=(4, 3)))
        up = fit_support_plane(noisy).normal
        if with_gravity:
            up = -np.array(gravity) + rng.normal(0.0, noise.imu_sigma, 3)
            up /= np.linalg.norm(up)
        sample = transform_base_to_footprint(noisy, up) @ robot.transform_camera_to_base
        turned = sample[:3, :3] @ nominal[:3, :3].T
        samples[row] = [*(sample - nominal)[:3, 3], *((turned - turned.T)[[2, 0, 1], [1, 2, 0]] / 2.0)]
    ratios = np.sqrt(np.diag(pose.camera_covariance)) / samples.std(axis=0)
    return float(ratios.min()), float(ratios.max())


def crawl(robot: RobotModel, cycles: int, sway: float) -> Iterator[tuple[np.ndarray, np.ndarray, int]]:
    """A crawl on a flat floor: body position in `odom`, soles (4, 3) in `base_link`, row of the leg just set down."""
    nominal = robot.state(robot.posture("scan")).soles_in_base() * (1.0, 1.0, 0.0)
    order = [robot.legs.index(leg) for leg in ("rh", "rf", "lh", "lf")]
    soles, body = nominal.copy(), np.array([0.0, 0.0, HEIGHT])
    for number, row in enumerate(order):
        soles[row, 0] += (number - 1.5) * CYCLE / 4.0
    for _ in range(cycles):
        for row in order:
            body = body + (CYCLE / 4.0, 0.0, 0.0)
            soles[row] = nominal[row] + (body[0] + 3.0 * CYCLE / 8.0, 0.0, 0.0)
            here = body + (0.0, -sway if robot.legs[row].startswith("l") else sway, 0.0)
            yield here, soles - here, row


def joints_for(robot: RobotModel, soles: np.ndarray) -> dict[str, float]:
    """Joint positions that bring level soles to these positions (4, 3) in `base_link`, legs in the robot's order."""
    joints: dict[str, float] = {}
    for leg, sole in zip(robot.legs, soles, strict=True):
        joints.update(zip(robot.tree.leg(leg).joints, robot.reach(leg, sole).joint_positions.tolist(), strict=True))
    return joints


def odometry_errors(robot: RobotModel, *, gravity: bool, each_pause: bool, seeds: int) -> list[float]:
    """Error of the last position [m] of noisy crawls: 12 cycles, 0.2 degrees per joint, 1 mm of contact per axis.

    Contact noise is drawn again at each pause, or when a foot is set down (where it then stays).
    """
    walk, errors = list(crawl(robot, 12, 0.030)), []
    for seed in range(seeds):
        rng, odometry = np.random.default_rng(seed), LegOdometry(robot)
        contact = rng.normal(0.0, 0.001, (4, 3))
        for _, soles, row in walk:
            contact[row] = rng.normal(0.0, 0.001, 3)
            if each_pause:
                contact = rng.normal(0.0, 0.001, (4, 3))
            joints = joints_for(robot, soles + contact)
            joints = {name: angle + rng.normal(0.0, np.radians(0.2)) for name, angle in joints.items()}
            result = odometry.update(Stance(joints, robot.legs, (0.0, 0.0, -1.0) if gravity else None))
        travelled = walk[-1][0] - walk[0][0]
        errors.append(float(np.linalg.norm(result.transform_footprint_to_odom[:3, 3] - travelled)))
    return errors


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="fewer repeats: for a first impression, not for figures")
    quick = parser.parse_args().quick
    repeats, seeds = (5, 5) if quick else (50, 20)
    rows: list[tuple[str, str, str]] = []
    rows.append(("loading the robot, cold, fresh process", f"{cold_load_seconds(2 if quick else 5):.2f} s", "1.2 s"))
    robot = load_robot("guara")
    forward, back = leg_agreement(robot, 20 if quick else 250)
    rows.append(("leg: closed form against Pinocchio", f"{forward:.1e} m", "1e-12 m"))
    rows.append(("leg: sole after inverse and forward", f"{back:.1e} m", "1e-12 m"))
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
    for gravity in (True, False):
        low, high = covariance_ratio(robot, gravity, 500 if quick else 20_000)
        source = "imu" if gravity else "support plane"
        rows.append((f"camera sigmas, predicted / sampled, {source}", f"{low:.3f} ... {high:.3f}", "0.9 ... 1.1"))
    for gravity in (True, False):
        for each_pause in (False, True):
            errors = odometry_errors(robot, gravity=gravity, each_pause=each_pause, seeds=seeds)
            what = f"odometry, 1.68 m, {seeds} walks, {'imu' if gravity else 'feet only'}, contact noise "
            what += "at each pause" if each_pause else "at each set-down"
            share = 100.0 * float(np.median(errors)) / 1.68
            rows.append((what, f"{1e3 * float(np.median(errors)):.1f} mm = {share:.2f} %", "1 %"))
    stances = [Stance(joints_for(robot, soles), robot.legs) for _, soles, _ in crawl(robot, 1, 0.030)]
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
