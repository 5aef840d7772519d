"""Random courses of several kinds of ground, which begin ahead of the front feet and end at a goal."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from guara_perception.exceptions import InvalidInput
from guara_perception.simulation.features import Feature, Pit
from guara_perception.simulation.world import World
from testbed.physics.ground import Block

# x at which the level ground ends, and length of the field behind it; the body starts at x = 0.
START_M, FIELD_M = 0.65, 0.90
WORLD_X, WORLD_Y = (-0.9, 3.2), (-0.8, 0.8)
# Border around the world that allows for rounding errors.
RIM_M = 0.01
# Depth of trenches and of the ground between stones, out of reach of all feet.
DEEP_M = 0.25


@dataclass(frozen=True)
class Course:
    """Ground to cross.

    Attributes:
        kind, seed: arguments of `course`.
        world: the ground; only `Pit` and `Block` change its height.
        goal: x beyond which all feet must stand [m].
    """

    kind: str
    seed: int
    world: World
    goal: float


@dataclass(frozen=True)
class Sizes:
    """Dimensions of courses for a robot; the defaults are for a Go2.

    Attributes:
        spread: factor of all lengths and widths except gaps, for larger soles.
        gaps: widths of trenches; the first two are the limits of gaps between stones [m].
        rises: limits of the height of a step of the stairs [m].
        tops: limits of the height of a block of rubble [m].
    """

    spread: float = 1.0
    gaps: tuple[float, ...] = (0.04, 0.06, 0.08, 0.10)
    rises: tuple[float, float] = (0.04, 0.06)
    tops: tuple[float, float] = (0.02, 0.06)


# Sizes by robot. Soles of a Guará and their margins need 1.5 times as much ground. Its legs and balance allow steps of
# 180 mm, of which margins of 60 mm on each side and rims take 140 mm, and of 40 mm downwards in the scan posture
# (robot.toml).
SIZES = {
    "go2": Sizes(),
    "guara": Sizes(1.5, gaps=(0.025, 0.030, 0.035, 0.040), rises=(0.03, 0.04), tops=(0.02, 0.04)),
}


def course(kind: str, seed: int, sizes: Sizes = SIZES["go2"]) -> Course:
    """Create a course of one of the `KINDS`.

    Raises:
        InvalidInput: no such kind.
    """
    if kind not in KINDS:
        raise InvalidInput(f"course is {kind!r}; allowed: {', '.join(KINDS)}")
    rng = np.random.default_rng([seed, *kind.encode()])
    features = tuple(KINDS[kind](seed, rng, sizes))
    goal = max([each.bounds[0] for each in features if each.bounds[1] > WORLD_X[1] - RIM_M], default=START_M + FIELD_M)
    x, y = ((low - RIM_M, high + RIM_M) for low, high in (WORLD_X, WORLD_Y))
    return Course(kind, seed, World(x, y, features, seed=seed), goal)


def _slab(start: float, end: float, top: float = 0.0) -> Block:
    """Create a block across the whole width of the world."""
    width = WORLD_Y[1] - WORLD_Y[0]
    return Block(x=(start + end) / 2, y=0.0, size=(end - start, width), top=top, material="concrete")


def _pool() -> Iterator[Feature]:
    """Yield a pit under the whole world, and the bank before the field."""
    size = WORLD_X[1] - WORLD_X[0], WORLD_Y[1] - WORLD_Y[0]
    yield Pit(x=sum(WORLD_X) / 2, y=0.0, size=size, depth=DEEP_M)
    yield _slab(WORLD_X[0], START_M)


def _trenches(seed: int, rng: np.random.Generator, sizes: Sizes) -> Iterator[Feature]:
    """Yield slabs with trenches across the path: for a Go2, 40, 60, 80 or 100 mm wide, every 0.3 to 0.5 m."""
    yield from _pool()
    gap, x = sizes.gaps[seed % len(sizes.gaps)], START_M
    while x < START_M + FIELD_M - 0.3 * sizes.spread:
        end = x + sizes.spread * rng.uniform(0.3, 0.5)
        yield _slab(x + gap, end)
        x = end
    yield _slab(x + gap, WORLD_X[1])


def _stones(seed: int, rng: np.random.Generator, sizes: Sizes) -> Iterator[Feature]:
    """Yield rows of stones, for a Go2 160 to 240 mm long and wide and 40 to 60 mm apart, with tops within 10 mm."""
    yield from _pool()
    low, high, (least_gap, most_gap) = 0.16 * sizes.spread, 0.24 * sizes.spread, sizes.gaps[:2]
    end, count, y = START_M + 1.0, round(4 / sizes.spread), -0.72 + rng.uniform(0.0, 0.1)
    yield _slab(end, WORLD_X[1])
    while y + high < WORLD_Y[1]:
        width = rng.uniform(low, high)
        x = START_M
        for left in range(count, 0, -1):
            # The rest of the field must be divisible into stones of allowed lengths.
            gap = rng.uniform(least_gap, most_gap)
            least, most = (end - x - gap - (left - 1) * each - left * 0.05 for each in (high, low))
            length = np.clip(rng.uniform(low, high), max(low, least), min(high, most))
            top = rng.uniform(-0.005, 0.005)
            yield Block(x=x + gap + length / 2, y=y + width / 2, size=(length, width), top=top, material="concrete")
            x += gap + length
        y += width + rng.uniform(least_gap, most_gap)


def _stairs(seed: int, rng: np.random.Generator, sizes: Sizes) -> Iterator[Feature]:
    """Yield two steps up and two down, for a Go2 40 to 60 mm high and 230 to 270 mm deep."""
    rise, x = rng.uniform(*sizes.rises), START_M
    for level in (1, 2, 1):
        end = x + sizes.spread * (rng.uniform(0.23, 0.27) + (0.1 if level == 2 else 0.0))
        yield _slab(x, end, level * rise)
        x = end


def _rubble(seed: int, rng: np.random.Generator, sizes: Sizes) -> Iterator[Feature]:
    """Yield randomly turned blocks, for a Go2 80 to 200 mm long and wide and 20 to 60 mm high, on most of the floor."""
    spread = sizes.spread
    for x in np.arange(START_M + 0.08 * spread, START_M + FIELD_M - 0.05, 0.17 * spread):
        for y in np.arange(-0.51, 0.52, 0.17 * spread):
            if rng.random() < 0.6:
                dx, dy = spread * rng.uniform(-0.04, 0.04, 2)
                size = tuple((spread * rng.uniform(0.08, 0.20, 2)).tolist())
                yaw, top = rng.uniform(0, np.pi), rng.uniform(*sizes.tops)
                yield Block(x=x + dx, y=y + dy, size=size, yaw=yaw, top=top)


def _mixed(seed: int, rng: np.random.Generator, sizes: Sizes) -> Iterator[Feature]:
    """Yield boxes 30 to 60 mm high, pits 90 mm deep and dark mats: one of them in each lane every 0.25 m."""
    spread, (_, least, _, most) = sizes.spread, sizes.gaps
    xs = START_M + spread * np.arange(0.10, FIELD_M / spread, 0.25)
    for before, x in pairwise([START_M, *xs]):
        for side in (-1, 1):
            place = {"x": x + rng.uniform(-0.02, 0.02), "y": side * rng.uniform(0.08, 0.22)}
            size = float(rng.uniform(least, most)), spread * float(rng.uniform(0.12, 0.24))
            kind = rng.integers(3) if before > START_M else 1
            if kind == 0:
                yield Block(**place, size=size, top=float(rng.uniform(0.03, 0.06)))
            elif kind == 1:
                yield Pit(**place, size=size, depth=0.09)
            else:
                yield Feature(**place, size=size, material="dark")


KINDS: dict[str, Callable[[int, np.random.Generator, Sizes], Iterator[Feature]]] = {
    "trenches": _trenches,
    "stones": _stones,
    "stairs": _stairs,
    "rubble": _rubble,
    "mixed": _mixed,
    "flat": lambda seed, rng, sizes: iter(()),
}
