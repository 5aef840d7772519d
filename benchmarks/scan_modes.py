"""Coarse scans that are refined where there is an obstacle: share of refined pauses, and standing time saved.

`python -m benchmarks walks modes`: each specimen of the rangefinder stands at pauses on an empty floor with 2 mm of
undulation, and before a box. A node's sweeper scans through emulated devices at 30 frames per second; standing time is
that of the devices' clock. Free cells are judged by the truth.
"""

from __future__ import annotations

from collections import Counter

import numpy as np

import guara_perception as gp
from benchmarks.command import Table, options
from benchmarks.usable_ground import UNSAFE, cells
from guara_perception.app.node.simulated import SimulatedRobot
from guara_perception.app.node.sweep import Sweeper, SweepJob
from guara_perception.settings import Settings
from guara_perception.simulation.world import World
from guara_perception.terrain.scan.policy import ScanPolicy
from testbed.random_world import floor
from testbed.true_ground import TrueGround


def main() -> None:
    """Pauses that stay coarse on an empty floor, and that are refined before a box [--specimens, --pauses]."""
    asked = options(
        __doc__, specimens=(10, "rangefinders"), pauses=(2, "pauses of each specimen, on other ground each")
    )
    stood, table = {}, Table("ground:<22 | pauses:d | refined:d | unsafe cells:d | standing s a pause:.2f")
    for name, with_box in (("empty floor", False), ("a box in the corridor", True)):
        refined, unsafe, seconds = 0, 0, list[float]()
        for seed in range(asked.specimens):
            for pause in range(asked.pauses):
                stripes, free, taken = scanned(seed, floor(seed, pause, with_box=with_box))
                refined += stripes > len(range(0, 70, 2))
                unsafe += free
                seconds.append(taken)
        stood[name] = float(np.mean(seconds))
        table.row(name, len(seconds), refined, unsafe, stood[name])
    empty, box = stood.values()
    print(f"an empty floor saves {box - empty:.2f} s of {box:.2f} s, {100 * (1 - empty / box):.0f} %")


def scanned(seed: int, ground: World) -> tuple[int, int, float]:
    """Number of stripes of an adaptive scan, its unsafe cells, and seconds by the devices' clock."""
    robot = SimulatedRobot(world=ground, seed=seed)
    pause = next(robot.walk(cycles=0))
    model, clock = robot.robot, robot.rangefinder.clock
    assert clock is not None
    with robot.rangefinder:
        sweeper = Sweeper(robot.calibration, robot.rangefinder, Settings.of(model), ScanPolicy(model))
        start = clock.monotonic()
        swept = sweeper.sweep(
            "adaptive",
            SweepJob(
                processor=lambda mode: gp.ScanProcessor(robot.calibration, model, pause.stance, mode),
                should_stop=lambda: False,
                publish=lambda _: None,
            ),
        )
        taken = clock.monotonic() - start
    oracle, dark = TrueGround.of(ground).grid(pause.transform_footprint_to_world, swept.terrain.geometry, model)
    counts: Counter[str] = Counter()
    cells(counts, model, swept.terrain, oracle, dark)
    return len(swept.scan.instants), sum(counts[name] for name in UNSAFE), taken
