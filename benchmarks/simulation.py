"""Prints the simulation's figures: frames per second, height error through the whole pipeline, the physics walk."""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, field

import cv2
import numpy as np
import numpy.typing as npt

import guara_perception as gp
from guara_perception.arrays import Float
from guara_perception.simulation import SimulatedRangefinder, World, random_world, specimen
from guara_perception.simulation.features import Box
from guara_perception.simulation.planner import plan_foothold
from guara_perception.simulation.polar import PolarView
from guara_perception.simulation.relief import Relief
from guara_perception.simulation.walk import WalkPause
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK
from guara_perception.terrain.map.terrain_map import TerrainMap
from kinematics import LegOdometry, RobotModel, Stance, load_robot

# As the README of the recorded data defines an interior cell.
JUMP_M = 0.003
INTERIOR_MARGIN_MM = 6
# Under a foothold with this clearance the map is compared with the truth.
CLEAR_M = 0.020
BOXES = World(
    features=(
        Box(x=0.62, y=0.12, size=(0.08, 0.08), height=0.04, yaw=0.2, material="concrete"),
        Box(x=0.75, y=-0.10, size=(0.10, 0.08), height=0.08, yaw=0.1, material="brick"),
        Box(x=0.80, y=0.15, size=(0.10, 0.08), height=0.05),
        Box(x=0.60, y=-0.15, size=(0.08, 0.08), height=0.02),
        Box(x=0.88, y=0.02, size=(0.06, 0.06), height=0.03, material="concrete"),
    )
)


@dataclass
class WalkFigures:
    """What the physics walk amounted to; errors in metres.

    Attributes:
        grids: pauses that gave a grid.
        unsafe: cells that are unknown and traversable, in all grids.
        front, hind: error of the map's height under each chosen foothold with clearance that was scanned.
        declared: footholds on ground that only the gait vouched for.
    """

    grids: int = 0
    unsafe: int = 0
    front: list[float] = field(default_factory=list)
    hind: list[float] = field(default_factory=list)
    declared: int = 0


def standing(height: float = 0.36) -> Float:
    """The body level over the origin."""
    transform = np.eye(4)
    transform[2, 3] = height
    return transform


def frame_rates(size: tuple[int, int]) -> tuple[float, float, float]:
    """Frames per second with the laser on, frames per second in on/off pairs, and seconds to place the robot."""
    robot = load_robot("guara")
    calibration = specimen(robot, size, seed=1)
    rangefinder = SimulatedRangefinder(BOXES, calibration, robot)
    rangefinder.set_pose(standing(), robot.posture("scan"))
    start = time.perf_counter()
    rangefinder.set_pose(standing(), robot.posture("scan"))
    placed = time.perf_counter()
    for stripe in calibration.stripes:
        rangefinder.frame(mirror_angle=stripe.mirror_angle)
    lit = time.perf_counter()
    pairs = list(rangefinder.frames(calibration.indices))
    end = time.perf_counter()
    count = len(calibration.stripes)
    return count / (lit - placed), 2 * len(pairs) / (end - lit), placed - start


def height_errors(world: World, size: tuple[int, int]) -> tuple[Float, float]:
    """Errors of all interior cells [m] of one standard scan, and the share of them that is known."""
    robot = load_robot("guara")
    calibration = specimen(robot, size, seed=1)
    rangefinder = SimulatedRangefinder(world, calibration, robot)
    posture = robot.posture("scan")
    rangefinder.set_pose(standing(), posture)
    processor = gp.ScanProcessor(calibration, robot, Stance(posture, robot.legs, (0, 0, -1)))
    for index, on, off in rangefinder.frames(range(70)):
        processor.add(index, on, off)
    terrain = processor.finish()
    (x0, y0), (ny, nx) = terrain.origin, terrain.shape
    heights, _ = world.raster((x0, x0 + nx * 0.005), (y0, y0 + ny * 0.005), 0.001)
    kernel = np.ones((3, 3), np.uint8)
    relief = cv2.dilate(heights, kernel) - cv2.erode(heights, kernel)
    side = 2 * INTERIOR_MARGIN_MM + 1
    flat = cv2.dilate((relief > JUMP_M).astype(np.uint8), np.ones((side, side), np.uint8)) == 0
    seen = flat & _in_sight(world, calibration, heights, (x0, y0))

    def cells(layer: npt.NDArray[np.generic]) -> npt.NDArray[np.generic]:
        return layer.reshape(ny, 5, nx, 5).swapaxes(1, 2).reshape(ny, nx, -1)

    interior = cells(seen).all(axis=-1)
    error = terrain.elevation.astype(np.float64) - cells(heights).mean(axis=-1)
    known = interior & np.isfinite(error)
    return error[known], float(known.sum() / interior.sum())


def _in_sight(
    world: World, calibration: gp.Calibration, heights: Float, origin: tuple[float, float]
) -> npt.NDArray[np.bool_]:
    """Which points of a 1 mm raster camera and laser both see."""
    robot = load_robot("guara")
    relief = Relief.of(world)
    rangefinder = SimulatedRangefinder(world, calibration, robot)
    laser = rangefinder.set_pose(standing()).origin
    camera = (standing() @ calibration.transform_camera_to_base)[:3, 3]
    rows, columns = heights.shape
    x, y = np.meshgrid(origin[0] + (np.arange(columns) + 0.5) / 1e3, origin[1] + (np.arange(rows) + 0.5) / 1e3)
    points = np.dstack((x, y, heights)).astype(np.float32)
    views = [PolarView.around(relief, eye, (-np.pi, np.pi), 4000, 1.0, 0.001) for eye in (camera, laser)]
    return np.logical_and(*(view.sees(points) for view in views))


def physics_figures(
    seed: int, cycles: float = 6, size: tuple[int, int] = (640, 512), imu: float = 0.00175
) -> WalkFigures:
    """Walk over boxes in MuJoCo, scanning at every pause, treading where the planner says."""
    from guara_perception.simulation.physics_walk import physics_walk
    from guara_perception.simulation.walk import WalkNoise

    robot = load_robot("guara")
    world = random_world(seed, length=1.8, boxes=7, rocks=0, pits=0, dark=0, undulation=0.0, box_heights=(0.01, 0.04))
    calibration = specimen(robot, (640, 512), seed=seed)
    walker = _Walker(world, robot, calibration)
    for pause in physics_walk(world, robot, walker.choose, cycles=cycles, seed=seed, noise=WalkNoise(imu=imu)):
        walker.scan(pause)
    return walker.figures


class _Walker:
    """Scans and maps at every pause and plans the footholds on the map."""

    def __init__(self, world: World, robot: RobotModel, calibration: gp.Calibration) -> None:
        self.figures = WalkFigures()
        self._world, self._robot, self._calibration = world, robot, calibration
        self._rangefinder = SimulatedRangefinder(world, calibration, robot)
        self._map, self._odometry = TerrainMap(robot), LegOdometry(robot)
        self._terrain: gp.TerrainGrid | None = None

    def scan(self, pause: WalkPause) -> None:
        """One scan, fused."""
        self._rangefinder.set_pose(pause.transform_base_to_world, pause.joint_positions)
        processor = gp.ScanProcessor(self._calibration, self._robot, pause.stance, "coarse", step=pause.step)
        for index, on, off in self._rangefinder.frames(range(0, 70, 2)):
            processor.add(index, on, off)
        pose = self._odometry.update(pause.stance)
        scan = processor.finish()
        self._terrain = self._map.update(
            processor.finish("wide"), pose.transform_footprint_to_odom, pose.covariance, known_ground=pause.known_ground
        )
        self.figures.grids += 1
        for terrain in (scan, self._terrain):
            unknown = (terrain.hazard & UNKNOWN_MASK) != 0
            self.figures.unsafe += int((unknown & (terrain.traversability > 0)).sum())

    def choose(self, pause: WalkPause) -> tuple[float, float]:
        """The planner's foothold, or the gait's own where it finds none: physics then shows what happens."""
        terrain = self._terrain
        assert terrain is not None
        found = plan_foothold(terrain, pause.next_leg, pause.nominal, robot=self._robot)
        if found is None:
            return pause.nominal
        iy, ix = (int(i) for i in terrain.geometry.indices(found.x, found.y))
        if terrain.looks[iy, ix] == 0:
            self.figures.declared += 1
        elif terrain.clearance[iy, ix] > CLEAR_M:
            # By way of the body: what is compared is the map, not which feet the footprint's z = 0 was taken from.
            to_footprint = np.array(terrain.metadata["transform_base_to_footprint"])
            point = pause.transform_base_to_world @ np.linalg.solve(to_footprint, (found.x, found.y, found.z, 1.0))
            error = float(point[2] - self._world.height(point[0], point[1]))
            (self.figures.front if pause.next_leg.endswith("f") else self.figures.hind).append(error)
        return found.x, found.y


def rms(errors: list[float]) -> float:
    """Root mean square, NaN of nothing."""
    return float(np.sqrt(np.mean(np.square(errors)))) if errors else float("nan")


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--physics", type=int, nargs="*", metavar="SEED", help="also walk in MuJoCo, for these seeds")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    for size, least in (((640, 512), 60), ((1280, 1024), 15)):
        lit, paired, placing = frame_rates(size)
        print(
            f"{size[0]}x{size[1]}: {lit:.0f} frames/s laser on (at least {least}), {paired:.0f} frames/s in pairs, "
            f"{placing:.2f} s to place the robot"
        )
    for name, world in (("flat", World()), ("boxes", BOXES)):
        for size in ((640, 512), (1280, 1024)):
            error, known = height_errors(world, size)
            millimetres = np.abs(error) * 1e3
            print(
                f"{name} {size[0]}x{size[1]}: mean |error| {millimetres.mean():.3f} mm, 95 % "
                f"{np.percentile(millimetres, 95):.3f}, worst {millimetres.max():.2f}, bias {1e3 * error.mean():+.3f}, "
                f"interior cells known {known:.2%}"
            )
    for seed in arguments.physics or ():
        start = time.perf_counter()
        figures = physics_figures(seed)
        print(
            f"physics walk, boxes {seed}: {figures.grids} grids, {figures.unsafe} unknown cells traversable, map error "
            f"under front footholds {1e3 * rms(figures.front):.2f} mm rms ({len(figures.front)}), hind "
            f"{1e3 * rms(figures.hind):.2f} mm rms ({len(figures.hind)}), {figures.declared} on declared ground, "
            f"{time.perf_counter() - start:.0f} s"
        )


if __name__ == "__main__":
    main()
