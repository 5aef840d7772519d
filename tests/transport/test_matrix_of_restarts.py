"""Grids that the truth contradicts, over a matrix of restarts and losses and over random walks: none is handed out.

Each moment of a pause, times each thing that happens to node, router or link, times each act of the gait meanwhile, on
an emulated clock; the planner asks 20 times a second. A grid is contradicted when the gait has contradicted it for
longer than a message may take to arrive; until then, or while a link is silent, nobody can know.
"""

from __future__ import annotations

import itertools
import math
import random
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import pytest

from testbed.restarts import EXTENTS, TICK, World
from tests.thorough import further

Act = Callable[[World], None]


def _then(*acts: Act) -> Act:
    """One act after the other."""

    def run(world: World) -> None:
        for act in acts:
            act(world)

    return run


def _wait(seconds: float) -> Act:
    return lambda world: world.pass_time(seconds)


def _end(world: World, *, moved: bool = False) -> None:
    if world.stands:
        world.end(moved=moved)


NOTHING, END_ELSEWHERE = _then(), partial(_end, moved=True)
START_HEALTHY, START_UNABLE = partial(World.start, is_healthy=True), partial(World.start, is_healthy=False)
BEFORE_SCAN = _then(World.begin, _wait(0.5))
AFTER_SCAN = _then(BEFORE_SCAN, World.scan, _wait(0.3))
AFTER_END = _then(AFTER_SCAN, World.end, _wait(0.3))
NEXT_PAUSE = _then(_end, World.begin)
MOMENTS: dict[str, Act] = {
    "before the scan": BEFORE_SCAN,
    # The grid of the pause before is available, that of this pause is not finished yet.
    "in the scan": _then(AFTER_END, World.begin, _wait(0.5)),
    "before END": AFTER_SCAN,
    "after END": AFTER_END,
}
# First what breaks, how long it lasts before the next act [s], and what repairs it.
EVENTS: dict[str, tuple[Act, float, Act]] = {
    "node dead, stays away": (World.kill, 1.0, NOTHING),
    "node dead, the next scans": (World.kill, 3.0, START_HEALTHY),
    "node dead, the next cannot scan": (World.kill, 3.0, START_UNABLE),
    "node dead, the next scans late": (World.kill, 3.0, _then(World.start, _wait(5.0), World.scan)),
    "node restarted at once": (_then(World.kill, START_HEALTHY), 0.0, NOTHING),
    "node hangs for 10 s": (World.hang, 10.0, World.wake),
    "node says no more": (World.mute, 4.0, World.kill),
    "grids lost on the way": (World.lose, 1.0, NOTHING),
    "router restarted": (World.restart_router, 0.0, NOTHING),
    **{f"link lost for {seconds:g} s": (World.cut, seconds, World.heal) for seconds in (1.0, 10.0, 60.0)},
    **{
        f"gait not heard by the node for {seconds:g} s": (World.deafen, seconds, World.listen)
        for seconds in (1.0, 10.0, 60.0)
    },
    "nothing": (NOTHING, 1.0, NOTHING),
}
GAITS: dict[str, Act] = {
    "stands": NOTHING,
    "END": _end,
    "END elsewhere": END_ELSEWHERE,
    "next pause": NEXT_PAUSE,
    "48 pauses": _then(*[NEXT_PAUSE] * 48),
    "another walk": _then(_end, partial(World.begin, new_walk=True)),
}
DISTURBANCES = (
    *(World.kill, World.hang, World.wake, World.cut, World.restart_router, World.lose, World.mute),
    World.deafen,
)
DELAYS = (0.0, 0.3)
# What the gait does comes just before the event, or this long after it [s].
WHEN = (-TICK, 0.2, 4.0)


@dataclass
class Count:
    """Asks of one extent, summed."""

    cases: int = 0
    asks: int = 0
    handed_out: int = 0
    contradictions: int = 0
    unknowable: int = 0
    withheld: int = 0


def ask(world: World, count: Count, extents: tuple[str, ...] = EXTENTS) -> None:
    """One ask for each extent."""
    for extent in extents:
        if extent not in world.held:
            continue
        count.asks += 1
        found = world.against(extent, math.inf)
        wrong = world.contradicted_for(extent)
        if not found:
            count.handed_out += 1
            count.contradictions += wrong > world.promised()
            count.unknowable += 0.0 <= wrong <= world.promised()
        count.withheld += bool(found) and wrong > world.promised()


def live_through(world: World, seconds: float, count: Count) -> None:
    """Let time pass, asking at each instant."""
    for _ in range(max(1, round(seconds / TICK))):
        world.pass_time(TICK)
        ask(world, count)


def run_matrix() -> Count:
    """Every case of the matrix."""
    count = Count()
    kinds = itertools.product(MOMENTS.values(), EVENTS.values(), GAITS.values(), WHEN, DELAYS)
    for moment, (breaks, lasts, mends), gait, when, delay in kinds:
        world = World(delay)
        world.start()
        moment(world)
        if when < 0.0:
            gait(world)
            world.pass_time(TICK)
        breaks(world)
        ask(world, count)
        if when >= 0.0:
            live_through(world, min(when, lasts), count)
            gait(world)
        live_through(world, max(0.0, lasts - max(when, 0.0)), count)
        mends(world)
        live_through(world, 2.0, count)
        world.scan()
        live_through(world, 5.0, count)
        count.cases += 1
    return count


def run_walks(walks: int, seed: int) -> Count:
    """Random walks of 60 acts."""
    count, chosen = Count(), random.Random(seed)
    acts: list[Act] = [
        lambda world: world.begin(new_walk=chosen.random() < 0.2),
        World.scan,
        World.scan,
        _end,
        END_ELSEWHERE,
        lambda world: world.start(is_healthy=chosen.random() < 0.8),
        World.heal,
        World.listen,
        lambda world: chosen.choice(DISTURBANCES)(world),
    ]
    for _ in range(walks):
        world = World(chosen.choice((0.0, 0.2, 1.0)))
        world.start()
        for _ in range(60):
            chosen.choice(acts)(world)
            ask(world, count)
            live_through(world, chosen.choice((0.05, 0.3, 1.0, 4.0)), count)
        count.cases += 1
    return count


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, *further(4, 5, 6)])
def test_no_walk_is_given_ground_that_the_truth_contradicts(seed: int) -> None:
    """Random walks of nodes, links and pauses."""
    count = run_walks(30, seed)
    assert count.cases == 30 and count.handed_out > 0
    assert count.contradictions == 0 and count.withheld > 0


@pytest.mark.heavy
def test_no_case_of_the_matrix_is_given_ground_that_the_truth_contradicts() -> None:
    """Each moment, event and act of the gait."""
    count = run_matrix()
    assert count.cases == 4 * len(EVENTS) * 6 * 3 * 2
    assert count.contradictions == 0 and count.handed_out > 100_000
