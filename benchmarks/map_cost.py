"""Processor time of scans as wide as the map at the end of a pause, of maps, layers, footholds and steppable regions.

`python -m benchmarks walks cost DATA`: beside the reference extraction in the same process, so that the speed of the
machine drops out; R1 is the time of one of its stripes.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import partial
from pathlib import Path

import cv2
import numpy as np

import guara_perception as gp
from benchmarks.command import Table, options
from benchmarks.contenders import over, reference
from benchmarks.rounds import timed
from benchmarks.usable_ground import CLEARANCE_M, up_over_down
from guara_perception.ground_picture import GroundPicture
from guara_perception.scanning.pictures import with_pictures
from guara_perception.settings import Settings
from guara_perception.terrain.map.seen_texture import GroundView, seen_after, view_of, visual_motion
from kinematics import LegOdometry, PoseInOdom, RobotModel, load_robot
from testbed.analytic_walk import Ground, scan, walk
from testbed.scenes import recorded
from testbed.truth import truth_calibration

# Time of the reference for a stripe on the machine on which the limits were set. The product took 1.75 times as long.
REFERENCE_STRIPE_S = 0.34e-3
REGION_RADIUS_M = 0.15
REGIONS_ASKED = 40
# Ends of a swing of the left fore foot.
SWING_X_M, SWING_Y_M = (0.29, 0.43), 0.18


def main() -> None:
    """Processor time of wide scans, maps, layers and questions [DATA, --rounds N]."""
    asked = options(__doc__, DATA=(Path, "data folder with scans/paper"), rounds=(5, "rounds"))
    cv2.setNumThreads(1)
    robot = load_robot("guara")
    bands = recorded(asked.data / "scans" / "paper").bands()
    taken: dict[str, list[float]] = {}
    terrain = walked_map(robot)
    for _ in range(asked.rounds):
        # Speed of the machine on which the limits were set, over the present speed of this one.
        scale = REFERENCE_STRIPE_S * len(bands) / timed(over(reference, bands))[1]
        for name, seconds in (ends_of_scans(asked.data, robot) | questions(terrain, robot)).items():
            taken.setdefault(name, []).append(scale * seconds)
    print(f"processor time at the speed at which the reference takes {1e3 * REFERENCE_STRIPE_S:.2f} ms a stripe")
    table = Table("work:<46 | ms:7.2f | least:7.2f | most:7.2f | R1:7.1f")
    for name, each in taken.items():
        table.row(name, 1e3 * np.median(each), 1e3 * min(each), 1e3 * max(each), np.median(each) / REFERENCE_STRIPE_S)


def ends_of_scans(data: Path, robot: RobotModel) -> dict[str, float]:
    """Times of the work after the last frame [s]: footprint grid, wide grid, and update of a map by each."""
    paper, calibration = gp.open_scan(data / "scans" / "paper"), truth_calibration(data)
    processor = gp.ScanProcessor(calibration, robot, paper.stance, paper.mode)
    for stripe, on, off in paper.frames():
        processor.add(stripe.index, on, off)
    result = {}
    terrain, result["grid of the footprint"] = timed(processor.finish)
    wide, result["wide grid beside it"] = timed(lambda: processor.finish("wide", record=terrain.scan_record))
    result["range images, 512 x 640, both"] = timed(lambda: with_pictures(terrain, processor))[1]
    for name, grid in (("footprint", terrain), ("wide grid", wide)):
        result[f"map from a {name}, registered"] = update_again(robot, grid)
    return result | texture_again(view_of(processor.ground_picture, wide), wide, processor.ground_picture)


def texture_again(first: GroundView | str, wide: gp.TerrainGrid, picture: GroundPicture | str) -> dict[str, float]:
    """Time to find the texture of a scan again if odometry is off by a few millimetres [s]."""
    (seen, _), off = seen_after(first, None, np.eye(4), held=False), np.eye(4)
    off[:2, 3] = 0.003, -0.002

    def again() -> int:
        view = view_of(picture, wide)
        found = visual_motion(view, seen, off, 1e-5 * np.eye(6), 1e-5 * np.eye(3), np.zeros((3, 3)))
        seen_after(view, seen, off, held=found.refused is None)
        return found.corners

    corners, seconds = timed(again)
    return {f"motion by {corners} corners of the texture": seconds}


def update_again(robot: RobotModel, grid: gp.TerrainGrid) -> float:
    """Time to register a scan with the map that it made, to fuse it, and to compute the layers [s]."""
    terrain_map, still = gp.TerrainMap(robot), 1e-8 * np.eye(6)
    again = dataclasses.replace(grid, stamp=grid.stamp + 1, step=grid.step + 1)

    def update(new: gp.TerrainGrid) -> gp.TerrainGrid:
        return terrain_map.update(new, PoseInOdom(np.eye(4), still, still, still))

    update(grid)
    return timed(lambda: update(again))[1]


def walked_map(robot: RobotModel) -> gp.TerrainGrid:
    """The map after six cycles over analytic ground."""
    ground = Ground.random(0)
    terrain_map, odometry = gp.TerrainMap(robot), LegOdometry(robot)
    for pause in walk(robot, ground, 6, 0):
        fused = terrain_map.update(scan(robot, ground, pause, 0), odometry.update(pause.stance))
    return fused


def questions(terrain: gp.TerrainGrid, robot: RobotModel) -> dict[str, float]:
    """Layers of two grids, footholds, one region about a desired position (the median of many), and all of a map."""
    free = np.argwhere(np.asarray(terrain.traversability) > 0)
    x, y = terrain.geometry.centres()
    each = [
        timed(partial(terrain.steppable_region, x[at[1]], y[at[0]], REGION_RADIUS_M))[1]
        for at in free[:: max(len(free) // REGIONS_ASKED, 1)]
    ]
    found, whole = timed(terrain.steppable_regions)
    rng = np.random.default_rng(0)
    result = {"steppable_region, median": float(np.median(each)), f"steppable_regions, {len(found)} of a map": whole}
    for shape in ((108, 90), (1000, 1000)):
        heights = rng.normal(0, 0.0003, shape)
        heights[rng.random(shape) < 0.001] = np.nan
        layers = partial(gp.assess_terrain, heights, terrain.resolution, limits=Settings.of(robot).limits)
        result[f"all layers, {shape[0]} x {shape[1]} cells"] = timed(layers)[1]
    at = rng.uniform(0.45, 1.0, 1000), rng.uniform(-0.3, 0.3, 1000)
    result["check_foothold, 1000 positions"] = timed(lambda: terrain.check_foothold(*at))[1]
    result["the same with reach of a leg"] = timed(lambda: terrain.check_foothold(*at, leg="lf", robot=robot))[1]
    start, end = (np.array([x, SWING_Y_M, float(terrain.height_at(x, SWING_Y_M))]) for x in SWING_X_M)
    way = up_over_down(start, end)
    scanned = np.stack(np.meshgrid(np.linspace(-0.4, 0.8, 17), np.linspace(-0.3, 0.3, 11)), axis=-1).reshape(-1, 2)
    asked: dict[str, Callable[[], object]] = {
        "best_foothold, radius 0.08 m": lambda: terrain.best_foothold(0.7, 0.1, 0.08),
        "best_foothold of a leg": lambda: terrain.best_foothold(end[0], end[1], 0.08, leg="lf", robot=robot),
        "leg_clearance": lambda: terrain.leg_clearance(end[0], end[1], "lf", robot),
        "check_path, up, over and down": lambda: terrain.check_path(way, CLEARANCE_M),
        "swing": lambda: terrain.swing(start, end, CLEARANCE_M),
        "swing of a leg": lambda: terrain.swing(start, end, CLEARANCE_M, leg="lf", robot=robot),
        "stairs": terrain.stairs,
        f"height_scan, {len(scanned)} points": lambda: terrain.height_scan(scanned),
        "obstacles": terrain.obstacles,
    }
    return result | {name: timed(question)[1] for name, question in asked.items()}
