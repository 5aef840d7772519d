"""Grids that a client hands out although the truth contradicts them, over a matrix of restarts and losses.

`python -m benchmarks.restarts [--json]`: every moment of a pause x what happens to node, router or link x what the gait
does meanwhile, on an emulated clock; the planner asks 20 times a second. Counted are the cases, the asks, and those of
them in which a grid was handed out that the gait had contradicted: longer ago than a message may take to arrive (a
contradiction), or less (the link had just been cut without notice, and nobody can know); and those in which such a grid
was withheld. `--seed N --walks N`: random walks too.
"""

from __future__ import annotations

import itertools
import json
import math
import random
from collections.abc import Callable
from dataclasses import asdict, dataclass

from benchmarks.command import options
from testbed.restarts import EXTENTS, TICK, World

Act = Callable[[World], None]


def _nothing(world: World) -> None:
    """The gait stays as it is."""


def _before_scan(world: World) -> None:
    world.begin()
    world.pass_time(0.5)


def _in_scan(world: World) -> None:
    # The grid of the pause before is at hand, this one's is not made yet.
    _after_end(world)
    world.begin()
    world.pass_time(0.5)


def _after_scan(world: World) -> None:
    _before_scan(world)
    world.scan()
    world.pass_time(0.3)


def _after_end(world: World) -> None:
    _after_scan(world)
    world.end()
    world.pass_time(0.3)


def _end(world: World) -> None:
    if world.stands:
        world.end()


def _end_elsewhere(world: World) -> None:
    if world.stands:
        world.end(moved=True)


def _next_pause(world: World) -> None:
    _end(world)
    world.begin()


def _pauses(world: World) -> None:
    for _ in range(48):
        _next_pause(world)


def _walk(world: World) -> None:
    _end(world)
    world.begin(new_walk=True)


def _lost(seconds: float) -> tuple[Act, float, Act]:
    return World.cut, seconds, World.heal


def _restart(world: World) -> None:
    world.kill()
    world.start(is_healthy=True)


def _slow(world: World) -> None:
    world.start()
    world.pass_time(5.0)
    world.scan()


MOMENTS = {
    "before the scan": _before_scan,
    "in the scan": _in_scan,
    "before END": _after_scan,
    "after END": _after_end,
}
# First what breaks, how long it lasts before the next act [s], and what mends it.
EVENTS: dict[str, tuple[Act, float, Act]] = {
    "node dead, stays away": (World.kill, 1.0, _nothing),
    "node dead, the next scans": (World.kill, 3.0, lambda world: world.start(is_healthy=True)),
    "node dead, the next cannot scan": (World.kill, 3.0, lambda world: world.start(is_healthy=False)),
    "node dead, the next scans late": (World.kill, 3.0, _slow),
    "node restarted at once": (_restart, 0.0, _nothing),
    "node hangs for 10 s": (World.hang, 10.0, World.wake),
    "node says no more": (World.mute, 4.0, World.kill),
    "grids lost on the way": (World.lose, 1.0, _nothing),
    "router restarted": (World.restart_router, 0.0, _nothing),
    "link lost for 1 s": _lost(1.0),
    "link lost for 10 s": _lost(10.0),
    "link lost for 60 s": _lost(60.0),
    "gait not heard by the node for 1 s": (World.deafen, 1.0, World.listen),
    "gait not heard by the node for 10 s": (World.deafen, 10.0, World.listen),
    "gait not heard by the node for 60 s": (World.deafen, 60.0, World.listen),
    "nothing": (_nothing, 1.0, _nothing),
}
GAITS = {
    "stands": _nothing,
    "END": _end,
    "END elsewhere": _end_elsewhere,
    "next pause": _next_pause,
    "48 pauses": _pauses,
    "another walk": _walk,
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
        _end_elsewhere,
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


def main() -> None:
    """Command line."""
    asked = options(
        __doc__,
        walks=(200, "random walks"),
        seed=(1, "seed of the walks"),
        json=(False, "print one JSON object instead"),
    )
    counts = {"matrix": run_matrix(), "random walks": run_walks(asked.walks, asked.seed)}
    if asked.json:
        print(json.dumps({name: asdict(count) for name, count in counts.items()}))
        return
    for name, count in counts.items():
        print(
            f"{name}: {count.cases} cases, {count.asks} asks, {count.handed_out} grids handed out, "
            f"{count.contradictions} contradictions; {count.unknowable} within the time of a message or of a silent "
            f"link; contradicted grids withheld: {count.withheld}"
        )


if __name__ == "__main__":
    main()
