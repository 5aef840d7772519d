"""Usable ground: share of the truly safe ground in maps, unsafe ground among it, and bounds of unknown ground.

Walks over random worlds, scanned frame by frame, against the oracle: the same limits and sole on complete true heights.
With --rendered single scans of rendered pictures in place of walks; with --recall walks over one kind of ground each;
with --rims walks of a Go2 past trenches; with --maps clouds by other robots, which have no oracle.
"""

from __future__ import annotations

import dataclasses
import json
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

import guara_perception as gp
from benchmarks.command import options
from benchmarks.fused_walk import JudgedPause, judged_walk
from benchmarks.others_maps import judge_maps
from benchmarks.recall import DANGEROUS_RELIEF_M, count_lost, recall_of_kinds, relief_under, sole_window
from benchmarks.rims import trenches
from guara_perception.arrays import Float, Mask
from guara_perception.settings import Settings
from guara_perception.simulation import World
from guara_perception.simulation.planner import plan_foothold, plan_swing
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK, Hazard
from guara_perception.terrain.layers.layers import CEILING_SIGMA_M
from guara_perception.terrain.questions.path import PathVerdict, corridor_of, sampled
from kinematics import RobotModel, load_robot
from testbed.kinds_of_ground import KINDS, MOVING
from testbed.scanned_walk import ADAPTIVE, ScannedPause, scanned_walk
from testbed.true_ground import TrueGround
from testbed.truth import truth_calibration

CLEARANCE_M, APEX_M = 0.020, 0.060
HARMLESS_RELIEF_M = 0.001
REFUSED_BY_M = 0.001
# A bound is broken where the truth is higher by more than BROKEN_BY_M plus BROKEN_BY_SIGMAS times its sigma.
BROKEN_BY_M, BROKEN_BY_SIGMAS = 0.005, 4.0
# The only count of which walks take the largest, not the sum.
WORST = "bounds: truth higher by at most um"
# Counts that must be zero.
UNSAFE = ("free, unsafe by truth: relief", "free, unsafe by truth: dark", "unknown and free")


def main() -> None:
    """Command line."""
    asked = options(
        __doc__,
        seeds=(5, "worlds 0 ... N - 1"),
        mode=("coarse", "scan mode", {"choices": ("coarse", "standard", ADAPTIVE)}),
        cycles=(10, "cycles of each walk"),
        recall=(False, "by kinds of ground"),
        rims=(False, "what trenches bar for a Go2"),
        kinds=([*KINDS, MOVING], "kinds of --recall", {"choices": (*KINDS, MOVING)}),
        kept=(Path, "folder that keeps the scans from run to run"),
        maps=(Path, "folder of PCD files by other robots: judge these instead"),
        rendered=(Path, "data folders with scans/NAME: judge these instead", {"nargs": "+"}),
    )
    if asked.maps:
        judge_maps(asked.maps)
        return
    if asked.rims:
        trenches(asked.seeds, asked.mode, asked.cycles)
        return
    robot = load_robot("guara")
    if asked.recall:
        recall_of_kinds(robot, asked.seeds, asked.mode, asked.cycles, asked.kinds)
        return
    if asked.rendered:
        judged = rendered(robot, sorted(scan for data in asked.rendered for scan in data.glob("scans/*")))
    else:
        how = {"mode": asked.mode, "cycles": asked.cycles, "kept": asked.kept}
        judged = ((f"world {n}", walked(robot, *scanned_walk(robot, n, **how))) for n in range(asked.seeds))
    total: Counter[str] = Counter()
    for name, counts in judged:
        worst = max(total[WORST], counts[WORST])
        total.update(counts)
        total[WORST] = worst
        print(f"{name}: {ground_line(counts)}", flush=True)
    print(f"all: {ground_line(total)}")
    report(total)
    print(json.dumps(dict(sorted(total.items()))))


def walked(robot: RobotModel, world: World, pauses: list[ScannedPause]) -> Counter[str]:
    """Counts over one walk."""
    counts: Counter[str] = Counter()
    for pause in judged_walk(robot, TrueGround.of(world), pauses):
        cells(counts, robot, pause.fused, pause.oracle, pause.dark)
        swings(counts, robot, pause)
        bounds(counts, pause)
    return counts


def rendered(robot: RobotModel, scans: list[Path]) -> Iterator[tuple[str, Counter[str]]]:
    """Name and counts of each single scan of rendered pictures, with the true calibration."""
    for path in scans:
        scan = gp.process_scan(gp.open_scan(path), truth_calibration(path.parents[1]), robot, pictures=False)
        oracle, dark = TrueGround.under(path).grid(np.eye(4), scan.geometry, robot)
        counts: Counter[str] = Counter()
        cells(counts, robot, scan, oracle, dark)
        yield f"{path.parents[1].name}/{path.name}", counts


def cells(counts: Counter[str], robot: RobotModel, fused: gp.TerrainGrid, oracle: gp.TerrainGrid, dark: Mask) -> None:
    """Cells of the map against those of the oracle."""
    limits = Settings.of(robot).limits
    sole = sole_window(limits, fused.resolution)
    free, safe = fused.hazard == 0, oracle.hazard == 0
    counts["safe"] += int(safe.sum())
    counts["free"] += int(free.sum())
    counts["free and safe"] += int((free & safe).sum())
    counts["lost: other margins"] += int(count_lost(counts, safe & ~free, fused, sole).sum())
    beyond = free & ~safe
    relief = relief_under(oracle.elevation_min, oracle.elevation_max, oracle.layers["slope"], sole, limits)
    dark_sole = cv2.dilate(dark.astype(np.uint8), sole) > 0
    near = cv2.dilate(safe.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    counts["beyond oracle"] += int(beyond.sum())
    counts["beyond oracle, more than one row off"] += int((beyond & ~near).sum())
    counts["beyond oracle, relief over 1 mm"] += int((beyond & (relief > HARMLESS_RELIEF_M)).sum())
    bad = ((oracle.hazard & ~np.uint16(Hazard.EDGE)) != 0).astype(np.uint8)
    within, below = (cv2.dilate(bad, sole[cut, cut]) > 0 for cut in (slice(1, -1), slice(None)))
    counts["beyond oracle, hazard at the rim of the sole's window"] += int((beyond & below & ~within).sum())
    counts["free, unsafe by truth: relief"] += int((beyond & (relief > DANGEROUS_RELIEF_M)).sum())
    counts["free, unsafe by truth: dark"] += int((free & dark_sole).sum())
    counts["unknown and free"] += int((free & ((fused.hazard & UNKNOWN_MASK) != 0)).sum())


def bounds(counts: Counter[str], pause: JudgedPause) -> None:
    """Bounds of unknown ground by lines of sight, in a map that drifts as on a real walk, against the truth."""
    ceiling = pause.fused.ceiling
    over = np.asarray(pause.oracle.elevation_max - ceiling, np.float64)[np.isfinite(ceiling)]
    counts["bounds: unknown cells"] += int(((pause.fused.hazard & UNKNOWN_MASK) != 0).sum())
    counts["bounds"] += over.size
    counts["bounds: truth higher"] += int((over > 0).sum())
    counts["bounds: broken"] += int((over > BROKEN_BY_M + BROKEN_BY_SIGMAS * CEILING_SIGMA_M).sum())
    counts["bounds: slack um"] += round(-1e6 * float(over.sum()))
    counts[WORST] = max(counts[WORST], round(1e6 * float(over.max(initial=0.0))))


def swings(counts: Counter[str], robot: RobotModel, judged: JudgedPause) -> None:
    """Count the next swing: existing footholds, the one that the planner finds, and acceptance of the path to it."""
    pause, fused, oracle = judged.item.pause, judged.fused, judged.oracle
    leg, wish = pause.next_leg, pause.nominal
    counts["swings"] += 1
    found = plan_foothold(fused, leg, wish, robot=robot)
    bright = _bright(oracle, judged.dark)
    for name, foothold in (
        ("truth", plan_foothold(bright, None, wish)),
        ("truth with reach", plan_foothold(bright, leg, wish, robot=robot)),
        ("map", plan_foothold(fused, None, wish, robot=robot)),
        ("map with reach", found),
    ):
        counts[f"place: {name}"] += foothold is not None
    planned = plan_swing(fused, leg, wish, robot=robot)
    counts["place: map with reach and a swing"] += planned is not None
    if planned is not None:
        truly = oracle.check_path(on_true_ground(planned.swing.points, oracle), planned.clearance)
        counts["planned swings"] += 1
        counts["planned swings, truth lacks over 1 mm"] += lack(truly) > REFUSED_BY_M
    if found is None:
        return
    start = judged.from_world[:3, :3] @ pause.soles_in_world[leg] + judged.from_world[:3, 3]
    end = np.array([found.x, found.y, found.z])
    true_end = np.array([found.x, found.y, oracle.height_at(found.x, found.y)])
    by_truth = oracle.check_path(up_over_down(start, true_end), CLEARANCE_M)
    way = up_over_down(start, end)
    counts["truly good"] += by_truth.ok
    verdict = fused.check_path(way, CLEARANCE_M)
    counts["accepted"] += verdict.ok
    counts["truly good and accepted"] += verdict.ok and by_truth.ok
    counts["accepted, truth lacks over 1 mm"] += verdict.ok and lack(by_truth) > REFUSED_BY_M
    if not by_truth.ok:
        return
    if not verdict.ok:
        counts[f"refused, {_unknown_below(fused, judged.dark, way)}"] += 1
        for reason in verdict.reasons:
            why = f"{reason.test} {reason.detail if reason.test == 'unknown' else ''}".strip()
            counts[f"refused for {why}"] += 1
    found_way = fused.swing(start, end, CLEARANCE_M)
    counts["truly good, swing() finds a way"] += found_way.ok
    if found_way.ok:
        short = lack(oracle.check_path(on_true_ground(found_way.points, oracle), CLEARANCE_M))
        counts["way of swing(), truth lacks over 1 mm"] += short > REFUSED_BY_M


def on_true_ground(way: Float, oracle: gp.TerrainGrid) -> Float:
    """The same way, ending on the ground as it truly is."""
    moved = way.copy()
    moved[-1, 2] = oracle.height_at(moved[-1, 0], moved[-1, 1])
    return moved


def lack(verdict: PathVerdict) -> float:
    """Largest shortfall of the clearance of a path [m]; infinite where it leaves the grid."""
    each = [abs(r.limit - r.value) if r.test in ("depth", "clearance") else np.inf for r in verdict.reasons]
    return max(each, default=0.0)


def up_over_down(start: Float, end: Float) -> Float:
    """A swing of three straight lines."""
    top = max(start[2], end[2]) + APEX_M
    return np.array([start, [start[0], start[1], top], [end[0], end[1], top], end])


def _unknown_below(fused: gp.TerrainGrid, dark: Mask, way: Float) -> str:
    """The kind of the unknown cells below a way."""
    iy, ix = corridor_of(fused.geometry, sampled(way, fused.resolution / 2), CLEARANCE_M).unique()
    inside = fused.geometry.contains(iy, ix)
    below = iy[inside], ix[inside]
    unknown = (fused.hazard[below] & UNKNOWN_MASK) != 0
    if not unknown.any():
        return "all known"
    return "dark ground" if dark[below][unknown].any() else "bright ground alone"


def _bright(oracle: gp.TerrainGrid, dark: Mask) -> gp.TerrainGrid:
    """The oracle, in which no sole may stand on dark ground."""
    layers = {name: np.array(layer) for name, layer in oracle.layers.items()}
    sole = sole_window(oracle.record.required_limits, oracle.resolution)
    under = cv2.dilate(dark.astype(np.uint8), sole) > 0
    layers["hazard"][under] |= np.uint16(Hazard.UNCERTAIN)
    layers["traversability"][under] = 0
    return dataclasses.replace(oracle, layers=layers)


def ground_line(counts: Counter[str]) -> str:
    """The main figures of the ground in one line."""
    recall = 100 * counts["free and safe"] / max(counts["safe"], 1)
    return (
        f"recall {recall:.1f} %, free {counts['free']}, beyond oracle {counts['beyond oracle']}, unsafe by truth "
        f"{counts['free, unsafe by truth: relief']} + {counts['free, unsafe by truth: dark']}"
    )


def report(counts: Counter[str]) -> None:
    """All counts; those of lost cells also as a share of the truly safe cells."""
    for name, count in sorted(counts.items()):
        share = f"{100 * count / counts['safe']:6.2f} % of safe cells" if name.startswith("lost") else ""
        print(f"  {name:55s} {count:9d} {share}")


if __name__ == "__main__":
    main()
