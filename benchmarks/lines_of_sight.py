"""Prints whether bounds of unknown ground by lines of sight hold against the truth.

Walks over random worlds, scanned frame by frame, in a map that drifts as it does on a real walk. `usable_ground` shows
what swings gain by the bounds.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from pathlib import Path

import numpy as np

from benchmarks.scanned_walk import ScannedPause, judged_walk, scanned_walk
from benchmarks.true_ground import TrueGround
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK
from kinematics import RobotModel, load_robot

# A bound is broken where the truth is higher by more than BROKEN_BY_M plus BROKEN_BY_SIGMAS times its sigma.
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
    for pause in judged_walk(robot, truth, pauses):
        ceiling = pause.ceiling
        unknown = (pause.fused.hazard & UNKNOWN_MASK) != 0
        bounded = unknown & np.isfinite(ceiling.height)
        over = np.asarray(pause.oracle.elevation_max - ceiling.height, np.float64)[bounded]
        counts["pauses"] += 1
        counts["processor us"] += round(1e6 * pause.sight_seconds)
        counts["unknown"] += int(unknown.sum())
        counts["bounds"] += over.size
        counts["over the bound"] += int((over > 0).sum())
        counts["broken"] += int((over > BROKEN_BY_M + BROKEN_BY_SIGMAS * ceiling.sigma).sum())
        counts["slack um"] += round(-1e6 * float(over.sum()))
        worst = max(worst, float(over.max(initial=-np.inf)))
    return counts, worst


def line(counts: Counter[str], worst: float) -> str:
    """The figures in one line."""
    bounds = max(counts["bounds"], 1)
    return (
        f"{counts['broken']} of {counts['bounds']} bounds broken (truth higher by over 5 mm and 4 sigma), the truth "
        f"higher at all at {counts['over the bound']}, the worst {1e3 * worst:+.1f} mm, mean slack "
        f"{1e-3 * counts['slack um'] / bounds:.0f} mm; "
        f"{100 * counts['bounds'] / max(counts['unknown'], 1):.0f} % of unknown cells bounded; "
        f"{1e-3 * counts['processor us'] / max(counts['pauses'], 1):.0f} ms of processor time a pause"
    )


if __name__ == "__main__":
    main()
