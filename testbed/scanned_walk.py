"""Walks with a scan at each pause, over analytic ground or with simulated frames, optionally cached in files."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar

import cv2
import numpy as np

import guara_perception as gp
from guara_perception.arrays import Float, Index
from guara_perception.ground_picture import GroundPicture
from guara_perception.settings import Settings
from guara_perception.simulation import SimulatedRangefinder, specimen
from guara_perception.simulation.planner import plan_foothold
from guara_perception.simulation.walk import WalkPause, simulate_walk
from guara_perception.simulation.world import World
from guara_perception.terrain.layers.geometry import GridGeometry
from guara_perception.terrain.scan.policy import ScanPolicy, refined
from kinematics import RobotModel, Stance
from kinematics.transforms import inverse, transform_points
from testbed.analytic_walk import Ground, LevelGround, scan, walk
from testbed.kinds_of_ground import Course
from testbed.random_world import random_world
from testbed.true_ground import TrueGround

Made = TypeVar("Made")
# Reflectance of red light below which ground, such as coal, rubber or black cloth, returns no stripe.
DARK_REFLECTANCE = 0.02
SEEN_CELL_M = 0.005
FOOT_HALF = (0.035, 0.025)
# Scan mode: coarse scans, with additional stripes where they find obstacles, as in the node.
ADAPTIVE = "adaptive"


@dataclass(frozen=True)
class WalkedPause:
    """Pause of a walk and its scan.

    Attributes:
        stance: reported stance.
        scan: grid of the scan.
        to_world: (4, 4) true pose of the scan's base_footprint.
        ground: analytic ground at the pause; None with simulated frames.
        known_ground: ground declared by the gait.
        feet: (n, 3) points in base_footprint below the next footholds of the hind feet, at the true height of the
            ground [m].
        picture: laser-off image of the scan, the reason why there is none, or None for a walk without images.
        floors: laser-off images of floors with other textures.
        slips: true slide of each standing foot since the last pause, in MuJoCo [m].
    """

    stance: Stance
    scan: gp.TerrainGrid
    to_world: Float
    ground: Ground | None = None
    known_ground: tuple[gp.KnownGround, ...] = ()
    feet: Float = field(default_factory=lambda: np.empty((0, 3)))
    picture: GroundPicture | str | None = None
    floors: tuple[GroundPicture | str, ...] = ()
    slips: tuple[float, ...] = ()


@dataclass(frozen=True)
class ScannedPause:
    """Pause of a walk with simulated frames, and the grid of its scan.

    Attributes:
        pause: the pause.
        scan: grid of the area "wide", which is fused in the map.
        picture: laser-off image for the map, or the reason why there is none.
        world: world at the pause.
        seen: (m, 2) indices iy and ix of the cells of `world` that an ideal scan would see (`visible_cells`).
    """

    pause: WalkPause
    scan: gp.TerrainGrid
    picture: GroundPicture | str
    world: World
    seen: Index

    @property
    def stance(self) -> Stance:
        """Stance as the robot reports it."""
        return self.pause.stance

    @property
    def known_ground(self) -> tuple[gp.KnownGround, ...]:
        """Ground that the gait declared."""
        return self.pause.known_ground

    @property
    def to_world(self) -> Float:
        """True pose (4, 4) of the scan's base_footprint in the world."""
        return footprint_to_world(self.pause.transform_base_to_world, self.scan)


def footprint_to_world(transform_base_to_world: Float, scan: gp.TerrainGrid) -> Float:
    """True pose (4, 4) of a scan's base_footprint in the world, from the true pose of the body."""
    base_to_footprint = np.array(scan.metadata["transform_base_to_footprint"])
    return np.asarray(transform_base_to_world @ np.linalg.inv(base_to_footprint))


def scanned_walk(
    robot: RobotModel, seed: int, *, mode: str = "coarse", cycles: int = 10, kept: Path | None = None
) -> tuple[World, list[ScannedPause]]:
    """Create a random world, and the scanned pauses of a walk over it.

    Footholds are chosen on the true ground, or are nominal if there is no good ground near. They do not depend on a
    map, so that the same walk can be evaluated with any map.

    Args:
        robot: the robot that walks.
        seed: seed of the random world, the specimen's calibration and the noise.
        mode: scan mode, or ADAPTIVE.
        cycles: number of cycles.
        kept: folder in which walks are cached; None = no cache.
    """
    world = random_world(seed)
    file = None if kept is None else kept / f"seen-{robot.name}-{seed}-{mode}-{cycles}.pickle"
    return world, kept_in(file, lambda: list(scanned(robot, ((0, world),), seed, mode, cycles)))


def kept_in(file: Path | None, make: Callable[[], Made]) -> Made:
    """Return the result of `make`, cached in a file; None = no cache."""
    if file is not None and file.is_file():
        made: Made = pickle.loads(file.read_bytes())
        return made
    made = make()
    if file is not None:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(pickle.dumps(made))
    return made


def map_geometry(robot: RobotModel) -> GridGeometry:
    """Geometry of the fused map."""
    settings = Settings.of(robot)
    return GridGeometry.over(settings.map_x, settings.map_y, settings.resolution)


def scanned(robot: RobotModel, course: Course, seed: int, mode: str, cycles: int) -> Iterator[ScannedPause]:
    """Yield the scanned pauses of a walk over a course; if its world changes, the feet stand on the bare ground."""
    cv2.setNumThreads(1)
    calibration = specimen(robot, (640, 512), seed)
    geometry, settings = map_geometry(robot), Settings.of(robot)
    rangefinders = [(first, SimulatedRangefinder(world, calibration, robot, seed)) for first, world in course]
    truths = {rangefinder.world: TrueGround.of(rangefinder.world) for _, rangefinder in rangefinders}
    policy = ScanPolicy(robot)
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
        first = "coarse" if mode == ADAPTIVE else mode
        processor = gp.ScanProcessor(calibration, robot, pause.stance, first, step=pause.step)
        pattern = settings.pattern("standard" if mode == ADAPTIVE else mode)
        fired = settings.pattern(first)
        processor, terrain, _ = swept(processor, rangefinder, fired, policy if mode == ADAPTIVE else None)
        to_world = footprint_to_world(pause.transform_base_to_world, terrain)
        seen = visible_cells(pause, to_world, rangefinder, settings, [pattern[0], pattern[-1]])
        yield ScannedPause(pause, terrain, processor.ground_picture, rangefinder.world, seen)


def swept(
    processor: gp.ScanProcessor, rangefinder: SimulatedRangefinder, stripes: Sequence[int], policy: ScanPolicy | None
) -> tuple[gp.ScanProcessor, gp.TerrainGrid, int]:
    """Scan stripes and those that a policy adds; return the last processor, the wide grid and the number of stripes."""
    processor.add_all([gp.FramePair(*each) for each in rangefinder.frames(stripes)])
    terrain = processor.finish("wide")
    if policy is None or not (between := policy.decide(processor.finish(), processor.pairs).stripes):
        return processor, terrain, len(stripes)
    processor = processor.extended()
    processor.add_all([gp.FramePair(*each) for each in rangefinder.frames(between)])
    return processor, refined(terrain, processor.finish("wide")), len(stripes) + len(between)


def visible_cells(
    pause: WalkPause,
    transform_footprint_to_world: Float,
    rangefinder: SimulatedRangefinder,
    settings: Settings,
    outermost: list[int],
) -> Index:
    """Indices (m, 2) of the cells of a world that an ideal scan would see between its outermost stripes.

    The cells reflect the laser, are lit and in view of the camera, and within the ranges of the scan's footprint.
    """
    view = rangefinder.view
    lit = (view.laser_gain > 0) & ~view.is_body & (view.reflectance > DARK_REFLECTANCE)
    points = view.points[lit] + view.origin
    planes = rangefinder.laser_planes.planes_in_base[outermost]
    beyond = transform_points(inverse(pause.transform_base_to_world), points) @ planes[:, :3].T + planes[:, 3]
    x, y, z = transform_points(inverse(transform_footprint_to_world), points).T
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


def analytic_pauses(robot: RobotModel, seed: int, cycles: int, *, level: bool = False) -> Iterator[WalkedPause]:
    """Yield the pauses of a walk over analytic ground, with joint and contact noise and without frames."""
    ground = Ground.random(seed)
    if level:
        ground = LevelGround(ground.boxes[:0], ground.dark[:0], ground.phases)
    for pause in walk(robot, ground, cycles, seed):
        terrain = scan(robot, ground, pause, seed)
        to_world = footprint_to_world(pause.transform_base_to_world, terrain)
        under = np.concatenate([_sole(pause.next_footholds[leg][:2]) for leg in ("lh", "rh")])
        height = ground.height_at(under[:, 0], under[:, 1])
        yield WalkedPause(pause.stance, terrain, to_world, ground, feet=_in_footprint(to_world, under, height))


def framed_pauses(robot: RobotModel, seed: int, cycles: int, kept: Path | None) -> Iterator[WalkedPause]:
    """Yield the pauses of `scanned_walk`."""
    world, pauses = scanned_walk(robot, seed, cycles=cycles, kept=kept)
    for item in pauses:
        pause, to_world = item.pause, item.to_world
        under = _sole(np.array(pause.to_world(*pause.nominal))) if pause.nominal[0] < 0 else np.empty((0, 2))
        feet = _in_footprint(to_world, under, world.height(under[:, 0], under[:, 1]))
        yield WalkedPause(pause.stance, item.scan, to_world, known_ground=pause.known_ground, feet=feet)


def _sole(centre: Float) -> Float:
    """Points (n, 2) below a sole."""
    dx, dy = (a.ravel() for a in np.meshgrid(*(np.linspace(-half, half, 8) for half in FOOT_HALF)))
    return np.asarray(centre + np.column_stack((dx, dy)))


def _in_footprint(to_world: Float, points_xy: Float, height: Float) -> Float:
    points = np.column_stack((points_xy, height))
    return np.asarray((points - to_world[:3, 3]) @ to_world[:3, :3])
