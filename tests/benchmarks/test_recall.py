"""Recall by kinds of ground: what counts as seen, as safe and as dangerous."""

import numpy as np
import pytest

from benchmarks.recall import DANGEROUS_RELIEF_M, Soles, walk_counts
from guara_perception.settings import Settings
from guara_perception.simulation import SimulatedRangefinder, World, specimen
from guara_perception.simulation.features import Pit
from guara_perception.simulation.walk import simulate_walk
from guara_perception.terrain.layers.geometry import GridGeometry
from kinematics import load_robot
from testbed.kinds_of_ground import KINDS, MOVING, course
from testbed.scanned_walk import visible_cells
from testbed.true_ground import CELL_M, TrueGround

SOLE = np.ones((13, 17), np.uint8)
CELLS = GridGeometry.over((0.0, 0.4), (-0.2, 0.2), 0.005)


def ground(high: float, *, is_dark: bool = False) -> TrueGround:
    """Level ground with a block of 50 mm in its middle, bright or dark."""
    x, y = np.meshgrid(np.arange(-0.2, 0.6, CELL_M), np.arange(-0.4, 0.4, CELL_M))
    block = (np.abs(x - 0.2) < 0.025) & (np.abs(y) < 0.025)
    return TrueGround((-0.2, -0.4), np.where(block, high, 0.0).astype(np.float32), block & is_dark)


@pytest.mark.parametrize(("high", "is_dark"), [(0.04, False), (0.0, True)])
def test_a_sole_is_judged_by_the_ground_of_its_cells_own_time(high: float, is_dark: bool) -> None:
    """A block that came later endangers no sole whose cells were all looked at before."""
    robot = load_robot("guara")
    limits = Settings.of(robot).limits
    states = [each.grid(np.eye(4), CELLS, robot) for each in (ground(0.0), ground(high, is_dark=is_dark))]
    looked = np.zeros(CELLS.shape, dtype=np.intp)
    before = Soles.on(states, looked, SOLE, limits)
    assert not before.relief.any() and not before.dark.any()
    looked[40, 40] = 1
    after = Soles.on(states, looked, SOLE, limits)
    danger = after.dark if is_dark else after.relief
    assert high == 0.0 or high > DANGEROUS_RELIEF_M
    assert danger[40, 40] and danger[36, 34] and not danger[30, 20]
    assert not (after.safe & danger).any()


def test_every_kind_of_ground_is_level_under_the_first_stance() -> None:
    """The gait declares it so; farther on each kind has relief or another material, and none is like another."""
    ahead = set()
    for kind in (*KINDS, MOVING):
        world = course(kind, 3)[-1][1]
        heights, materials = world.raster((-0.6, 2.4), (-0.3, 0.3), 0.01)
        assert not heights[:, :100].any(), kind
        assert heights.any() or np.ptp(materials), kind
        ahead.add((heights.tobytes(), materials.tobytes()))
    assert len(ahead) == len(KINDS) + 1


@pytest.mark.slow
def test_what_is_visible_is_in_the_ranges_of_the_scans_own_footprint() -> None:
    """The floor of a pit below the lowest height is in range of a scan whose footprint lies 20 mm lower than truly."""
    robot = load_robot("guara")
    world = World((-1.0, 2.0), (-0.8, 0.8), (Pit(x=0.75, y=0.0, size=(0.3, 0.4), depth=0.09),), undulation=0.0)
    pause = next(iter(simulate_walk(world, robot, lambda pause: pause.nominal, cycles=1, seed=0)))
    rangefinder = SimulatedRangefinder(world, specimen(robot, (640, 512), 0), robot, 0)
    rangefinder.set_pose(pause.transform_base_to_world, pause.joint_positions)
    lower = pause.transform_footprint_to_world.copy()
    lower[2, 3] -= 0.02
    in_pit = []
    for to_world in (pause.transform_footprint_to_world, lower):
        y, x = visible_cells(pause, to_world, rangefinder, Settings.of(robot), [0, 69]).T * 0.005 - [[0.8], [1.0]]
        in_pit.append(int(((np.abs(x - 0.75) < 0.1) & (np.abs(y) < 0.15)).sum()))
    assert in_pit[0] == 0 and in_pit[1] > 1000


@pytest.mark.heavy
def test_a_dark_mat_is_never_free_and_the_ground_about_it_is() -> None:
    """A walk past mats: most of what could be seen is free, no sole on dark ground, none on ground that nobody saw."""
    counts = walk_counts(load_robot("guara"), "mat", 1, "coarse", 3)
    assert counts["lane, free"] > 0.85 * counts["lane"] > 0
    assert counts["relief"] == counts["dark"] == counts["never seen"] == 0
