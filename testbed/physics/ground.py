"""Solid ground of a world in MuJoCo: floor, pits and boxes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from guara_perception.arrays import Float, Mask
from guara_perception.exceptions import InvalidInput, optional_library
from guara_perception.simulation.features import Box, Feature, Patch, Pit
from guara_perception.simulation.world import World
from testbed.physics.mujoco_robot import FRICTION

ROBOT_BIT, GROUND_BIT = 1, 2
# Length by which boxes extend below the floor, and by which the floor extends beyond the world [m].
BELOW_M, BEYOND_M = 0.05, 1.0
Rectangle = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Block(Feature):
    """Box whose top is at a fixed height `top` in the world [m], independent of the ground below."""

    top: float

    def shape(self, x: Float, y: Float, ground: Float, base: float) -> tuple[Float, Mask]:
        """See `Feature.shape`."""
        mask = self.covers(x, y) & (ground < self.top)
        return np.where(mask, self.top, ground), mask


def add_ground(spec: Any, world: World) -> None:
    """Add the ground to a `mujoco.MjSpec`; its robot then collides with the ground, but not with itself.

    Raises:
        InvalidInput: the world undulates, or has features other than boxes, blocks, pits and patches.
    """
    if world.undulation > 0:
        raise InvalidInput(f"undulation of the world is {world.undulation} m; allowed in MuJoCo: 0")
    mujoco = optional_library("mujoco", "sim", "ground in MuJoCo")
    for geom in spec.geoms:
        geom.contype, geom.conaffinity = ROBOT_BIT, GROUND_BIT
    common = {"contype": GROUND_BIT, "conaffinity": ROBOT_BIT, "friction": FRICTION}
    pits = [each for each in world.features if isinstance(each, Pit)]
    floor = -max([each.depth for each in pits], default=0.0)
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 0.05], pos=[0, 0, floor], **common)
    boxes = [((x0 + x1) / 2, (y0 + y1) / 2, x1 - x0, y1 - y0, 0.0, 0.0) for x0, x1, y0, y1 in _between(world, pits)]
    for each in world.features:
        if isinstance(each, (Box, Block)):
            top = each.top if isinstance(each, Block) else float(world.height(each.x, each.y))
            boxes.append((each.x, each.y, *each.size, each.yaw, top))
        elif type(each) not in (Feature, Patch, Pit):
            kind = type(each).__name__.lower()
            raise InvalidInput(f"the world has a {kind}; allowed in MuJoCo: boxes, pits and patches")
    for x, y, length, width, yaw, top in boxes:
        half = (top - floor + BELOW_M) / 2
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=[length / 2, width / 2, half],
            pos=[x, y, top - half],
            quat=[np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)],
            **common,
        )


def _between(world: World, pits: list[Pit]) -> list[Rectangle]:
    """Rectangles (x0, x1, y0, y1) that cover the world except its pits."""
    (x0, x1), (y0, y1) = world.x, world.y
    rectangles = [(x0 - BEYOND_M, x1 + BEYOND_M, y0 - BEYOND_M, y1 + BEYOND_M)] if pits else []
    for pit in pits:
        a0, a1, b0, b1 = pit.bounds
        cut: list[Rectangle] = []
        for x0, x1, y0, y1 in rectangles:
            low, high, near, far = max(x0, a0), min(x1, a1), max(y0, b0), min(y1, b1)
            if low >= high or near >= far:
                cut.append((x0, x1, y0, y1))
                continue
            parts = ((x0, low, y0, y1), (high, x1, y0, y1), (low, high, y0, near), (low, high, far, y1))
            cut += [each for each in parts if each[0] < each[1] and each[2] < each[3]]
        rectangles = cut
    return rectangles
