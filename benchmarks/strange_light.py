"""Light that is not ours and frames of another instant: free cells that are wrong, and the health of the grid.

`python -m benchmarks strange_light [--scans NAME ...]`: three recorded scans and a simulated one, each taken again by
the real driver with one fault at a time. Unsafe cells are free, and truth calls them dark, unseen, a hole or a drop;
wrong ones are free and off their true heights by more than 5 mm. It takes some minutes of processor time.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from benchmarks.command import Table, options
from guara_perception.simulation import World
from guara_perception.simulation.features import Box, Patch, Pit
from testbed.grid_truth import made_up
from testbed.scenes import OWN_DATA, recorded, simulated
from testbed.strange_cases import cases, measure
from testbed.strange_light import Scene
from testbed.two_robots import FacingRobots

RECORDED = ("paper", "dark", "tilt")
SIMULATED = "floor"
# A floor with most of what a foot must not stand on.
FLOOR = World(
    features=(
        Box(x=0.60, y=0.16, size=(0.06, 0.08), height=0.020, material="concrete"),
        Box(x=0.86, y=-0.19, size=(0.06, 0.08), height=0.080, material="concrete"),
        Pit(x=0.62, y=-0.15, size=(0.06, 0.08), depth=0.060),
        Patch(x=0.72, y=0.0, size=(0.08, 0.08), material="dark"),
    ),
)
SIZE, SMALL = (640, 512), (320, 256)


def scenes(names: list[str]) -> Iterator[Scene]:
    """The scans, by name."""
    for name in names:
        scan = (
            simulated(SIZE, 70, world=FLOOR, is_uncertain=False)
            if name == SIMULATED
            else recorded(OWN_DATA / "scans" / name)
        )
        yield Scene(scan)


def facing_robots(pauses: int, size: tuple[int, int] = SMALL, seed: int = 0) -> str:
    """Figures of two robots that face each other and scan the same floor, over a number of pauses of both."""
    robots, rng = FacingRobots(FLOOR, size, seed), np.random.default_rng(seed)
    truth = robots.scene.scan.truth
    assert truth is not None
    grids = unsafe = wrong = sweeps = 0
    for _ in range(pauses):
        for outcome in robots.pause(float(rng.uniform(0, 1.0))):
            terrain = outcome.processor.finish()
            free = np.asarray(terrain.traversability) > 0
            unsafe += int((free & (truth.unseen | truth.dark)).sum())
            wrong += made_up(terrain, truth)
            grids += not outcome.processor.refused
            sweeps += outcome.sweeps
    return (
        f"{pauses} pauses of two robots: {grids} of {2 * pauses} give a grid after {sweeps} sweeps, "
        f"{unsafe} free cells unsafe, {wrong} wrong by more than 5 mm"
    )


def main() -> None:
    """Command line."""
    asked = options(
        __doc__,
        scans=([*RECORDED, SIMULATED], "names of scans"),
        robots=(0, "this many pauses of two robots on one floor instead"),
        only=("", "groups that begin with this"),
    )
    if asked.robots:
        print(facing_robots(asked.robots))
        return
    table = Table("scan:<10 | devices:<10 | fault:<52 | free:6 | unsafe:6 | wrong:6 | known %:.1f | health:<")
    for scene in scenes(asked.scans):
        name = scene.scan.name.split(",")[1 if scene.scan.name.startswith("rec") else 0].strip()
        for case in cases(scene):
            if case.group.startswith(asked.only):
                found = measure(scene, case)
                how, fault = "triggered" if case.triggered else "stepwise", f"{case.group}: {case.fault.name}"
                table.row(name, how, fault, found.free, found.unsafe, found.wrong, found.known, found.health)


if __name__ == "__main__":
    main()
