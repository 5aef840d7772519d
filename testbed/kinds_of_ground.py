"""Worlds with one kind of ground each, for a robot that walks along x from the origin."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from guara_perception.arrays import Float, Mask
from guara_perception.simulation.features import AnyFeature, Box, Feature, Patch, Pit, Rock, Stairs
from guara_perception.simulation.world import World

# x at which the level ground under the first stance ends.
START_M = 0.65
LENGTH_M, WIDTH_M = 3.0, 1.6
TRACK_M = 0.18
# Pauses at which objects have moved.
MOVED_AT = (9, 18)
MOVING = "moving"


@dataclass(frozen=True, slots=True, kw_only=True)
class Slope(Feature):
    """Ground that slopes by `along` and `across` [m/m] from the beginning of the feature on."""

    along: float = 0.0
    across: float = 0.0
    material: str = "soil"

    def shape(self, x: Float, y: Float, ground: Float, base: float) -> tuple[Float, Mask]:
        """See `Feature.shape`."""
        u = x - (self.x - self.size[0] / 2)
        # The slope across increases smoothly over the first 0.4 m.
        turned = np.clip(u / 0.4, 0, 1)
        rise = self.along * np.maximum(u, 0) + self.across * y * turned**2 * (3 - 2 * turned)
        return ground + rise, self.covers(x, y)


# Pairs of a pause and the world from this pause on.
Course = tuple[tuple[int, World], ...]


def course(kind: str, seed: int) -> Course:
    """Create a course of one of the `KINDS`, or of kind `MOVING`, whose objects move."""
    rng = np.random.default_rng([seed, *kind.encode()])
    if kind == MOVING:
        return _moving(rng, seed)
    return ((0, _world(seed, *KINDS[kind](rng))),)


def _world(seed: int, *features: AnyFeature) -> World:
    return World((-1.0, LENGTH_M), (-WIDTH_M / 2, WIDTH_M / 2), features, undulation=0.0, seed=seed)


def _stairs(direction: str) -> Callable[[np.random.Generator], list[AnyFeature]]:
    def stairs(rng: np.random.Generator) -> list[AnyFeature]:
        height, run = rng.uniform(0.035, 0.055), rng.uniform(0.24, 0.28)
        x = START_M + rng.uniform(0.0, 0.1)
        return [Stairs(x=x, height=height, run=run, count=5, direction=direction, material="concrete")]

    return stairs


def _pool(depth: float, length: float = 1.9) -> Pit:
    return Pit(x=START_M + 0.02 + length / 2, y=0.0, size=(length, 1.5), depth=depth)


def _stones(rng: np.random.Generator) -> list[AnyFeature]:
    pool, gap = _pool(0.12), 0.040
    end = pool.x + pool.size[0] / 2
    stones: list[AnyFeature] = []
    y = -0.7
    while y < 0.6:
        width, x = rng.uniform(0.18, 0.24), START_M
        while x < end - gap:
            along, top = rng.uniform(0.18, 0.24), 0.12 + rng.uniform(-0.004, 0.004)
            if x + along + gap + 0.18 > end - gap:
                along = end - gap - x
            centre = x + along / 2, y + width / 2
            stones.append(Box(x=centre[0], y=centre[1], size=(along, width), height=top, material="concrete"))
            x += along + gap
        y += width + gap
    return [pool, *stones]


def _plank(rng: np.random.Generator) -> list[AnyFeature]:
    pool, height = _pool(0.10, 1.2), 0.10 + rng.uniform(0.0, 0.004)
    sides = (TRACK_M + rng.uniform(0.0, 0.02), -TRACK_M - rng.uniform(0.0, 0.02))
    width = rng.uniform(0.16, 0.20)
    return [pool, *(Box(x=pool.x, y=y, size=(1.24, width), yaw=0.0, height=height) for y in sides)]


def _rubble(rng: np.random.Generator) -> list[AnyFeature]:
    rocks: list[AnyFeature] = []
    for _ in range(45):
        x, y = rng.uniform(START_M + 0.1, LENGTH_M - 0.6), rng.uniform(-0.6, 0.6)
        size, height = rng.uniform(0.03, 0.10, 2), rng.uniform(0.008, 0.030)
        yaw, is_rock, number = rng.uniform(0, np.pi), rng.random() < 0.7, int(rng.integers(1 << 30))
        area = (float(size[0]), float(size[1]))
        rocks.append(
            Rock(x=x, y=y, size=area, yaw=yaw, height=height, seed=number)
            if is_rock
            else Box(x=x, y=y, size=area, yaw=yaw, height=height)
        )
    return rocks


def _slope(along: float, across: float) -> Callable[[np.random.Generator], list[AnyFeature]]:
    def slope(rng: np.random.Generator) -> list[AnyFeature]:
        sign = rng.choice([-1, 1])
        x = (START_M + LENGTH_M) / 2
        size = (LENGTH_M - START_M, WIDTH_M)
        return [Slope(x=x, y=0.0, size=size, along=np.tan(along), across=sign * np.tan(across))]

    return slope


def _carpet(rng: np.random.Generator) -> list[AnyFeature]:
    yaw = rng.uniform(-0.1, 0.1)
    return [Box(x=1.35, y=0.0, size=(1.0, 1.3), yaw=yaw, height=0.008, material="brick")]


def _cables(rng: np.random.Generator) -> list[AnyFeature]:
    cables: list[AnyFeature] = []
    for x in START_M + 0.15 + 0.3 * np.arange(5) + rng.uniform(-0.05, 0.05, 5):
        thick = rng.uniform(0.005, 0.010)
        cables.append(Box(x=x, y=0.0, size=(thick, 1.2), yaw=rng.uniform(-0.5, 0.5), height=thick, material="blue"))
    return cables


def _grating(rng: np.random.Generator) -> list[AnyFeature]:
    first = START_M + rng.uniform(0.2, 0.4)
    return [Pit(x=first + 0.037 * i, y=0.0, size=(0.012, 1.2), depth=0.05, material="metal") for i in range(12)]


def _puddle(rng: np.random.Generator) -> list[AnyFeature]:
    return [
        Patch(x=x, y=rng.uniform(-0.25, 0.25), size=(0.25, 0.25), yaw=rng.uniform(0, np.pi), material="wet")
        for x in rng.uniform(START_M + 0.2, 2.0, 4)
    ]


def _mat(rng: np.random.Generator) -> list[AnyFeature]:
    return [
        Box(x=x, y=y, size=(0.20, 0.16), yaw=rng.uniform(-0.5, 0.5), height=0.004, material="dark")
        for x, y in ((1.0, TRACK_M), (1.3, -TRACK_M), (1.7, TRACK_M / 2))
    ]


def _moving(rng: np.random.Generator, seed: int) -> Course:
    things = [(rng.uniform(0.9, 2.2), rng.uniform(-0.3, 0.3), rng.uniform(0.02, 0.06), k % 3 == 2) for k in range(7)]
    states = []
    for number, first in enumerate((0, *MOVED_AT)):
        moved = [(x + 0.07 * number * (-1) ** k, y + 0.02 * number, *rest) for k, (x, y, *rest) in enumerate(things)]
        boxes = [
            Box(x=x, y=y, size=(0.1, 0.1), height=height, material="dark" if is_dark else "wood")
            for x, y, height, is_dark in moved
        ]
        states.append((first, _world(seed, *boxes)))
    return tuple(states)


KINDS: dict[str, Callable[[np.random.Generator], list[AnyFeature]]] = {
    "stairs up": _stairs("up"),
    "stairs down": _stairs("down"),
    "stones": _stones,
    "plank": _plank,
    "rubble": _rubble,
    "slope up": _slope(np.radians(15), 0.0),
    "slope across": _slope(0.0, np.radians(15)),
    "carpet edge": _carpet,
    "cables": _cables,
    "grating": _grating,
    "puddle": _puddle,
    "mat": _mat,
}
