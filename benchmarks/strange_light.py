"""Foreign light and frames of another instant: wrong free cells, and health of the grid.

`python -m benchmarks strange_light [--scans NAME ...]`: three recorded scans and a simulated one, each taken again by
the real driver with one fault at a time. Unsafe cells are free although they are dark, unseen, a hole or a drop;
wrong cells are free and more than 5 mm off their true heights. It takes a few minutes of processor time. `--clean 5`
compares clean scans instead, five of each with dark flashes and five with plain laser-off frames alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any
from unittest.mock import patch

import numpy as np

from benchmarks.command import Table, options
from drivers.emulator import ExposureView
from guara_perception.app.node import rangefinder
from guara_perception.arrays import Image
from testbed.grid_truth import figures, made_up
from testbed.scenes import FLOOR, OWN_DATA, ScanInMemory, recorded, simulated
from testbed.strange_cases import cases, measure
from testbed.strange_light import Fault, Scene, take
from testbed.two_robots import FacingRobots

RECORDED = ("paper", "dark", "tilt")
SIMULATED, RECORDINGS = "floor", OWN_DATA / "scans"
SIZE, SMALL = (640, 512), (320, 256)
# What dark flashes may cost a clean scan: known cells [%], and time [%] or frames, whichever is more.
MOST_LOST, MOST_TIME, MOST_FRAMES = 0.5, 6.0, 4


def scenes(names: list[str]) -> Iterator[Scene]:
    """The scans, by name."""
    for name in names:
        is_own = name == SIMULATED
        yield Scene(simulated(SIZE, 70, world=FLOOR, is_uncertain=False) if is_own else recorded(RECORDINGS / name))


def facing_robots(pauses: int, size: tuple[int, int] = SMALL, seed: int = 0) -> str:
    """Figures of two robots that face each other and scan the same floor, over a number of pauses of both."""
    robots, rng = FacingRobots(FLOOR, size, seed), np.random.default_rng(seed)
    truth = robots.scene.scan.truth
    assert truth is not None
    grids = unsafe = wrong = sweeps = 0
    for _ in range(pauses):
        for outcome in robots.pause(float(rng.uniform(0, 1.0))):
            terrain = outcome.processor.finish()
            unsafe += figures(terrain, truth).unsafe
            wrong += made_up(terrain, truth)
            grids += not outcome.processor.refused
            sweeps += outcome.sweeps
    return (
        f"{pauses} pauses of two robots: {grids} of {2 * pauses} give a grid after {sweeps} sweeps, "
        f"{unsafe} free cells unsafe, {wrong} wrong by more than 5 mm"
    )


@dataclass(frozen=True, slots=True)
class Cost:
    """Mean cost of dark flashes in clean scans, against plain laser-off frames alone.

    Attributes:
        lost: known cells that are lost [%], negative if there are more.
        most_lost: the same of the worst pair of scans.
        time: longer standing time, from the first exposure to the last [%].
        frames: further frames.
    """

    lost: float
    most_lost: float
    time: float
    frames: float

    @property
    def is_met(self) -> bool:
        """True if the cost is no more than allowed."""
        return self.lost <= MOST_LOST and (self.time <= MOST_TIME or self.frames <= MOST_FRAMES)


class CleanScene(Scene):
    """A scene that counts its exposures, and draws new noise for every scan.

    Attributes:
        starts: start of each exposure of the last scan, by the emulated clock [s].
    """

    def begin(self) -> None:
        """Draw new noise."""
        super().begin()
        self._rng, self.starts = np.random.default_rng(), list[float]()

    def picture(self, view: ExposureView, *light: Any) -> Image:
        """The picture of an exposure."""
        self.starts.append(view.start)
        return super().picture(view, *light)

    def scanned(self, *, triggered: bool, has_code: bool) -> tuple[float, float, int]:
        """Known cells, standing time [s] and frames of one scan."""
        with ExitStack() as stack:
            if not has_code:
                stack.enter_context(patch.object(rangefinder, "draw_code", lambda _: frozenset()))
            processor, _ = take(self, Fault("clean"), triggered=triggered)
        known = float(np.isfinite(processor.finish().elevation).sum())
        return known, self.starts[-1] - self.starts[0], len(self.starts)


def clean_cost(scan: ScanInMemory, *, triggered: bool, pairs: int) -> Cost:
    """Cost of dark flashes in some pairs of clean scans, each with noise and code of its own."""
    scene = CleanScene(scan)
    before, after = (
        np.array([scene.scanned(triggered=triggered, has_code=has_code) for _ in range(pairs)])
        for has_code in (False, True)
    )
    lost, time, _ = 100 * (after / before - 1).T * [[-1], [1], [1]]
    return Cost(float(lost.mean()), float(lost.max()), float(time.mean()), float((after - before)[:, 2].mean()))


def print_clean(names: list[str], pairs: int) -> None:
    """Table of the cost of dark flashes in clean scans."""
    print(f"must: cells lost at most {MOST_LOST:g} %; time at most {MOST_TIME:g} %, or {MOST_FRAMES} frames more")
    table = Table(
        "scan:<10 | devices:<10 | cells lost %:.2f | worst %:.2f | time more %:.1f | frames more:.1f | must:<"
    )
    for name, scene in zip(names, scenes(names), strict=True):
        for devices in ("triggered", "stepwise"):
            cost = clean_cost(scene.scan, triggered=devices == "triggered", pairs=pairs)
            met = "met" if cost.is_met else "missed"
            table.row(name, devices, cost.lost, cost.most_lost, cost.time, cost.frames, met)


def main() -> None:
    """Command line."""
    asked = options(
        __doc__,
        scans=([*RECORDED, SIMULATED], "names of scans"),
        robots=(0, "this many pauses of two robots on one floor instead"),
        clean=(0, "this many clean scans with dark flashes and without instead"),
    )
    if asked.robots:
        print(facing_robots(asked.robots))
        return
    if asked.clean:
        print_clean(asked.scans, asked.clean)
        return
    table = Table("scan:<10 | devices:<10 | fault:<52 | free:6 | unsafe:6 | wrong:6 | known %:.1f | health:<")
    for name, scene in zip(asked.scans, scenes(asked.scans), strict=True):
        for case in cases(scene):
            found = measure(scene, case)
            how, fault = "triggered" if case.triggered else "stepwise", f"{case.group}: {case.fault.name}"
            table.row(name, how, fault, found.free, found.unsafe, found.wrong, found.known, found.health)


if __name__ == "__main__":
    main()
