"""Short simulated walk of a robot, scanned pause by pause, over ground laid out along its tracks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from guara_perception.app.robot_folder.scan_checks import PICTURE_PX
from guara_perception.exceptions import PerceptionError
from guara_perception.progress import Progress
from guara_perception.settings import Settings
from guara_perception.simulation.features import Box, Patch, Pit, material_index
from guara_perception.simulation.gait import WaveGait
from guara_perception.simulation.planner import plan_foothold
from guara_perception.simulation.rangefinder import SimulatedRangefinder
from guara_perception.simulation.specimen import specimen
from guara_perception.simulation.walk import Choice, WalkPause, simulate_walk
from guara_perception.simulation.world import World
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK
from kinematics import KinematicsError, LegOdometry, RobotModel

PAUSES = 10
SOLE_SAMPLES = 7


@dataclass(frozen=True, slots=True)
class TrialWalk:
    """Result of a trial walk.

    Attributes:
        pauses: number of pauses that were scanned.
        unknown_called_safe: number of cells of all grids that are unknown and traversable; must be 0.
        feet: number of footholds that were chosen.
        feet_on_hazard: number of footholds on a hazard, in the map or on the true ground; must be 0.
        known: fraction of a scan's area that is known, mean of all scans.
        ended: reason why the walk ended early, None if it did not.
    """

    pauses: int
    unknown_called_safe: int
    feet: int
    feet_on_hazard: int
    known: float
    ended: str | None


def trial_world(robot: RobotModel) -> World:
    """Ground for ten pauses, with a box and a dark patch in the tracks, a pit beside them and a box between them."""
    gait = WaveGait.of(robot)
    hips = np.array(list(gait.hips.values()))
    front, track = float(hips[:, 0].max()), float(np.abs(hips[:, 1]).max())
    return World(
        x=(-2.0, 4.0),
        y=(-1.5, 1.5),
        undulation=0.001,
        flat_until=front + 0.25,
        seed=3,
        features=(
            Box(x=front + 0.36, y=track + 0.03, size=(0.04, 0.04), height=0.04),
            Patch(x=front + 0.34, y=-track - 0.02, size=(0.05, 0.05), material="dark"),
            Pit(x=front + 0.30, y=track + 0.17, size=(0.10, 0.10), depth=0.05),
            Box(x=front + 0.50, y=0.0, size=(0.06, 0.06), height=0.05, yaw=0.4, material="brick"),
        ),
    )


def trial_walk(robot: RobotModel, *, pauses: int = PAUSES, progress: Progress | None = None) -> TrialWalk:
    """Simulate a walk over the trial ground, with coarse scans, odometry, map and planner.

    Args:
        robot: robot that walks.
        pauses: number of stance pauses to scan.
        progress: called after each pause with (pauses done, total number of pauses).
    """
    from guara_perception.scanning.scan_processor import ScanProcessor
    from guara_perception.terrain.map.terrain_map import TerrainMap

    world, settings = trial_world(robot), Settings.of(robot)
    calibration = specimen(robot, PICTURE_PX, 0)
    rangefinder = SimulatedRangefinder(world, calibration, robot, 0)
    odometry = LegOdometry(robot, transform_camera_to_base=calibration.transform_camera_to_base)
    rolling = TerrainMap(robot)
    known: list[float] = []
    on_hazard: list[bool] = []
    unknown_called_safe, ended = 0, None

    def choose(pause: WalkPause) -> Choice:
        found = plan_foothold(fused, pause.next_leg, pause.nominal, robot=robot)
        if found is None:
            return None
        is_hazard = fused.hazard_at(found.x, found.y) != 0
        on_hazard.append(is_hazard or _is_bad_ground(robot, world, *pause.to_world(found.x, found.y)))
        return found.x, found.y

    try:
        for pause in simulate_walk(world, robot, choose, cycles=(pauses - 1) / len(robot.legs), seed=0):
            rangefinder.set_pose(pause.transform_base_to_world, pause.joint_positions)
            processor = ScanProcessor(calibration, robot, pause.stance, "coarse", step=pause.step)
            for index, on, off in rangefinder.frames(settings.pattern("coarse")):
                processor.add(index, on, off)
            terrain = processor.finish()
            pose = odometry.update(pause.stance)
            picture = processor.ground_picture
            fused = rolling.update(processor.finish("wide"), pose, known_ground=pause.known_ground, picture=picture)
            known.append(float(np.isfinite(terrain.elevation).mean()))
            for grid in (terrain, fused):
                unknown = (grid.hazard & UNKNOWN_MASK) != 0
                unknown_called_safe += int(np.count_nonzero(unknown & (grid.traversability > 0)))
            if progress is not None:
                progress(len(known), pauses)
    except (PerceptionError, KinematicsError) as error:
        ended = f"{type(error).__name__}: {error}"
    mean = float(np.mean(known)) if known else 0.0
    return TrialWalk(len(known), unknown_called_safe, len(on_hazard), sum(on_hazard), mean, ended)


def _is_bad_ground(robot: RobotModel, world: World, x: float, y: float) -> bool:
    """True if the ground under a sole absorbs the laser or is less even than the limits allow."""
    length, width = robot.sole
    u, v = np.meshgrid(np.linspace(-0.5, 0.5, SOLE_SAMPLES) * length, np.linspace(-0.5, 0.5, SOLE_SAMPLES) * width)
    heights, limits = world.height(x + u, y + v), Settings.of(robot).limits
    is_dark = bool(np.any(world.material_at(x + u, y + v) == material_index("dark")))
    return is_dark or float(np.ptp(heights)) > min(limits.step, limits.drop)
