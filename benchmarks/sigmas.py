"""Errors of heights beside the sigmas that grids claim, and free cells that are too steep, over many short walks.

Each walk has a calibration, biases of the joints and an error of the IMU of its own, and is processed with and without
the IMU. Scans and maps are rendered and processed as they are on a robot.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np

import guara_perception as gp
from benchmarks.command import Table, options
from benchmarks.true_ground import CELL_M, TrueGround
from guara_perception.arrays import Float, Float32, Index
from guara_perception.calibration.height_sigma import HeightUncertainty
from guara_perception.settings import Settings
from guara_perception.simulation import SimulatedRangefinder, World, specimen
from guara_perception.simulation.features import Box, Ramp
from guara_perception.simulation.gait import OutOfReach, WaveGait
from guara_perception.simulation.light import Light
from guara_perception.simulation.specimen import rotation
from guara_perception.simulation.walk import WalkNoise, WalkPause, fresh_reading, simulate_walk
from kinematics import LegOdometry, RobotModel, Stance, load_robot
from kinematics.footprint import fit_support_plane, transform_base_to_footprint
from kinematics.transforms import inverse, transform_points

SIZE = (640, 512)
# Cells of a grid that are judged, and samples of the bootstrap over walks.
JUDGED, SAMPLES = 400, 300
# Standard deviation of smooth and of rough ground, and wave lengths of the rough [m].
SMOOTH_M, ROUGH_M, WAVES_M = 0.005, 0.0015, (0.04, 0.2)
# Blocks under the feet of the first stance [m].
BLOCK_M, LEAST_BLOCK_M = 0.12, 0.002
# Speckle as strong as the sigmas of stripes assume.
LIGHT = Light(speckle=0.3)
# Margin of the truth about a grid whose frame leans [cells].
BESIDE_CELLS = 10
# Robust scale of a normal distribution over its median absolute value.
MEDIAN = 1.4826


@dataclass(frozen=True)
class Walk:
    """A walk as the robot reports it.

    Attributes:
        world: the ground.
        calibration: the calibration that the robot has, which is not quite that of its rangefinder.
        pauses: the pauses and the frames of their scans.
    """

    world: World
    calibration: gp.Calibration
    pauses: list[tuple[WalkPause, list[gp.FramePair]]]


@cache
def calibrated() -> gp.Calibration:
    """A calibration from pictures, whose covariance is that of all walks."""
    return gp.calibrate(Path(__file__).parent.parent / "tests" / "data" / "calibration")


def drawn(true: gp.Calibration, rng: np.random.Generator) -> gp.Calibration:
    """A calibration of a rangefinder, with errors of planes and mount from the covariance of `calibrated`."""
    uncertainty = HeightUncertainty.of(calibrated())
    assert uncertainty is not None
    stripes = []
    for stripe in true.stripes:
        plane = rng.multivariate_normal(stripe.plane, uncertainty.plane_covariance(stripe.index), method="svd")
        stripes.append(replace(stripe, plane=plane / np.linalg.norm(plane[:3])))
    # Constant and linear terms of the field of height errors: the camera higher, or turned about the field's origin.
    lift, by_x, by_y = rng.multivariate_normal(np.zeros(3), uncertainty.field[:3, :3], method="svd")
    turn = np.eye(4)
    turn[:3, :3] = rotation(np.array([by_y, -by_x, 0.0]))
    turn[:3, 3] = uncertainty.field_origin - turn[:3, :3] @ uncertainty.field_origin + (0.0, 0.0, lift)
    mount = turn @ true.transform_camera_to_base
    return replace(true, stripes=tuple(stripes), transform_camera_to_base=mount, covariance=calibrated().covariance)


def leaning_world(robot: RobotModel, seed: int, *, rough: bool) -> World:
    """Smooth or rough ground, and blocks under the first stance that lean as robot.toml says that ground does."""
    rng = np.random.default_rng(seed)
    feet = WaveGait.of(robot).first_stance().values()
    heights = np.array(list(feet)) @ (robot.noise.terrain_slope_sigma * rng.standard_normal(2))
    blocks = [
        Box(x=x, y=y, size=(BLOCK_M, BLOCK_M), height=float(height))
        for (x, y), height in zip(feet, heights - heights.min() + LEAST_BLOCK_M, strict=True)
    ]
    world = World(
        features=tuple(blocks), undulation=ROUGH_M if rough else SMOOTH_M, seed=seed, light=LIGHT, flat_until=0.3
    )
    if rough:
        lengths, angles, phases = rng.uniform(*WAVES_M, 12), *rng.uniform(0, 2 * np.pi, (2, 12))
        numbers = 2 * np.pi / lengths
        waves = np.column_stack((numbers * np.cos(angles), numbers * np.sin(angles), phases))
        object.__setattr__(world, "_waves", waves)
    return world


def sloping_world(seed: int) -> World:
    """Level ground, then a slope of up to 15 degrees, with boxes for the fore feet and ramps that are too steep."""
    rng = np.random.default_rng(seed)
    slope = np.tan(np.radians(rng.uniform(3.0, 15.0)))
    features: list[Box | Ramp] = []
    if seed % 2:
        features.append(Ramp(x=1.3, y=0.0, size=(2.0, 1.8), height=2.0 * slope))
    else:
        features.append(Box(x=0.21, y=0.0, size=(0.12, 0.8), height=float(rng.uniform(0.01, 0.03))))
    for _ in range(4):
        x, y, yaw = rng.uniform(0.5, 1.2), rng.uniform(-0.25, 0.25), rng.uniform(0, 2 * np.pi)
        steep = np.tan(np.radians(rng.uniform(21.0, 27.0)))
        size = float(rng.uniform(0.12, 0.2))
        features.append(Ramp(x=x, y=y, yaw=yaw, size=(size, 0.2), height=size * steep))
    return World(features=tuple(features), seed=seed, light=LIGHT)


def walked(robot: RobotModel, world: World, seed: int, mode: str, cycles: float) -> Walk:
    """A walk of a robot with biases of its own over a world."""
    cv2.setNumThreads(1)
    rng = np.random.default_rng(seed)
    true = specimen(robot, SIZE, seed)
    rangefinder = SimulatedRangefinder(world, true, robot, seed)
    bias = dict(zip(robot.tree.joint_names, robot.noise.encoder_sigma * rng.standard_normal(99), strict=False))
    tilt = rotation(robot.noise.imu_sigma * rng.standard_normal(3))
    pauses, noise = [], WalkNoise(joint=0.0, imu=0.0, contact=robot.noise.contact_sigma)
    for pause in simulate_walk(world, robot, cycles=cycles, seed=seed, noise=noise):
        rangefinder.set_pose(pause.transform_base_to_world, pause.joint_positions)
        frames = [gp.FramePair(*each) for each in rangefinder.frames(Settings.of(robot).pattern(mode))]
        joints = {name: angle + bias[name] for name, angle in pause.joint_positions.items()}
        down = -tilt @ pause.transform_base_to_world[2, :3]
        stance = fresh_reading(Stance(joints, robot.legs, tuple(down.tolist())), rng, robot.noise.encoder_noise)
        pauses.append((replace(pause, stance=stance), frames))
    return Walk(world, drawn(true, rng), pauses)


def grids(
    robot: RobotModel, walk: Walk, mode: str, *, has_imu: bool
) -> Iterator[tuple[WalkPause, gp.TerrainGrid, gp.TerrainGrid]]:
    """Each pause of a walk with its scan and its map."""
    odometry, rolling = LegOdometry(robot), gp.TerrainMap(robot)
    for pause, frames in walk.pauses:
        stance = pause.stance if has_imu else replace(pause.stance, gravity_in_base=None)
        gravity = odometry.carried_gravity(stance)
        processor = gp.ScanProcessor(walk.calibration, robot, stance, mode, step=pause.step, gravity=gravity)
        processor.add_all(frames)
        scan = processor.finish("wide")
        yield pause, scan, rolling.update(scan, odometry.update(stance))


def true_frame(robot: RobotModel, world: World, pause: WalkPause, grid: gp.TerrainGrid) -> Float:
    """Where the frame of a grid truly is in the world (4, 4): on the ground under the feet that it used."""
    length, width = robot.sole
    standing = [pause.soles_in_world[leg] for leg in grid.record.support_feet_used or ()]
    ground = [(x, y, world.sole_height(x, y, length, width)) for x, y, _ in standing]
    soles = transform_points(inverse(pause.transform_base_to_world), np.array(ground))
    is_plane = grid.record.attitude_source == "support_plane"
    up = fit_support_plane(soles).normal if is_plane else pause.transform_base_to_world[2, :3]
    return pause.transform_base_to_world @ inverse(transform_base_to_footprint(soles, up))


def true_heights(robot: RobotModel, world: World, means: Float32, pause: WalkPause, grid: gp.TerrainGrid) -> Float:
    """True heights (ny, nx) of the ground that a grid shows, in its true frame [m].

    The same ground has other x and y in a frame that leans: it is looked up where the grid's own frame was.

    Args:
        robot: the robot.
        world: the ground.
        means: its mean heights over a cell, in millimetre cells of the whole world.
        pause: the pause of the grid.
        grid: the grid.
    """
    placed = pause.transform_base_to_world @ inverse(np.array(grid.metadata["transform_base_to_footprint"]))
    x, y = np.meshgrid(*grid.geometry.centres())
    points = (
        np.stack((x, y, np.nan_to_num(grid.elevation.astype(np.float64))), axis=-1) @ placed[:3, :3].T + placed[:3, 3]
    )
    columns, rows = (
        ((points[..., i] - low) / CELL_M - 0.5).astype(np.float32) for i, low in enumerate((world.x[0], world.y[0]))
    )
    points[..., 2] = cv2.remap(means, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    to_true = inverse(true_frame(robot, world, pause, grid))
    return np.asarray(points @ to_true[2, :3] + to_true[2, 3])


def sigmas() -> None:
    """Errors of heights and of height differences by their sigmas, scans and maps [--walks, --first, --mode]."""
    asked = options(
        __doc__,
        walks=(100, "over smooth ground, and as many over rough"),
        first=(0, "first seed"),
        mode=("coarse", "scan mode"),
        cycles=(1.0, "cycles of each walk"),
    )
    robot = load_robot("guara")
    apart = round(Settings.of(robot).limits.disc_radius / Settings.of(robot).resolution)
    print(
        f"error / sigma; differences of cells {apart} apart by variance_local; 95 % intervals by bootstrap over walks"
    )
    table = Table("ground:<7 | attitude:<13 | grid:<5 | what:<10 | scale:5.2f | from:5.2f | to:5.2f | within 2:8.3f")
    for ground in ("smooth", "rough"):
        found: dict[tuple[str, str, str], list[Float]] = defaultdict(list)
        for seed in range(asked.first, asked.first + asked.walks):
            world = leaning_world(robot, seed, rough=ground == "rough")
            walk = walked(robot, world, seed, asked.mode, asked.cycles)
            side, rng = round(Settings.of(robot).resolution / CELL_M), np.random.default_rng(seed)
            means = np.asarray(cv2.blur(TrueGround.of(world).heights, (side, side)), np.float32)
            of_walk: dict[tuple[str, str, str], list[Float]] = defaultdict(list)
            for has_imu in (True, False):
                for pause, *both in grids(robot, walk, asked.mode, has_imu=has_imu):
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
    drawn_walks = rng.integers(len(values), size=(SAMPLES, len(values)))
    scales = [MEDIAN * float(np.median(values[rows])) for rows in drawn_walks]
    low, high = np.quantile(scales, [0.025, 0.975]).tolist()
    return MEDIAN * float(np.median(values)), low, high, float((values < 2).mean())


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
    """Free cells steeper than the limit, on slopes and with the fore feet on boxes [--walks, --first, --mode]."""
    asked = options(
        __doc__,
        walks=(20, "walks"),
        first=(0, "first seed"),
        mode=("coarse", "scan mode"),
        cycles=(3.0, "of each walk"),
    )
    robot = load_robot("guara")
    limit = Settings.of(robot).limits.slope
    table = Table("attitude:<8 | grid:<5 | grids:5d | free:8d | of those that are free:7.3f | too steep:9d")
    counts: dict[tuple[str, str], list[int]] = defaultdict(lambda: [0, 0, 0, 0])
    for seed in range(asked.first, asked.first + asked.walks):
        world = sloping_world(seed)
        try:
            walk = walked(robot, world, seed, asked.mode, asked.cycles)
        except OutOfReach as error:
            print(f"walk {seed} ends: {error}")
            continue
        truth = TrueGround.of(world)
        for attitude in ("IMU", "no IMU"):
            for pause, scan, fused in grids(robot, walk, asked.mode, has_imu=attitude == "IMU"):
                for name, grid in (("scan", scan), ("map", fused)):
                    free = np.nonzero(grid.hazard == 0)
                    safe, steep = truly(robot, truth, pause, grid, free, limit)
                    for i, number in enumerate((1, len(free[0]), safe, steep)):
                        counts[attitude, name][i] += number
    for key, (number, free_cells, right, steep) in sorted(counts.items()):
        table.row(*key, number, free_cells, right / max(free_cells, 1), steep)
