"""Random worlds with boxes, rocks, pits and dark patches."""

from __future__ import annotations

import numpy as np

from guara_perception.exceptions import InvalidInput
from guara_perception.simulation.features import AnyFeature, Box, Patch, Pit, Rock
from guara_perception.simulation.world import World

# x at which the flat ground under the first stance ends.
START_M = 0.55
# Undulation of a floor, and limits of the height of the box on it.
UNDULATION_M = 0.002
BOX_HEIGHTS_M = (0.02, 0.08)
MATERIALS_OF_BOXES = ("wood", "concrete", "brick", "blue")


def random_world(
    seed: int,
    *,
    length: float = 3.0,
    boxes: int = 12,
    rocks: int = 8,
    pits: int = 2,
    dark: int = 2,
    undulation: float = 0.002,
    box_heights: tuple[float, float] = (0.01, 0.08),
) -> World:
    """Create a world ahead of a robot that starts at x = 0.

    Args:
        seed: seed of the world.
        length: length of the world ahead of the robot's first stance [m].
        boxes: number of boxes, some low enough to step on.
        rocks: number of rocks.
        pits: number of pits, too deep to step into.
        dark: number of patches that absorb the laser light.
        undulation: standard deviation of the ground [m].
        box_heights: limits of the height of a box [m].

    Raises:
        InvalidInput: a number is negative, or the length is below 1 m.
    """
    counts = {"boxes": boxes, "rocks": rocks, "pits": pits, "dark": dark}
    for name, count in counts.items():
        if count < 0:
            raise InvalidInput(f"{name} is {count}, allowed: 0 or more")
    if length < 1.0:
        raise InvalidInput(f"length is {length} m, allowed: 1 m or more")
    rng = np.random.default_rng(seed)
    width = 0.34

    def free_spot(size: tuple[float, float]) -> tuple[float, float]:
        reach = float(np.hypot(*size)) / 2
        return float(rng.uniform(START_M + reach, length - reach)), float(rng.uniform(-width + reach, width - reach))

    features: list[AnyFeature] = []
    for _ in range(dark):
        size = (float(rng.uniform(0.08, 0.14)), float(rng.uniform(0.08, 0.14)))
        x, y = free_spot(size)
        features.append(Patch(x=x, y=y, size=size, yaw=float(rng.uniform(0, np.pi)), material="dark"))
    for _ in range(pits):
        size = (float(rng.uniform(0.08, 0.14)), float(rng.uniform(0.08, 0.14)))
        x, y = free_spot(size)
        features.append(Pit(x=x, y=y, size=size, depth=float(rng.uniform(0.04, 0.07))))
    for _ in range(boxes):
        size = (float(rng.uniform(0.06, 0.2)), float(rng.uniform(0.06, 0.2)))
        x, y = free_spot(size)
        material = str(rng.choice(MATERIALS_OF_BOXES))
        features.append(
            Box(
                x=x, y=y, size=size, yaw=float(rng.uniform(0, np.pi)), height=float(rng.uniform(*box_heights)),
                material=material,
            )
        )  # fmt: skip
    for _ in range(rocks):
        size = (float(rng.uniform(0.04, 0.12)), float(rng.uniform(0.04, 0.12)))
        x, y = free_spot(size)
        height = 0.6 * min(size) * float(rng.uniform(0.4, 1.0))
        features.append(
            Rock(x=x, y=y, size=size, yaw=float(rng.uniform(0, np.pi)), height=height, seed=int(rng.integers(1 << 30)))
        )
    return World(
        x=(-1.0, length + 1.0),
        y=(-0.8, 0.8),
        features=tuple(features),
        undulation=undulation,
        seed=seed,
        flat_until=START_M,
    )


def floor(seed: int, pause: int, *, with_box: bool) -> World:
    """Create the floor of one pause, bare or with a box in the corridor of the feet and completely in view."""
    number = 1000 * seed + pause
    random = np.random.default_rng(number)
    box = Box(
        x=random.uniform(0.55, 0.88),
        y=random.uniform(-0.20, 0.20),
        size=(random.uniform(0.03, 0.08), random.uniform(0.03, 0.08)),
        height=random.uniform(*BOX_HEIGHTS_M),
        yaw=random.uniform(0, np.pi),
    )
    return World(undulation=UNDULATION_M, seed=number, features=(box,) if with_box else ())
