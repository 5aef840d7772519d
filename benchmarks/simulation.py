"""Prints figures of the simulation: frames per second, errors of height after the whole pipeline, a physics walk."""

from __future__ import annotations

import argparse
import time

import cv2
import numpy as np
import numpy.typing as npt

import guara_perception as gp
from guara_perception.arrays import Float
from guara_perception.simulation import SimulatedRangefinder, World, specimen
from guara_perception.simulation.features import Box
from guara_perception.simulation.relief import PolarView, Relief
from kinematics import Stance, load_robot
from testbed.grid_truth import INTERIOR_MARGIN_MM, JUMP_M
from testbed.physics.physics_figures import physics_figures, rms

BOXES = World(
    features=(
        Box(x=0.62, y=0.12, size=(0.08, 0.08), height=0.04, yaw=0.2, material="concrete"),
        Box(x=0.75, y=-0.10, size=(0.10, 0.08), height=0.08, yaw=0.1, material="brick"),
        Box(x=0.80, y=0.15, size=(0.10, 0.08), height=0.05),
        Box(x=0.60, y=-0.15, size=(0.08, 0.08), height=0.02),
        Box(x=0.88, y=0.02, size=(0.06, 0.06), height=0.03, material="concrete"),
    )
)


def standing(height: float = 0.36) -> Float:
    """Pose of a level body above the origin."""
    transform = np.eye(4)
    transform[2, 3] = height
    return transform


def frame_rates(size: tuple[int, int]) -> tuple[float, float, float]:
    """Frames per second with the laser on, frames per second in on/off pairs, and seconds that `set_pose` takes."""
    robot = load_robot("guara")
    calibration = specimen(robot, size, seed=1)
    rangefinder = SimulatedRangefinder(BOXES, calibration, robot)
    rangefinder.set_pose(standing(), robot.posture("scan"))
    start = time.perf_counter()
    rangefinder.set_pose(standing(), robot.posture("scan"))
    posed = time.perf_counter()
    for stripe in calibration.stripes:
        rangefinder.frame(mirror_angle=stripe.mirror_angle)
    lit = time.perf_counter()
    pairs = list(rangefinder.frames(calibration.indices))
    end = time.perf_counter()
    count = len(calibration.stripes)
    return count / (lit - posed), 2 * len(pairs) / (end - lit), posed - start


def height_errors(world: World, size: tuple[int, int]) -> tuple[Float, float]:
    """Errors of the known interior cells of one standard scan [m], and their share of all interior cells."""
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
    """Which points of a raster of 1 mm are seen by both camera and laser."""
    robot = load_robot("guara")
    relief = Relief.of(world)
    rangefinder = SimulatedRangefinder(world, calibration, robot)
    laser = rangefinder.set_pose(standing()).origin
    camera = (standing() @ calibration.transform_camera_to_base)[:3, 3]
    rows, columns = heights.shape
    x, y = np.meshgrid(origin[0] + (np.arange(columns) + 0.5) / 1e3, origin[1] + (np.arange(rows) + 0.5) / 1e3)
    points = np.dstack((x, y, heights)).astype(np.float32)
    views = [PolarView.around(relief, viewpoint, (-np.pi, np.pi), 4000, 1.0, 0.001) for viewpoint in (camera, laser)]
    return np.logical_and(*(view.sees(points) for view in views))


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--physics", type=int, nargs="*", metavar="SEED", help="also walk in MuJoCo, for these seeds")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    for size, least in (((640, 512), 60), ((1280, 1024), 15)):
        lit, paired, posing = frame_rates(size)
        print(
            f"{size[0]}x{size[1]}: {lit:.0f} frames/s laser on (at least {least}), {paired:.0f} frames/s in pairs, "
            f"{posing:.2f} s for a new pose"
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
