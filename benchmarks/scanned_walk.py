"""Walks over random worlds, scanned by the simulated rangefinder frame by frame; kept in files on request."""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

import guara_perception as gp
from benchmarks.true_ground import TrueGround
from guara_perception.settings import Settings
from guara_perception.simulation import SimulatedRangefinder, random_world, specimen
from guara_perception.simulation.planner import plan_foothold
from guara_perception.simulation.walk import WalkPause, simulate_walk
from guara_perception.simulation.world import World
from guara_perception.terrain.layers.geometry import GridGeometry
from kinematics import RobotModel


@dataclass(frozen=True)
class ScannedPause:
    """One pause and the scan that was taken there, of the wide area, as the map takes it."""

    pause: WalkPause
    scan: gp.TerrainGrid


def scanned_walk(
    robot: RobotModel, seed: int, *, mode: str = "coarse", cycles: int = 10, kept: Path | None = None
) -> tuple[World, list[ScannedPause]]:
    """The world of a seed and the scanned pauses of a walk over it.

    The feet go where the truth is good, so that the same walk can be judged with any map.

    Args:
        robot: that walks.
        seed: of world, specimen and noise.
        mode: of the scans.
        cycles: how far.
        kept: folder with walks of earlier runs, written where missing; None = scan now.
    """
    world = random_world(seed)
    file = None if kept is None else kept / f"wide-{seed}-{mode}-{cycles}.pickle"
    if file is not None and file.is_file():
        return world, pickle.loads(file.read_bytes())
    pauses = list(_scan(robot, world, seed, mode, cycles))
    if file is not None:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(pickle.dumps(pauses))
    return world, pauses


def map_geometry(robot: RobotModel) -> GridGeometry:
    """Geometry of the fused map."""
    settings = Settings.of(robot)
    return GridGeometry.over(settings.map_x, settings.map_y, settings.resolution)


def _scan(robot: RobotModel, world: World, seed: int, mode: str, cycles: int) -> Iterator[ScannedPause]:
    cv2.setNumThreads(1)
    calibration = specimen(robot, (640, 512), seed)
    rangefinder = SimulatedRangefinder(world, calibration, robot, seed)
    truth, geometry = TrueGround.of(world), map_geometry(robot)

    def choose(pause: WalkPause) -> tuple[float, float]:
        grid, _ = truth.grid(
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

    for pause in simulate_walk(world, robot, choose, cycles=cycles, seed=seed):
        rangefinder.set_pose(pause.transform_base_to_world, pause.joint_positions)
        processor = gp.ScanProcessor(calibration, robot, pause.stance, mode, step=pause.step)
        for index, on, off in rangefinder.frames(Settings.of(robot).pattern(mode)):
            processor.add(index, on, off)
        yield ScannedPause(pause, processor.finish("wide"))
