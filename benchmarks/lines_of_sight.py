"""Prints whether bounds of unknown ground by lines of sight hold against the truth, and what swings gain by them.

Walks over random worlds, scanned frame by frame, in the map that drifts as a walk does.
"""

from __future__ import annotations

import argparse
import json
import time
from collections import Counter
from pathlib import Path

import numpy as np

import guara_perception as gp
from benchmarks.scanned_walk import ScannedPause, map_geometry, scanned_walk
from benchmarks.true_ground import TrueGround
from benchmarks.usable_ground import CLEARANCE_M, FIRST_STEP, REFUSED_BY_M, lack, on_true_ground, up_over_down
from guara_perception.simulation.planner import plan_foothold
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK
from kinematics import LegOdometry, RobotModel, load_robot

# A bound is broken where the truth is higher by more than this and its sigma times that.
BROKEN_BY_M, BROKEN_BY_SIGMAS = 0.005, 4.0


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=5, help="worlds 0 ... N - 1")
    parser.add_argument("--cycles", type=int, default=10)
    parser.add_argument("--kept", type=Path, help="folder that keeps the scans from run to run")
    arguments = parser.parse_args()
    robot = load_robot("guara")
    total: Counter[str] = Counter()
    worst = -np.inf
    for seed in range(arguments.seeds):
        world, pauses = scanned_walk(robot, seed, cycles=arguments.cycles, kept=arguments.kept)
        counts, highest = judge(robot, TrueGround.of(world), pauses)
        total.update(counts)
        worst = max(worst, highest)
        print(f"world {seed}: {line(counts, highest)}", flush=True)
    print(f"all worlds: {line(total, worst)}")
    print(json.dumps({**total, "worst_mm": round(1e3 * worst, 2)}))


def judge(robot: RobotModel, truth: TrueGround, pauses: list[ScannedPause]) -> tuple[Counter[str], float]:
    """Counts over one walk, and by how much the truth lies over the worst bound [m]."""
    counts: Counter[str] = Counter()
    worst = -np.inf
    terrain_map, odometry = gp.TerrainMap(robot), LegOdometry(robot)
    sight = gp.LinesOfSight(terrain_map)
    for item in pauses:
        pause, scan = item.pause, item.scan
        pose = odometry.update(pause.stance)
        fused = terrain_map.update(
            scan,
            pose.transform_footprint_to_odom,
            pose.covariance,
            known_ground=pause.known_ground,
            covariance_since_last=pose.covariance_since_last,
            own_covariance=pose.own_covariance,
        )
        begun = time.process_time()
        sight.add(scan, fused)
        ceiling = sight.ceiling(fused)
        counts["processor us"] += round(1e6 * (time.process_time() - begun))
        counts["pauses"] += 1
        if pause.step < FIRST_STEP:
            continue
        to_world = pause.transform_base_to_world @ np.linalg.inv(np.array(scan.metadata["transform_base_to_footprint"]))
        stance = {name: fused.metadata[name] for name in ("stance", "transform_base_to_footprint")}
        oracle, _ = truth.grid(to_world, map_geometry(robot), robot, **stance)
        unknown = (fused.hazard & UNKNOWN_MASK) != 0
        bounded = unknown & np.isfinite(ceiling.height)
        over = np.asarray(oracle.elevation_max - ceiling.height, np.float64)[bounded]
        counts["unknown"] += int(unknown.sum())
        counts["bounds"] += over.size
        counts["broken"] += int((over > BROKEN_BY_M + BROKEN_BY_SIGMAS * ceiling.sigma).sum())
        counts["slack um"] += round(-1e6 * float(over.sum()))
        worst = max(worst, float(over.max(initial=-np.inf)))
        _swing(counts, robot, item, fused, oracle, ceiling, np.asarray(np.linalg.inv(to_world), np.float64))
    return counts, worst


def _swing(
    counts: Counter[str],
    robot: RobotModel,
    item: ScannedPause,
    fused: gp.TerrainGrid,
    oracle: gp.TerrainGrid,
    ceiling: gp.Ceiling,
    from_world: np.ndarray,
) -> None:
    """The next swing up, over and down, without and with the bounds."""
    leg = item.pause.next_leg
    found = plan_foothold(fused, leg, item.pause.nominal, robot=robot)
    if found is None:
        return
    start = from_world[:3, :3] @ item.pause.soles_in_world[leg] + from_world[:3, 3]
    way = up_over_down(start, np.array([found.x, found.y, found.z]))
    by_truth = oracle.check_path(on_true_ground(way, oracle), CLEARANCE_M)
    counts["swings"] += 1
    counts["truly good"] += by_truth.ok
    for name, bounds in (("without", None), ("with", ceiling)):
        verdict = fused.check_path(way, CLEARANCE_M, ceiling=bounds)
        counts[f"accepted {name}"] += verdict.ok and by_truth.ok
        counts[f"accepted {name}, truth lacks"] += verdict.ok and lack(by_truth) > REFUSED_BY_M


def line(counts: Counter[str], worst: float) -> str:
    """The figures in one line."""
    bounds = max(counts["bounds"], 1)
    return (
        f"{counts['broken']} of {counts['bounds']} bounds broken (truth higher by over 5 mm and 4 sigma), the worst "
        f"{1e3 * worst:+.1f} mm, mean slack {1e-3 * counts['slack um'] / bounds:.0f} mm; "
        f"{100 * counts['bounds'] / max(counts['unknown'], 1):.0f} % of unknown cells bounded; swings accepted of "
        f"{counts['truly good']} truly good: {counts['accepted without']} without, {counts['accepted with']} with, "
        f"truth lacks over 1 mm in {counts['accepted with, truth lacks']}; "
        f"{1e-3 * counts['processor us'] / max(counts['pauses'], 1):.0f} ms of processor a pause"
    )


if __name__ == "__main__":
    main()
