"""Prints the figures of the terrain: times, accuracy on analytic ground, and a fused walk over mixed terrain."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

import guara_perception as gp
from guara_perception.arrays import Float
from guara_perception.settings import Settings
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK, Hazard
from guara_perception.terrain.map.fuse_heights import OdometryDrift, forget_heights, fuse_heights
from guara_perception.terrain.map.look import look_at
from guara_perception.terrain.map.odom_cells import OdomCells
from guara_perception.terrain.map.registration import register
from kinematics import LegOdometry, RobotModel, load_robot
from testbed.analytic_walk import Ground, Pause, scan, seen_height, walk
from testbed.truth import truth_calibration

RESOLUTION = 0.005
# A hind foot reaches ground that was scanned before the walk began only after this number of pauses.
FIRST_HIND_PAUSE = 24
FOOT_HALF = (0.035, 0.025)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=5, help="walks, seeds 0 ... N - 1")
    parser.add_argument("--cycles", type=int, default=10)
    parser.add_argument("--empty", type=Path, help="data folder with scans/empty, for the share of free cells")
    arguments = parser.parse_args()
    robot = load_robot("guara")
    times(robot)
    accuracy()
    empty_area(robot, arguments.empty)
    walks(robot, arguments.seeds, arguments.cycles)


def times(robot: RobotModel) -> None:
    """Best of several runs: the machine is shared."""
    print("times, best of runs")
    limits = Settings.of(robot).limits
    rng = np.random.default_rng(0)
    pause = next(walk(robot, Ground.random(0), 1, 0))
    terrain = scan(robot, Ground.random(0), pause, 0)
    cells = OdomCells(RESOLUTION, 1.3)
    cells.centre_on(0.0, 0.0)
    drift = OdometryDrift(0.0, 0.0, 0.0)
    transform = np.eye(4)
    turned = np.eye(4)
    turned[:2, :2] = [[np.cos(0.1), -np.sin(0.1)], [np.sin(0.1), np.cos(0.1)]]

    def fuse(matrix: Float) -> None:
        look = look_at(cells, terrain, matrix)
        fuse_heights(cells, look.heights, drift, look.distance, 0, 0)
        forget_heights(cells, look.empty, look.empty_cause)

    print(f"  fuse one scan, 108 x 90 cells           {1e3 * best(lambda: fuse(transform), 30):7.2f} ms   (3)")
    print(f"  the same, turned by 6 degrees           {1e3 * best(lambda: fuse(turned), 30):7.2f} ms   (3)")
    prior = np.diag([0.002**2, 0.002**2, 0.003**2, 1e-6, 1e-6, 0.004**2])
    laid = best(lambda: register(cells, terrain, transform, prior), 20, clock=time.process_time)
    print(f"  lay it onto the map, processor time     {1e3 * laid:7.2f} ms")
    for shape, runs in (((108, 90), 30), ((140, 320), 20), ((500, 500), 8), ((1000, 1000), 4), ((2000, 2000), 2)):
        heights = rng.normal(0, 0.0003, shape)
        heights[rng.random(shape) < 0.001] = np.nan
        variance = np.full(shape, 1e-7)
        seconds = best(partial(gp.assess_terrain, heights, RESOLUTION, variance=variance, limits=limits), runs)
        note = "   (4)" if shape == (108, 90) else ""
        print(
            f"  all layers, {shape[0]:4d} x {shape[1]:4d} cells          {1e3 * seconds:7.2f} ms{note}"
            f"   {1e9 * seconds / (shape[0] * shape[1]):5.0f} ns per cell"
        )
    x, y = rng.uniform(0.45, 1.0, 1000), rng.uniform(-0.3, 0.3, 1000)
    check = best(lambda: terrain.check_foothold(x, y), 20)
    leg = best(lambda: terrain.check_foothold(x, y, leg="lf", robot=robot), 5)
    choose = best(lambda: terrain.best_foothold(0.7, 0.1, 0.08), 10)
    print(f"  check_foothold, 1000 positions          {1e3 * check:7.2f} ms   (5)")
    print(f"  the same with reach of a leg            {1e3 * leg:7.2f} ms")
    print(f"  best_foothold, radius 0.08 m            {1e3 * choose:7.2f} ms")
    print(f"  obstacles                               {1e3 * best(terrain.obstacles, 5):7.2f} ms")


def best(run: Callable[[], object], runs: int, clock: Callable[[], float] = time.perf_counter) -> float:
    """Shortest time of a call by a clock [s]."""
    seconds = []
    for _ in range(runs):
        start = clock()
        run()
        seconds.append(clock() - start)
    return min(seconds)


def accuracy() -> None:
    """Analytic ground: ramps, stairs, and noise of known deviation."""
    y, x = (np.mgrid[:200, :200] + 0.5) * RESOLUTION
    worst_slope = worst_step = 0.0
    for degrees in (0, 2, 5, 10, 15, 20, 30, 45):
        for heading in (0.0, 0.3, 0.785, 1.2):
            tangent = np.tan(np.radians(degrees))
            terrain = gp.assess_terrain(tangent * (np.cos(heading) * x + np.sin(heading) * y), RESOLUTION)
            error = np.degrees(terrain.slope[5:-5, 5:-5]) - degrees
            worst_slope = max(worst_slope, float(np.abs(error).max()))
    for height in (0.005, 0.010, 0.020, 0.040, 0.080):
        stairs = height * np.floor(x / 0.1)
        terrain = gp.assess_terrain(stairs, RESOLUTION)
        beside = terrain.step_height[5:-5, 18]
        worst_step = max(worst_step, float(np.abs(beside - height).max()))
    rng = np.random.default_rng(0)
    shares = []
    for sigma in (0.001, 0.002, 0.004):
        terrain = gp.assess_terrain(0.2 * x + rng.normal(0, sigma, x.shape), RESOLUTION)
        # The plane takes 3 of the disc's n degrees of freedom, and the definition divides by n - 1.
        n = 29
        expected = sigma * np.cos(np.arctan(0.2)) * np.sqrt((n - 3) / (n - 1))
        rms = float(np.sqrt(np.mean(terrain.roughness[5:-5, 5:-5].astype(np.float64) ** 2)))
        shares.append(abs(rms / expected - 1))
    print("accuracy on analytic ground, worst")
    print(f"  slope      {worst_slope:8.5f} degrees (0.1)")
    print(f"  step       {1e3 * worst_step:8.5f} mm      (1)")
    print(f"  roughness  {100 * max(shares):8.3f} %       (2)")


def empty_area(robot: RobotModel, data: Path | None) -> None:
    """Share of the cells over 60 mm inside the border that are traversable where nothing stands."""
    settings = Settings.of(robot)
    grids = {"analytic": gp.assess_terrain(np.zeros((108, 90)), RESOLUTION)}
    if data is not None:
        folder = data / "scans" / "empty"
        grids["recorded"] = gp.process_scan(gp.open_scan(folder), truth_calibration(data), robot, pictures=False)
    print("empty area, cells over 60 mm inside the border")
    for name, terrain in grids.items():
        depth = [(np.minimum(np.arange(n), n - 1 - np.arange(n)) + 0.5) * settings.resolution for n in terrain.shape]
        deep = (depth[0][:, None] > 0.060) & (depth[1][None, :] > 0.060)
        print(f"  {name:<9} {100 * float((terrain.traversability[deep] > 0).mean()):6.2f} % traversable (80)")


def walks(robot: RobotModel, seeds: int, cycles: int) -> None:
    """Fused walks: what the map says of the hind feet's next footholds, against the truth."""
    print(f"walks of {cycles} cycles over mixed ground, gravity known, joints 0.2 degrees, contact 1 mm")
    print(
        "  seed  foothold rms  bias  claimed  sole rms  without anchor  occluded after 0, 4, 8, 12 pauses"
        "  unknown free  dark free"
    )
    figures, claims = [], []
    for seed in range(seeds):
        result = one_walk(robot, seed, cycles)
        figures.append(result.rms)
        claims.append(result.claimed)
        shares = " ".join(f"{100 * share:5.2f}" for share in result.occluded)
        print(
            f"  {seed:4d}  {result.rms:9.2f} mm {result.bias:+6.2f}  {result.claimed:6.2f}"
            f"  {result.sole:7.2f}  {result.raw:11.2f} mm   {shares} %"
            f"               {result.unknown:9d}  {result.dark:9d}",
            flush=True,
        )
    print(f"  median of seeds: {np.median(figures):.2f} mm rms (3), claimed sigma {np.median(claims):.2f} mm")


@dataclass(frozen=True)
class WalkFigures:
    """The result of one walk; millimetres, shares and counts."""

    rms: float
    bias: float
    claimed: float
    sole: float
    raw: float
    occluded: list[float]
    unknown: int
    dark: int


def one_walk(robot: RobotModel, seed: int, cycles: int) -> WalkFigures:
    """The figures of one seed, in millimetres."""
    ground = Ground.random(seed)
    terrain_map, odometry = gp.TerrainMap(robot), LegOdometry(robot)
    errors: list[Float] = []
    sigmas: list[Float] = []
    soles: list[float] = []
    raw: list[float] = []
    watched: dict[int, tuple[Float, list[float]]] = {}
    unknown = dark = 0
    start = None
    for pause in walk(robot, ground, cycles, seed):
        terrain = scan(robot, ground, pause, seed)
        pose = odometry.update(pause.stance)
        fused = terrain_map.update(
            terrain,
            pose.transform_footprint_to_odom,
            pose.covariance,
            covariance_since_last=pose.covariance_since_last,
            own_covariance=pose.own_covariance,
        )
        to_footprint = np.array(terrain.metadata["transform_base_to_footprint"])
        from_world = to_footprint @ np.linalg.inv(pause.transform_base_to_world)
        height = float(np.linalg.inv(from_world)[2, 3])
        start = height if start is None else start
        raw.append(1e3 * (float(pose.transform_footprint_to_odom[2, 3]) - (height - start)))
        soles += [1e3 * r for r in fused.metadata["support_residuals"].values() if r is not None]
        unknown += int((((fused.hazard & UNKNOWN_MASK) != 0) & (fused.traversability > 0)).sum())
        dark += free_in_the_dark(ground, fused, from_world)
        if pause.step >= FIRST_HIND_PAUSE:
            error, sigma = foothold_errors(ground, pause, fused, from_world)
            errors.append(error)
            sigmas.append(sigma)
        watch_occluded(watched, pause.step, terrain, fused, np.array(fused.metadata["transform_footprint_to_odom"]))
    every, claimed = 1e3 * np.concatenate(errors), 1e3 * np.concatenate(sigmas)
    seen = [shares for _, shares in watched.values() if len(shares) > 12]
    occluded = [float(np.mean([shares[i] for shares in seen])) for i in (0, 4, 8, 12)]
    return WalkFigures(
        rms=float(np.sqrt(np.mean(every**2))),
        bias=float(every.mean()),
        claimed=float(np.sqrt(np.mean(claimed**2))),
        sole=float(np.sqrt(np.mean(np.square(soles)))),
        raw=float(np.sqrt(np.mean(np.square(raw)))),
        occluded=occluded,
        unknown=unknown,
        dark=dark,
    )


def foothold_errors(ground: Ground, pause: Pause, fused: gp.TerrainGrid, from_world: Float) -> tuple[Float, Float]:
    """Map minus truth under the next footholds of both hind legs [m], and the sigma that the map claims."""
    errors, sigmas = [], []
    for leg in ("lh", "rh"):
        foothold = from_world[:3, :3] @ pause.next_footholds[leg] + from_world[:3, 3]
        dx, dy = (a.ravel() for a in np.meshgrid(*(np.linspace(-half, half, 8) for half in FOOT_HALF)))
        x, y = foothold[0] + dx, foothold[1] + dy
        height = np.asarray(fused.height_at(x, y), dtype=np.float64)
        truth, _ = seen_height(ground, inverse(from_world), x, y)
        iy, ix = fused.geometry.indices(x, y)
        known = np.isfinite(height)
        errors.append((height - truth)[known])
        sigmas.append(np.sqrt(fused.variance[iy[known], ix[known]].astype(np.float64)))
    return np.concatenate(errors), np.concatenate(sigmas)


def inverse(transform: Float) -> Float:
    """The inverse of a transform (4, 4)."""
    return np.asarray(np.linalg.inv(transform), dtype=np.float64)


def free_in_the_dark(ground: Ground, fused: gp.TerrainGrid, from_world: Float) -> int:
    """Traversable cells whose ground returns no light: nobody can have seen them."""
    x, y = (a.ravel() for a in np.meshgrid(*fused.geometry.centres()))
    free = (fused.traversability > 0).ravel()
    _, world = seen_height(ground, inverse(from_world), x[free], y[free])
    return int(ground.is_dark(world[:, 0], world[:, 1]).sum())


def watch_occluded(
    watched: dict[int, tuple[Float, list[float]]],
    step: int,
    terrain: gp.TerrainGrid,
    fused: gp.TerrainGrid,
    pose: Float,
) -> None:
    """Follow the cells that each scan found OCCLUDED: which share of its area is still hidden in the map later."""
    iy, ix = np.nonzero((terrain.hazard & np.uint16(Hazard.OCCLUDED)) != 0)
    x, y = terrain.geometry.centres()
    points = np.column_stack((x[ix], y[iy])) @ pose[:2, :2].T + pose[:2, 3]
    watched[step] = (points, [])
    for points, shares in watched.values():
        local = (points - pose[:2, 3]) @ pose[:2, :2]
        hidden = (np.asarray(fused.hazard_at(local[:, 0], local[:, 1])) & np.uint16(Hazard.OCCLUDED)) != 0
        shares.append(float(hidden.sum()) / terrain.geometry.size)


if __name__ == "__main__":
    main()
