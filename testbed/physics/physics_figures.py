"""Walk in MuJoCo with scans and a map, and errors of the map."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

import guara_perception as gp
from guara_perception.simulation import SimulatedRangefinder, World, specimen
from guara_perception.simulation.planner import plan_foothold
from guara_perception.simulation.walk import WalkPause
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK
from guara_perception.terrain.map.terrain_map import TerrainMap
from kinematics import LegOdometry, PoseInOdom, RobotModel, load_robot
from testbed.random_world import random_world

# Clearance of a foothold above which the map's height below it is compared with the truth.
CLEAR_M = 0.020


@dataclass
class WalkFigures:
    """Results of a physics walk.

    Attributes:
        grids: number of pauses with a grid.
        unsafe: number of cells in all grids that are unknown and nevertheless traversable.
        front, hind: height errors of the map under the chosen footholds of fore and hind feet that were scanned and
            have clearance [m].
        declared: number of footholds on ground that was only declared by the gait.
    """

    grids: int = 0
    unsafe: int = 0
    front: list[float] = field(default_factory=list)
    hind: list[float] = field(default_factory=list)
    declared: int = 0


def physics_figures(
    seed: int, cycles: float = 6, size: tuple[int, int] = (640, 512), imu: float = 0.00175
) -> WalkFigures:
    """Simulate a walk over boxes in MuJoCo with a scan at every pause and footholds chosen by the planner."""
    from guara_perception.simulation.walk import WalkNoise
    from testbed.physics.physics_walk import physics_walk

    robot = load_robot("guara")
    world = random_world(seed, length=1.8, boxes=7, rocks=0, pits=0, dark=0, undulation=0.0, box_heights=(0.01, 0.04))
    calibration = specimen(robot, (640, 512), seed=seed)
    walker = _Walker(world, robot, calibration)
    for pause in physics_walk(world, robot, walker.choose, cycles=cycles, seed=seed, noise=WalkNoise(imu=imu)):
        walker.scan(pause)
    return walker.figures


class _Walker:
    """Scanner, map and foothold planner of the walk."""

    def __init__(self, world: World, robot: RobotModel, calibration: gp.Calibration) -> None:
        self.figures = WalkFigures()
        self._world, self._robot, self._calibration = world, robot, calibration
        self._rangefinder = SimulatedRangefinder(world, calibration, robot)
        self._map, self._odometry = TerrainMap(robot), LegOdometry(robot)
        self._terrain: gp.TerrainGrid | None = None

    def scan(self, pause: WalkPause) -> None:
        """Scan and update the map."""
        self._rangefinder.set_pose(pause.transform_base_to_world, pause.joint_positions)
        processor = gp.ScanProcessor(self._calibration, self._robot, pause.stance, "coarse", step=pause.step)
        for index, on, off in self._rangefinder.frames(range(0, 70, 2)):
            processor.add(index, on, off)
        pose = self._odometry.update(pause.stance)
        scan = processor.finish()
        unregistered = PoseInOdom(pose.transform_footprint_to_odom, pose.covariance)
        self._terrain = self._map.update(processor.finish("wide"), unregistered, known_ground=pause.known_ground)
        self.figures.grids += 1
        for terrain in (scan, self._terrain):
            unknown = (terrain.hazard & UNKNOWN_MASK) != 0
            self.figures.unsafe += int((unknown & (terrain.traversability > 0)).sum())

    def choose(self, pause: WalkPause) -> tuple[float, float]:
        """Choose the planner's foothold or, if there is none, the nominal one, whose consequence the physics shows."""
        terrain = self._terrain
        assert terrain is not None
        found = plan_foothold(terrain, pause.next_leg, pause.nominal, robot=self._robot)
        if found is None:
            return pause.nominal
        iy, ix = (int(i) for i in terrain.geometry.indices(found.x, found.y))
        if terrain.looks[iy, ix] == 0:
            self.figures.declared += 1
        elif terrain.clearance[iy, ix] > CLEAR_M:
            # Transformed via base_link: the result must not depend on the feet that define z = 0 of the footprint.
            to_footprint = np.array(terrain.metadata["transform_base_to_footprint"])
            point = pause.transform_base_to_world @ np.linalg.solve(to_footprint, (found.x, found.y, found.z, 1.0))
            error = float(point[2] - self._world.height(point[0], point[1]))
            (self.figures.front if pause.next_leg.endswith("f") else self.figures.hind).append(error)
        return found.x, found.y


def rms(errors: list[float]) -> float:
    """Root mean square; NaN for an empty list."""
    return float(np.sqrt(np.mean(np.square(errors)))) if errors else float("nan")
