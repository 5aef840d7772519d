"""Walks: maps of their pauses, and those over random worlds, scanned frame by frame and on request kept in files."""

from __future__ import annotations

import pickle
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar

import cv2
import numpy as np

import guara_perception as gp
from benchmarks.true_ground import TrueGround
from guara_perception.arrays import Float, Index, Mask
from guara_perception.ground_picture import GroundPicture
from guara_perception.settings import Settings
from guara_perception.simulation import SimulatedRangefinder, specimen
from guara_perception.simulation.planner import plan_foothold
from guara_perception.simulation.walk import WalkPause, simulate_walk
from guara_perception.simulation.world import World
from guara_perception.terrain.layers.geometry import GridGeometry
from kinematics import LegOdometry, PoseInOdom, RobotModel, Stance
from kinematics.transforms import inverse, transform_points
from testbed.analytic_walk import Ground
from testbed.kinds_of_ground import Course
from testbed.random_world import random_world

# The first step that is judged: at earlier ones the map holds little but the ground that the gait declared.
FIRST_JUDGED_STEP = 4
# From the near edge of the scanned area to the hind feet, and a place there on either side.
PAUSES_BETWEEN = 21
# Ground that reflects less red light returns no stripe: coal, rubber, black cloth.
DARK_REFLECTANCE = 0.02
SEEN_CELL_M = 0.005
SEEN_AT = np.array([[0.5, -0.18, 0.0, 1.0], [0.5, 0.18, 0.0, 1.0]])


@dataclass(frozen=True)
class WalkedPause:
    """One pause of a walk.

    Attributes:
        stance: stance as the robot reports it.
        scan: grid of the scan taken there.
        to_world: (4, 4), where the scan's footprint truly was.
        ground: analytic ground at that time; None in simulated frames.
        known_ground: what the gait declared.
        feet: (n, 3) points in base_footprint under the hind feet's next footholds, at the true height of the ground.
    """

    stance: Stance
    scan: gp.TerrainGrid
    to_world: Float
    ground: Ground | None
    known_ground: tuple[gp.KnownGround, ...] = ()
    feet: Float = field(default_factory=lambda: np.empty((0, 3)))


Pause = TypeVar("Pause", bound=WalkedPause)


def fused_pauses(
    terrain_map: gp.TerrainMap, robot: RobotModel, pauses: Sequence[Pause], *, registered: bool
) -> Iterator[tuple[Pause, gp.TerrainGrid]]:
    """Pauses with their maps; without registration of the scans the map follows odometry alone."""
    odometry = LegOdometry(robot)
    for pause in pauses:
        pose: PoseInOdom = odometry.update(pause.stance)
        if not registered:
            pose = PoseInOdom(pose.transform_footprint_to_odom, pose.covariance)
        yield pause, terrain_map.update(pause.scan, pose, known_ground=pause.known_ground)


def drift_aside(pauses: Sequence[WalkedPause], poses: Sequence[Float]) -> Float:
    """Drift (n, 2) of a map's poses along x and y while ground seen at the near edge comes to the hind feet [mm]."""
    aside = []
    for before, now in zip(range(len(pauses) - PAUSES_BETWEEN), range(PAUSES_BETWEEN, len(pauses)), strict=True):
        found = np.linalg.inv(poses[now]) @ poses[before]
        truly = np.linalg.inv(pauses[now].to_world) @ pauses[before].to_world
        aside += [((found - truly) @ point)[:2] for point in SEEN_AT]
    return 1e3 * np.array(aside)


@dataclass(frozen=True)
class ScannedPause:
    """One pause of a walk and the grid of its scan.

    Attributes:
        pause: the pause.
        scan: the grid of the extent "wide", which the map fuses.
        picture: its laser-off picture for the map.
        world: the world at that pause.
        seen: (m, 2) iy and ix of the cells of `world` that can be seen: bright, in reach of laser and camera, in range.
    """

    pause: WalkPause
    scan: gp.TerrainGrid
    picture: GroundPicture | str
    world: World
    seen: Index


@dataclass(frozen=True)
class JudgedPause:
    """One pause of a walk with its map and the truth.

    Attributes:
        item: the pause and its scan.
        fused: the fused map, whose poses come from odometry and drift.
        ceiling: bounds of the ground of the map's cells, known and unknown.
        sight_seconds: processor time that these bounds took [s].
        oracle: the map as it would be if every cell of it were known exactly.
        dark: (ny, nx) cells with ground that swallows the laser.
        from_world: (4, 4) true transform from the world to base_footprint of the scan.
    """

    item: ScannedPause
    fused: gp.TerrainGrid
    ceiling: gp.Ceiling
    sight_seconds: float
    oracle: gp.TerrainGrid
    dark: Mask
    from_world: Float


def judged_walk(robot: RobotModel, truth: TrueGround, pauses: Iterable[ScannedPause]) -> Iterator[JudgedPause]:
    """Fuse the scans of a walk at the poses of odometry; yields pauses from FIRST_JUDGED_STEP on with map and truth."""
    terrain_map, odometry = gp.TerrainMap(robot), LegOdometry(robot)
    sight = gp.LinesOfSight(terrain_map)
    for item in pauses:
        pause, scan = item.pause, item.scan
        fused = terrain_map.update(scan, odometry.update(pause.stance), known_ground=pause.known_ground)
        begun = time.process_time()
        sight.add(scan, fused)
        ceiling = sight.ceiling(fused)
        seconds = time.process_time() - begun
        if pause.step < FIRST_JUDGED_STEP:
            continue
        transform_base_to_footprint = np.array(scan.metadata["transform_base_to_footprint"])
        transform_footprint_to_world = pause.transform_base_to_world @ np.linalg.inv(transform_base_to_footprint)
        stance = {name: fused.metadata[name] for name in ("stance", "transform_base_to_footprint")}
        oracle, dark = truth.grid(transform_footprint_to_world, map_geometry(robot), robot, **stance)
        transform_world_to_footprint = np.asarray(np.linalg.inv(transform_footprint_to_world), np.float64)
        yield JudgedPause(item, fused, ceiling, seconds, oracle, dark, transform_world_to_footprint)


def scanned_walk(
    robot: RobotModel, seed: int, *, mode: str = "coarse", cycles: int = 10, kept: Path | None = None
) -> tuple[World, list[ScannedPause]]:
    """The world of a seed and the scanned pauses of a walk over it.

    Each foot goes where the true ground is best, or to its nominal position where no good ground is near. No map
    influences that choice, so the same walk can be judged with any map.

    Args:
        robot: the robot that walks.
        seed: seed of the random world, the specimen's calibration and the noise.
        mode: scan mode.
        cycles: number of cycles walked.
        kept: folder for walks; a walk that is there is read, any other is scanned and written. None = nothing is
            read or written.
    """
    world = random_world(seed)
    file = None if kept is None else kept / f"seen-{robot.name}-{seed}-{mode}-{cycles}.pickle"
    if file is not None and file.is_file():
        return world, pickle.loads(file.read_bytes())
    pauses = list(scanned(robot, ((0, world),), seed, mode, cycles))
    if file is not None:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(pickle.dumps(pauses))
    return world, pauses


def map_geometry(robot: RobotModel) -> GridGeometry:
    """Geometry of the fused map."""
    settings = Settings.of(robot)
    return GridGeometry.over(settings.map_x, settings.map_y, settings.resolution)


def scanned(robot: RobotModel, course: Course, seed: int, mode: str, cycles: int) -> Iterator[ScannedPause]:
    """Scanned pauses of a walk over a world that may change; over one that does, feet stand on its bare ground."""
    cv2.setNumThreads(1)
    calibration = specimen(robot, (640, 512), seed)
    geometry, settings = map_geometry(robot), Settings.of(robot)
    rangefinders = [(first, SimulatedRangefinder(world, calibration, robot, seed)) for first, world in course]
    truths = {rangefinder.world: TrueGround.of(rangefinder.world) for _, rangefinder in rangefinders}
    walked = course[0][1] if len(course) == 1 else replace(course[0][1], features=())

    def at(step: int) -> SimulatedRangefinder:
        return [rangefinder for first, rangefinder in rangefinders if first <= step][-1]

    def choose(pause: WalkPause) -> tuple[float, float]:
        grid, _ = truths[at(pause.step).world].grid(
            pause.transform_footprint_to_world,
            geometry,
            robot,
            stance=pause.stance.to_dict(),
            transform_base_to_footprint=np.linalg.solve(
                pause.transform_footprint_to_world, pause.transform_base_to_world
            ).tolist(),
        )
        found = plan_foothold(grid, pause.next_leg, pause.nominal, robot=robot)
        return pause.nominal if found is None else (found.x, found.y)

    for pause in simulate_walk(walked, robot, choose, cycles=cycles, seed=seed):
        rangefinder = at(pause.step)
        rangefinder.set_pose(pause.transform_base_to_world, pause.joint_positions)
        processor = gp.ScanProcessor(calibration, robot, pause.stance, mode, step=pause.step)
        pattern = settings.pattern(mode)
        for index, on, off in rangefinder.frames(pattern):
            processor.add(index, on, off)
        seen = _seen(pause, rangefinder, settings, [pattern[0], pattern[-1]])
        yield ScannedPause(pause, processor.finish("wide"), processor.ground_picture, rangefinder.world, seen)


def _seen(pause: WalkPause, rangefinder: SimulatedRangefinder, settings: Settings, outermost: list[int]) -> Index:
    """Cells of a world that an ideal scan would see between its outermost stripes."""
    view = rangefinder.view
    lit = (view.laser_gain > 0) & ~view.is_body & (view.reflectance > DARK_REFLECTANCE)
    points = view.points[lit] + view.origin
    planes = rangefinder.laser_planes.planes_in_base[outermost]
    beyond = transform_points(inverse(pause.transform_base_to_world), points) @ planes[:, :3].T + planes[:, 3]
    x, y, z = transform_points(inverse(pause.transform_footprint_to_world), points).T
    within = (beyond[:, 0] > 0) & (beyond[:, 1] < 0)
    for axis, (low, high) in (
        (x, settings.footprint_x),
        (y, settings.map_y),
        (z, (settings.minimum_height, settings.maximum_height)),
    ):
        within &= (axis > low) & (axis < high)
    world = rangefinder.world
    cells = np.floor((points[within, :2] - (world.x[0], world.y[0])) / SEEN_CELL_M).astype(np.intp)
    return np.unique(cells[:, ::-1], axis=0)
