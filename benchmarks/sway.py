"""A body that sways while it is scanned: heights with a stream of its joints, and without.

`python -m benchmarks.sway [--scans 10] [--rows must guara dim standard clock go2]`. Guará over the demo's ground; each
stripe is rendered from where the body is at its flash. Joints have a bias of 0.2 degrees, new in each scan, and white
noise of 0.05 degrees, new in each sample; the instants of the flashes are off by up to 1 ms. Errors are relative to the
feet at BEGIN, without the tilt that the joints of BEGIN give the whole grid. Without a stream stripes are left out
whose background moved. Rows: `must` and `guara` coarse scans, `dim` the same at 10
of 255 on white, `standard` all 70 stripes, `clock` with all instants of a scan off by up to 20 ms, `go2` that robot.
Some eight seconds for a scan, four in pictures of half the width.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.command import Table, options
from guara_perception.app.demo.sway import swaying_scan
from guara_perception.app.node.simulated import DEMO_WORLD
from guara_perception.arrays import Float
from guara_perception.simulation.light import Light
from guara_perception.simulation.specimen import specimen
from guara_perception.simulation.sway import Sway
from guara_perception.simulation.world import World, load_world
from kinematics import RobotModel
from testbed.misread_joints import load

SIZE = (640, 512)
# [s] By how much all instants of a scan are off together in the rows `clock`, at the most.
CLOCK_ERROR = 0.020
P95_M, KEPT = 0.002, 0.90
STILL = Sway(0.0, 0.0, 1.0)
# The row that must hold: a stream of 200 Hz.
MUST = Sway(math.radians(0.5), 0.005, 1.0)
# The body goes on while its feet stand, as in the support phase of a slow walk.
WALKS = Sway(0.0, 0.0, 1.0, speed=0.020)
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
    (WALKS, 200.0),
    (WALKS, 0.0),
)
# Without a stream: sway at which ground may be lost, but none may be wrong, and at which a tenth may be lost.
LITTLE, LITTLE_KEPT = Sway(math.radians(0.1), 0.001, 1.0), 0.90
# Least share of the cells of a still scan with a stream that one without keeps.
STILL_KEPT = 0.95
# Level [of 255] of the ambient light on white in dim rows.
DIM_LEVEL = 10.0


@dataclass(frozen=True, slots=True)
class Scanned:
    """One scan against the truth.

    Attributes:
        errors: of the heights of known cells [m].
        wrong: number of free cells that are wrong by more than 5 mm.
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
    mode: str = "coarse",
    light: Light | None = None,
    clock_sigma: float = 0.0,
) -> Scanned:
    """Scan once, with a calibration of its own; arguments as in `swaying_scan`."""
    calibration = specimen(robot, size, seed)
    made = swaying_scan(robot, world, calibration, sway, rate, seed, mode=mode, light=light, clock_sigma=clock_sigma)
    # At an edge a cell holds both heights.
    ground: Float = np.asarray(world.height(made.x, made.y))
    beside = [
        np.abs(ground - world.height(made.x + dx, made.y + dy)) for dx in (-0.005, 0.005) for dy in (-0.005, 0.005)
    ]
    known = np.isfinite(made.errors)
    flat = known & (np.max(beside, axis=0) < 0.003)
    free = int((made.terrain.hazard == 0).sum())
    return Scanned(np.abs(made.errors[flat]), made.wrong, int(known.sum()), free)


def figures(scans: Sequence[Scanned], still: Sequence[Scanned]) -> tuple[float, int, float]:
    """p95 of the error [m] (NaN without known cells), wrong free cells, share of the cells of the still scan."""
    errors = np.concatenate([each.errors for each in scans])
    p95 = float(np.percentile(errors, 95)) if errors.size else math.nan
    kept = sum(each.known for each in scans) / max(sum(each.known for each in still), 1)
    return p95, sum(each.wrong for each in scans), kept


@dataclass(frozen=True, slots=True)
class Block:
    """Rows of the table that share robot, light, pattern and clock.

    Attributes:
        robot: name.
        cases: sway and samples a second, the first one still.
        mode: pattern of the stripes.
        is_dim: whether the ambient light is `DIM_LEVEL`.
        clock_sigma: of an error that all instants share [s].
    """

    robot: str = "guara"
    cases: tuple[tuple[Sway, float], ...] = CASES
    mode: str = "coarse"
    is_dim: bool = False
    clock_sigma: float = 0.0

    def print(self, table: Table, name: str, seeds: range, size: tuple[int, int]) -> list[str]:
        """Print the rows; return those that fall short of what must hold."""
        robot, world = load(self.robot), load_world(DEMO_WORLD)
        light = replace(world.light, ambient=(DIM_LEVEL,) * 3) if self.is_dim else None
        still: list[Scanned] = []
        short = []
        for sway, rate in self.cases:
            made = [
                scan(robot, world, sway, rate, seed, size, mode=self.mode, light=light, clock_sigma=self.clock_sigma)
                for seed in seeds
            ]
            still = still or made
            p95, wrong, kept = figures(made, still)
            motion = f"{math.degrees(sway.turn):.1f}, {1e3 * sway.shift:.0f}, {sway.frequency:.1f}"
            motion = f"{1e3 * sway.speed:.0f} mm/s along x" if sway.speed else motion
            table.row(name, motion, rate or "-", len(seeds), 1e3 * p95, wrong, kept)
            least = {(MUST, 200.0): KEPT, (STILL, 0.0): STILL_KEPT}.get((sway, rate), 0.0)
            if (sway, rate) == (LITTLE, 0.0) and not self.is_dim:
                least = LITTLE_KEPT
            is_held = (sway, rate) == (MUST, 200.0) or not rate
            if is_held and (wrong > 0 or kept < least or (rate and p95 > P95_M)):
                short.append(f"{name}: {motion} at {rate:g} Hz")
        return short


FEW: tuple[tuple[Sway, float], ...] = ((STILL, 0.0), (MUST, 200.0), (MUST, 0.0), (WALKS, 200.0))
BLOCKS = {
    "must": Block(cases=FEW),
    "guara": Block(),
    "dim": Block(is_dim=True, cases=((STILL, 200.0), *(case for case in CASES if not case[1]), (MUST, 200.0))),
    "standard": Block(mode="standard", cases=FEW),
    "clock": Block(clock_sigma=CLOCK_ERROR / math.sqrt(3.0), cases=FEW[:2]),
    "go2": Block("go2", cases=FEW),
}


def main() -> None:
    """Print the table; exit 1 when a row that must hold falls short."""
    asked = options(
        __doc__,
        scans=(10, "scans of a row"),
        first=(0, "seed of the first scan"),
        rows=(list(BLOCKS)[1:], "blocks of rows: " + ", ".join(BLOCKS)),
        width=(SIZE[0], "columns of a picture [px]"),
    )
    table = Table(
        "rows:<8 | sway [deg, mm, Hz]:<20 | stream [Hz]:11 | scans:d | p95 [mm]:10.2f | free cells wrong:d | "
        "cells kept:.1%"
    )
    size = asked.width, round(asked.width * SIZE[1] / SIZE[0])
    seeds = range(asked.first, asked.first + asked.scans)
    short = [each for name in asked.rows for each in BLOCKS[name].print(table, name, seeds, size)]
    print(f"rows that must hold: {'all hold' if not short else 'SHORT: ' + '; '.join(short)}")
    raise SystemExit(1 if short else 0)


if __name__ == "__main__":
    main()
