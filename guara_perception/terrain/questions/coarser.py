"""`coarser`: larger cells by conservative pooling: the worst of the fine cells counts."""

from __future__ import annotations

import dataclasses
from typing import TypeVar

import cv2
import numpy as np

from guara_perception.arrays import Array
from guara_perception.exceptions import InvalidInput
from guara_perception.terrain.layers.geometry import GridGeometry
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK, Hazard
from guara_perception.terrain.layers.layered_grid import LayeredGrid

Grid = TypeVar("Grid", bound=LayeredGrid)


def coarser(terrain: Grid, factor: int) -> Grid:
    """The same terrain in cells `factor` times as long; each holds the worst value of its fine cells.

    One unknown fine cell makes a coarse one unknown; flags are joined, slope, step, roughness, variance and age
    are the largest, score, clearance and looks the smallest.

    Raises:
        InvalidInput: a factor that does not divide the grid; the message lists those that do.
    """
    ny, nx = terrain.shape
    is_whole = isinstance(factor, int | np.integer) and not isinstance(factor, bool)
    if not is_whole or factor < 1 or ny % factor or nx % factor:
        allowed = [n for n in range(1, min(ny, nx) + 1) if ny % n == 0 and nx % n == 0]
        raise InvalidInput(
            f"factor is {factor!r}, it must divide the {nx} x {ny} cells: {', '.join(map(str, allowed))}"
        )
    shape = (ny // factor, nx // factor)

    def blocks(name: str) -> Array:
        return terrain.layers[name].reshape(shape[0], factor, shape[1], factor).swapaxes(1, 2).reshape(*shape, -1)

    hazard = np.asarray(np.bitwise_or.reduce(blocks("hazard"), axis=-1), dtype=np.uint16)
    unknown = (hazard & UNKNOWN_MASK) != 0
    # A safe coarse cell keeps a ring of known cells around it, as fine ones do.
    beside = cv2.dilate(unknown.astype(np.uint8), np.ones((3, 3), np.uint8), borderType=cv2.BORDER_REPLICATE) > 0
    hazard[beside & ~unknown] |= np.uint16(Hazard.EDGE)
    nan = np.where(unknown, np.float32(np.nan), np.float32(0))
    layers: dict[str, Array] = {
        "elevation": blocks("elevation").astype(np.float64).mean(axis=-1).astype(np.float32),
        "variance": blocks("variance").max(axis=-1),
        "elevation_min": blocks("elevation_min").min(axis=-1),
        "elevation_max": blocks("elevation_max").max(axis=-1),
        "clearance": blocks("clearance").min(axis=-1),
        "traversability": np.where(hazard == 0, blocks("traversability").min(axis=-1), np.float32(0)),
        "hazard": hazard,
        "age": blocks("age").max(axis=-1),
        "looks": blocks("looks").min(axis=-1),
    }
    for name in ("slope", "step_height", "roughness"):
        # A value that a fine cell does not have is not known to be small: NaN wins.
        layers[name] = blocks(name).max(axis=-1)
    for name in ("elevation", "variance", "elevation_min", "elevation_max", "slope", "step_height", "roughness"):
        layers[name] = (layers[name] + nan).astype(np.float32)
    layers["traversability"] = layers["traversability"].astype(np.float32)
    geometry = GridGeometry(terrain.origin, terrain.resolution * factor, shape)
    return dataclasses.replace(terrain, layers=layers, geometry=geometry, pictures={})
