"""Errors of heights beside the sigmas that grids claim, and free cells that are too steep, over many short walks.

Each walk has a calibration, biases of the joints and an error of the IMU of its own, and is processed with and without
the IMU. Scans and maps are rendered and processed as they are on a robot.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator

import cv2
import numpy as np

import guara_perception as gp
from benchmarks.command import Table, options
from benchmarks.fused_walk import bootstrap
from guara_perception.arrays import Float, Index
from guara_perception.settings import Settings
from guara_perception.simulation.gait import OutOfReach
from guara_perception.simulation.walk import WalkPause
from kinematics import RobotModel, load_robot
from kinematics.transforms import inverse, transform_points
from testbed.erring_walk import fused, leaning_world, scans, sloping_world, true_heights, walked
from testbed.true_ground import CELL_M, TrueGround

# Cells of a grid that are judged.
JUDGED = 400
# Margin of the truth about a grid whose frame leans [cells].
BESIDE_CELLS = 10
MODE = "coarse"
# Robust scale of a normal distribution over its median absolute value.
MEDIAN = 1.4826


def sigmas() -> None:
    """Errors of heights and height differences by sigmas, scans and maps [--walks, --first, --grounds]."""
    asked = options(
        __doc__,
        walks=(100, "over each ground"),
        grounds=(["smooth", "rough"], "grounds"),
        first=(0, "first seed"),
        cycles=(1.0, "cycles of each walk"),
    )
    robot = load_robot("guara")
    apart = round(Settings.of(robot).limits.disc_radius / Settings.of(robot).resolution)
    print(
        f"error / sigma; differences of cells {apart} apart by variance_local; 95 % intervals by bootstrap over walks"
    )
    table = Table("ground:<7 | attitude:<13 | grid:<5 | what:<10 | scale:5.2f | from:5.2f | to:5.2f | within 2:8.3f")
    for ground in asked.grounds:
        found: dict[tuple[str, str, str], list[Float]] = defaultdict(list)
        for seed in range(asked.first, asked.first + asked.walks):
            world = leaning_world(robot, seed, rough=ground == "rough")
            side, rng = round(Settings.of(robot).resolution / CELL_M), np.random.default_rng(seed)
            means = np.asarray(cv2.blur(TrueGround.of(world).heights, (side, side)), np.float32)
            of_walk: dict[tuple[str, str, str], list[Float]] = defaultdict(list)
            walk = walked(robot, world, seed, MODE, asked.cycles)
            for has_imu in (True, False):
                for pause, *both in fused(robot, scans(robot, walk, MODE, has_imu=has_imu)):
                    for name, grid in zip(("scan", "map"), both, strict=True):
                        source = str(grid.record.attitude_source)
                        for what, ratios in judged(grid, true_heights(robot, world, means, pause, grid), apart, rng):
                            of_walk[source, name, what].append(ratios)
            for key, parts in of_walk.items():
                found[key].append(np.concatenate(parts))
        for key, walks in sorted(found.items()):
            table.row(ground, *key, *scale_and_share(walks))


def judged(grid: gp.TerrainGrid, heights: Float, apart: int, rng: np.random.Generator) -> Iterator[tuple[str, Float]]:
    """Some errors of a grid by their sigmas: of heights, and of differences along x and y."""
    error = np.where(grid.looks > 0, grid.elevation.astype(np.float64) - heights, np.nan)
    # A frame that leans adds its slope, which the attitude's own sigma covers.
    leans = 0.0
    if grid.record.attitude_source != "support_plane":
        leans = (apart * grid.resolution * (grid.record.attitude_sigma or 0.0)) ** 2
    local = grid.variance_local.astype(np.float64)
    along_x = (error[:, apart:] - error[:, :-apart]) / np.sqrt(local[:, apart:] + local[:, :-apart] + leans)
    along_y = (error[apart:] - error[:-apart]) / np.sqrt(local[apart:] + local[:-apart] + leans)
    kinds = {
        "height": [error / np.sqrt(grid.variance.astype(np.float64))],
        "difference": [along_x, along_y],
    }
    for what, ratios in kinds.items():
        values = np.concatenate([each[np.isfinite(each)] for each in ratios])
        yield what, rng.choice(values, JUDGED)


def scale_and_share(walks: list[Float]) -> tuple[float, float, float, float]:
    """Robust scale of errors by sigma, its interval of 95 % by bootstrap over walks, and the share within 2 sigma."""
    rng = np.random.default_rng(0)
    values = np.abs(np.array([rng.choice(each, JUDGED) for each in walks]))
    low, high = bootstrap(values, lambda some: MEDIAN * np.median(some))
    return MEDIAN * float(np.median(values)), float(low), float(high), float((values < 2).mean())


def truly(
    robot: RobotModel,
    truth: TrueGround,
    pause: WalkPause,
    grid: gp.TerrainGrid,
    cells: tuple[Index, ...],
    limit: float,
) -> tuple[int, int]:
    """Numbers of cells whose ground is truly free, and steeper against gravity than the limit.

    The same ground has other x and y in a frame that leans.
    """
    frame = pause.transform_footprint_to_world
    placed = pause.transform_base_to_world @ inverse(np.array(grid.metadata["transform_base_to_footprint"]))
    to_true = inverse(frame) @ placed
    x, y = grid.geometry.centres()
    points = transform_points(to_true, np.stack((x[cells[1]], y[cells[0]], grid.elevation[cells]), axis=1))
    oracle, _ = truth.grid(frame, grid.geometry.widened(BESIDE_CELLS), robot)
    rows, columns = oracle.geometry.indices(points[:, 0], points[:, 1])
    return int((oracle.hazard[rows, columns] == 0).sum()), int((oracle.slope[rows, columns] > limit).sum())


def slopes() -> None:
    """Free cells steeper than the limit, with an IMU and without: slopes, boxes under fore feet [--walks, --first]."""
    asked = options(
        __doc__,
        walks=(20, "walks"),
        first=(0, "first seed"),
        cycles=(3.0, "of each walk"),
    )
    robot = load_robot("guara")
    limit = Settings.of(robot).limits.slope
    table = Table(
        "ground:<6 | grid:<5 | attitude:<8 | grids:5d | free:8d | of those that are free:7.3f | too steep:9d | "
        "of the IMU's:.0%"
    )
    counts: dict[tuple[str, str, str], list[int]] = defaultdict(lambda: [0, 0, 0, 0])
    for seed in range(asked.first, asked.first + asked.walks):
        world = sloping_world(seed)
        try:
            walk = walked(robot, world, seed, MODE, asked.cycles)
        except OutOfReach as error:
            print(f"walk {seed} ends: {error}")
            continue
        truth, ground = TrueGround.of(world), "slope" if seed % 2 else "boxes"
        for attitude in ("IMU", "no IMU"):
            for pause, *both in fused(robot, scans(robot, walk, MODE, has_imu=attitude == "IMU")):
                for name, grid in zip(("scan", "map"), both, strict=True):
                    free = np.nonzero(grid.hazard == 0)
                    safe, steep = truly(robot, truth, pause, grid, free, limit)
                    for i, number in enumerate((1, len(free[0]), safe, steep)):
                        counts[ground, name, attitude][i] += number
    for key, (number, free_cells, right, steep) in sorted(counts.items()):
        kept = free_cells / max(counts[*key[:2], "IMU"][1], 1)
        table.row(*key, number, free_cells, right / max(free_cells, 1), steep, kept)
