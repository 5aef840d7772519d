"""Walks with the errors stated in robot.toml and calibration: biases of joints, IMU, laser planes and mount."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np

import guara_perception as gp
from guara_perception.arrays import Float, Float32
from guara_perception.calibration.calibration import StripePlane
from guara_perception.calibration.height_sigma import HeightUncertainty
from guara_perception.images import to_grey
from guara_perception.settings import Settings
from guara_perception.simulation import SimulatedRangefinder, World, specimen
from guara_perception.simulation.features import Box, Ramp
from guara_perception.simulation.gait import WaveGait
from guara_perception.simulation.light import Light
from guara_perception.simulation.specimen import rotation
from guara_perception.simulation.walk import WalkNoise, WalkPause, fresh_reading, simulate_walk
from kinematics import LegOdometry, RobotModel, Stance
from kinematics.footprint import fit_support_plane, transform_base_to_footprint
from kinematics.transforms import inverse, transform_points
from testbed.physics.physics_walk import PhysicsPause, physics_walk
from testbed.random_world import random_world
from testbed.scanned_walk import WalkedPause, footprint_to_world
from testbed.scenes import OWN_DATA, real_calibration, with_covariance
from testbed.true_ground import CELL_M

SIZE = (640, 512)
# Standard deviations of smooth and rough ground, and limits of the wavelengths of rough ground [m].
SMOOTH_M, ROUGH_M, WAVES_M = 0.005, 0.0015, (0.04, 0.2)
# Edge length and smallest height of the blocks under the feet of the first stance [m].
BLOCK_M, LEAST_BLOCK_M = 0.12, 0.002
# Speckle as strong as assumed in the sigmas of stripes.
LIGHT = Light(speckle=0.3)
# Limits between which the texture factor and the slide of a walk are drawn at random.
TEXTURES, SLIDES = (0.4, 3.0), (-0.08, 0.08)
# Crawls in MuJoCo: by forces, or by position servos, with which the feet creep.
CRAWLS = ("force", "stiff")
# Footholds in MuJoCo: distance from edges, largest height difference, and shifts in the order of trial [m].
MARGIN_M, LEVEL_M, SHIFTS_M = 0.010, 0.002, (0.0, 0.01, -0.01, 0.02, -0.02, 0.03, -0.03, 0.04, -0.04)


@dataclass(frozen=True)
class Walk:
    """Walk as reported by the robot.

    Attributes:
        world: the ground.
        calibration: calibration used by the robot, which differs slightly from that of its rangefinder.
        pauses: pauses, each with the frames of its scan.
    """

    world: World
    calibration: gp.Calibration
    pauses: list[tuple[WalkPause, list[gp.FramePair]]]


def drawn(true: gp.Calibration, rng: np.random.Generator) -> gp.Calibration:
    """Draw a calibration with errors of planes and mount, from the covariance of the recorded session."""
    uncertainty = HeightUncertainty.of(real_calibration(OWN_DATA))
    assert uncertainty is not None
    stripes = _drawn_planes(true, uncertainty, rng)
    # Constant and linear terms of the field of height errors: the camera is raised, and turned about the field's
    # origin.
    lift, by_x, by_y = rng.multivariate_normal(np.zeros(3), uncertainty.field[:3, :3], method="svd")
    turn = np.eye(4)
    turn[:3, :3] = rotation(np.array([by_y, -by_x, 0.0]))
    turn[:3, 3] = uncertainty.field_origin - turn[:3, :3] @ uncertainty.field_origin + (0.0, 0.0, lift)
    mount = turn @ true.transform_camera_to_base
    return with_covariance(replace(true, stripes=stripes, transform_camera_to_base=mount))


def _drawn_planes(
    true: gp.Calibration, uncertainty: HeightUncertainty, rng: np.random.Generator
) -> tuple[StripePlane, ...]:
    stripes = []
    for stripe in true.stripes:
        plane = rng.multivariate_normal(stripe.plane, uncertainty.plane_covariances([stripe.index])[0], method="svd")
        stripes.append(replace(stripe, plane=plane / np.linalg.norm(plane[:3])))
    return tuple(stripes)


def leaning_world(robot: RobotModel, seed: int, *, rough: bool) -> World:
    """Create smooth or rough ground, with blocks under the first stance on a slope drawn from `terrain_slope_sigma`."""
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
    """Create ground with four ramps that are too steep, and a slope of 3 to 15 degrees or a box under the fore feet."""
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
    """Simulate the walk of a robot with random biases over a world."""
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


def scans(robot: RobotModel, walk: Walk, mode: str, *, has_imu: bool) -> Iterator[tuple[WalkPause, gp.TerrainGrid]]:
    """Yield each pause of a walk, with the reported stance, and its scan."""
    odometry = LegOdometry(robot)
    for pause, frames in walk.pauses:
        stance = pause.stance if has_imu else replace(pause.stance, gravity_in_base=None)
        gravity = odometry.carried_gravity(stance)
        processor = gp.ScanProcessor(walk.calibration, robot, stance, mode, step=pause.step, gravity=gravity)
        processor.add_all(frames)
        odometry.update(stance)
        yield replace(pause, stance=stance), processor.finish("wide")


def fused(
    robot: RobotModel, seen: Iterable[tuple[WalkPause, gp.TerrainGrid]]
) -> Iterator[tuple[WalkPause, gp.TerrainGrid, gp.TerrainGrid]]:
    """Yield each pause of a walk with its scan and its map."""
    odometry, rolling = LegOdometry(robot), gp.TerrainMap(robot)
    for pause, scan in seen:
        yield pause, scan, rolling.update(scan, odometry.update(pause.stance))


def true_frame(robot: RobotModel, world: World, pause: WalkPause, grid: gp.TerrainGrid) -> Float:
    """True pose (4, 4) of a grid's frame in the world, computed from the ground under the support feet it used."""
    length, width = robot.sole
    standing = [pause.soles_in_world[leg] for leg in grid.record.support_feet_used or ()]
    ground = [(x, y, world.sole_height(x, y, length, width)) for x, y, _ in standing]
    soles = transform_points(inverse(pause.transform_base_to_world), np.array(ground))
    is_plane = grid.record.attitude_source == "support_plane"
    up = fit_support_plane(soles).normal if is_plane else pause.transform_base_to_world[2, :3]
    return pause.transform_base_to_world @ inverse(transform_base_to_footprint(soles, up))


def true_heights(robot: RobotModel, world: World, means: Float32, pause: WalkPause, grid: gp.TerrainGrid) -> Float:
    """True heights (ny, nx) of the ground in a grid's cells, in the grid's true frame [m].

    Cells are located with the estimated pose of the grid, since the same ground has other x and y in a tilted frame.

    Args:
        robot: the robot.
        world: the ground.
        means: heights of the world, averaged over a cell of the grid, in a raster of millimetre cells.
        pause: pause of the grid.
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


def pictured(
    robot: RobotModel,
    seed: int,
    cycles: float,
    texture: float | None,
    slide: float | None,
    *,
    crawl: str | None = None,
    floors: Sequence[float] = (),
) -> Iterator[WalkedPause]:
    """Yield the pauses of a walk with scans of simulated frames.

    Args:
        robot: robot that walks.
        seed: seed of ground, robot and noise.
        cycles: number of cycles.
        texture: factor of the ground's texture; None = random.
        slide: slide of standing feet, as in `WalkNoise`; None = random.
        crawl: one of `CRAWLS`, a walk in MuJoCo, where contacts determine the slide; None = kinematics only.
        floors: texture factors for which additional laser-off images are rendered.
    """
    rng = np.random.default_rng(1000 + seed)
    texture = float(np.exp(rng.uniform(*np.log(TEXTURES)))) if texture is None else texture
    noise = WalkNoise(joint=0.0, slide=float(rng.uniform(*SLIDES)) if slide is None else slide)
    if crawl:
        world = random_world(seed, boxes=7, rocks=0, pits=0, dark=0, undulation=0.0, box_heights=(0.01, 0.04))
    else:
        world = random_world(seed)
    true = specimen(robot, (640, 512), seed)
    calibration = drawn(true, rng)
    bias = dict(zip(robot.tree.joint_names, robot.noise.encoder_sigma * rng.standard_normal(99), strict=False))
    rangefinder, *others = (
        SimulatedRangefinder(world, true, robot, seed, light=Light(texture=each)) for each in (texture, *floors)
    )
    for pause in _walk(robot, world, seed, cycles, noise, crawl):
        for each in (rangefinder, *others):
            each.set_pose(pause.transform_base_to_world, pause.joint_positions)
        joints = {name: angle + bias[name] for name, angle in pause.joint_positions.items()}
        stance = Stance(joints, robot.legs, pause.stance.gravity_in_base)
        stance = fresh_reading(stance, rng, robot.noise.encoder_noise)
        processor, off = gp.ScanProcessor(calibration, robot, stance, "coarse", step=pause.step), None
        for index in Settings.of(robot).pattern("coarse"):
            off = rangefinder.frame(laser=0.0) if off is None else off
            processor.add(index, rangefinder.frame(mirror_angle=true.stripe(index).mirror_angle), off)
        scan = processor.finish("wide")
        to_world = footprint_to_world(pause.transform_base_to_world, scan)
        picture = processor.ground_picture
        yield WalkedPause(
            stance,
            scan,
            to_world,
            known_ground=pause.known_ground,
            picture=picture,
            floors=tuple(
                picture if isinstance(picture, str) else replace(picture, grey=to_grey(each.frame(laser=0.0)))
                for each in others
            ),
            slips=tuple(pause.slips.values()) if isinstance(pause, PhysicsPause) else (),
        )


def _walk(
    robot: RobotModel, world: World, seed: int, cycles: float, noise: WalkNoise, crawl: str | None
) -> Iterator[WalkPause]:
    if crawl is None:
        return simulate_walk(world, robot, cycles=cycles, seed=seed, noise=noise)
    choose = partial(_level_foothold, world, robot)
    return physics_walk(world, robot, choose, cycles=cycles, seed=seed, noise=noise, is_stiff=crawl == "stiff")


def _level_foothold(world: World, robot: RobotModel, pause: WalkPause) -> tuple[float, float]:
    """Foothold nearest to the nominal one at which the sole does not overlap an edge."""
    (x, y), (length, width) = pause.nominal, robot.sole
    corners = (MARGIN_M + np.array([length, width]) / 2) * [(1, 1), (1, -1), (-1, 1), (-1, -1), (0, 0)]
    for shift in SHIFTS_M:
        places = np.array([pause.to_world(x + shift, y)]) + corners
        if np.ptp(world.height(*places.T)) < LEVEL_M:
            return x + shift, y
    return x, y
