"""A body that sways while it is scanned: heights with a stream of its joints, and without.

`python -m benchmarks.sway [--scans 10]`. Guará over the demo's ground; each stripe is rendered from where the body is
at its flash. Joints have a bias of 0.2 degrees, new in each scan, and white noise of 0.05 degrees, new in each sample;
the instants of the flashes are off by up to 1 ms. Errors are relative to the feet at BEGIN, without the tilt that the
joints of BEGIN give the whole grid. Without a stream stripes are left out whose background moved, in dim light as far
as it is seen. Some eight seconds for a scan.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

import guara_perception as gp
from benchmarks.command import Table, options
from guara_perception.app.node.simulated import DEMO_WORLD
from guara_perception.arrays import Float
from guara_perception.simulation.light import Light
from guara_perception.simulation.rangefinder import SimulatedRangefinder
from guara_perception.simulation.specimen import specimen
from guara_perception.simulation.world import World, load_world
from guara_perception.stripes.band import FramePair
from kinematics import BodyTrack, RobotModel, Stance, load_robot
from testbed.swaying_robot import Sway, stream_of

SIZE = (640, 512)
# [s] From one stripe to the next of a stepped coarse scan, and by how much an instant is off at the most.
STRIPE_PERIOD, INSTANT_ERROR = 0.035, 0.001
# [s] Stream before the first flash and after the last.
AROUND = 0.3
WRONG_M, P95_M, KEPT = 0.005, 0.002, 0.90
STILL = Sway(0.0, 0.0, 1.0)
# The row that must hold: a stream of 200 Hz.
MUST = Sway(math.radians(0.5), 0.005, 1.0)
CASES: tuple[tuple[Sway, float], ...] = (
    (STILL, 0.0),
    (STILL, 200.0),
    (MUST, 50.0),
    (MUST, 200.0),
    (MUST, 1000.0),
    (MUST, 0.0),
    (Sway(math.radians(0.1), 0.001, 1.0), 200.0),
    (Sway(math.radians(0.1), 0.001, 1.0), 0.0),
    (Sway(math.radians(0.5), 0.010, 0.3), 200.0),
    (Sway(math.radians(0.5), 0.005, 2.0), 200.0),
    (Sway(math.radians(1.0), 0.010, 1.0), 200.0),
    (Sway(math.radians(1.0), 0.010, 1.0), 0.0),
)
# Without a stream: sway at which ground may be lost, but none may be wrong, and at which a tenth may be lost.
LITTLE, LITTLE_KEPT = Sway(math.radians(0.1), 0.001, 1.0), 0.90
# Level [of 255] of the ambient light on white in dim rows.
DIM_LEVEL = 10.0


@dataclass(frozen=True, slots=True)
class Scanned:
    """One scan against the truth.

    Attributes:
        errors: of the heights of known cells [m].
        wrong: number of free cells that are wrong by more than WRONG_M.
        known, free: number of cells.
    """

    errors: Float
    wrong: int
    known: int
    free: int


def scan(
    robot: RobotModel,
    world: World,
    sway: Sway,
    rate: float,
    seed: int,
    size: tuple[int, int] = SIZE,
    *,
    light: Light | None = None,
) -> Scanned:
    """Scan once, with a stream of `rate` samples a second, or without one at 0; in the world's light or another."""
    rng = np.random.default_rng(seed)
    calibration = specimen(robot, size, seed)
    view = SimulatedRangefinder(world, calibration, robot, seed, light=light)
    posture = robot.posture("scan")
    standing = robot.stance_pose(Stance(posture, robot.legs, None)).transform_base_to_footprint
    phase = rng.uniform(0.0, 1.0 / sway.frequency)
    indices = range(0, len(calibration.stripes), 2)
    times = np.arange(-AROUND, len(indices) * STRIPE_PERIOD + AROUND, 1.0 / (rate or 50.0))
    readings, stance = stream_of(robot, sway, times + phase, rng, begin=phase)
    track = None
    if rate:
        track = BodyTrack(robot, stance, transform_camera_to_base=calibration.transform_camera_to_base)
        track.add(times, readings, np.ones((len(times), len(robot.legs)), dtype=bool))
    processor = gp.ScanProcessor(calibration, robot, stance, "coarse", track=track)
    for number, index in enumerate(indices):
        time = (number + 0.5) * STRIPE_PERIOD
        view.set_pose(standing @ sway.at(phase + time))
        on = view.frame(mirror_angle=calibration.stripe(index).mirror_angle)
        told = time + rng.uniform(-INSTANT_ERROR, INSTANT_ERROR)
        processor.add_all([FramePair(index, on, view.frame(laser=0.0), instant=told)])
    grid = processor.finish()
    # Where the ground of the grid is, if the body stood at BEGIN where it did.
    to_world = standing @ sway.at(phase) @ np.linalg.inv(processor.pose.transform_base_to_footprint)
    x, y = np.meshgrid(*grid.geometry.centres())
    points = np.stack((x, y, grid.elevation), axis=-1) @ to_world[:3, :3].T + to_world[:3, 3]
    across, along = (np.asarray(points[..., axis], np.float64) for axis in (0, 1))
    error = np.asarray(points[..., 2], np.float64) - world.height(across, along)
    # At an edge a cell holds both heights.
    ground: Float = np.asarray(world.height(across, along))
    beside = [
        np.abs(ground - world.height(across + dx, along + dy)) for dx in (-0.005, 0.005) for dy in (-0.005, 0.005)
    ]
    known = np.isfinite(grid.elevation)
    flat = known & (np.max(beside, axis=0) < 0.003)
    free = grid.hazard == 0
    wrong = int((free & (np.abs(error) > WRONG_M)).sum())
    return Scanned(np.abs(error[flat]), wrong, int(known.sum()), int(free.sum()))


def figures(scans: Sequence[Scanned], still: Sequence[Scanned]) -> tuple[float, int, float]:
    """p95 of the error [m], wrong free cells in all scans, share of the cells that are known of the still scan."""
    p95 = float(np.percentile(np.concatenate([each.errors for each in scans]), 95))
    kept = sum(each.known for each in scans) / max(sum(each.known for each in still), 1)
    return p95, sum(each.wrong for each in scans), kept


def main() -> None:
    """Print the table; exit 1 when a row that must hold falls short."""
    asked = options(__doc__, scans=(10, "scans of a row"))
    robot, world = load_robot("guara"), load_world(DEMO_WORLD)
    table = Table(
        "light:<5 | sway [deg, mm, Hz]:<20 | stream [Hz]:11 | p95 [mm]:10.2f | free cells wrong:d | cells kept:.1%"
    )
    dim = replace(world.light, ambient=(DIM_LEVEL,) * 3)
    short: list[str] = []
    for light, cases in (("plain", CASES), ("dim", [(sway, rate) for sway, rate in CASES if not rate])):
        still: list[Scanned] = []
        for sway, rate in cases:
            given = dim if light == "dim" else None
            scans = [scan(robot, world, sway, rate, seed, light=given) for seed in range(asked.scans)]
            still = still or scans
            p95, wrong, kept = figures(scans, still)
            name = f"{math.degrees(sway.turn):.1f}, {1e3 * sway.shift:.0f}, {sway.frequency:.1f}"
            table.row(light, name, rate or "-", 1e3 * p95, wrong, kept)
            least = {(MUST, 200.0): KEPT, (LITTLE, 0.0): LITTLE_KEPT}.get((sway, rate), 0.0)
            is_held = (sway, rate) == (MUST, 200.0) or (light == "plain" and not rate)
            if is_held and (wrong > 0 or kept < least or (rate and p95 > P95_M)):
                short.append(f"{name} at {rate:g} Hz")
    print(f"rows that must hold: {'all hold' if not short else 'SHORT: ' + '; '.join(short)}")
    raise SystemExit(1 if short else 0)


if __name__ == "__main__":
    main()
