"""Cuts a region out of a TerrainMessage, on whole cells."""

from __future__ import annotations

import math
from dataclasses import replace

from transport.exceptions import MessageError
from transport.messages.terrain_message import TerrainMessage


def crop_terrain(terrain: TerrainMessage, region: tuple[float, float, float, float]) -> TerrainMessage:
    """The cells of a grid that a region touches.

    Layers keep the values of the whole grid: `clearance` still counts to the border of that one. Obstacles are
    kept whole.

    Args:
        terrain: whole grid.
        region: [m] (x_min, x_max, y_min, y_max) in the frame of the grid.

    Raises:
        MessageError: the region lies off the grid.
    """
    ny, nx = terrain.shape
    x_min, x_max, y_min, y_max = region
    edge, (x0, y0) = terrain.resolution, terrain.origin
    # 1e-9 of a cell: a limit on a cell's border must not fetch the neighbour because of rounding.
    first_x, first_y = (max(0, math.floor((low - o) / edge + 1e-9)) for low, o in ((x_min, x0), (y_min, y0)))
    last_x = min(nx, math.ceil((x_max - x0) / edge - 1e-9))
    last_y = min(ny, math.ceil((y_max - y0) / edge - 1e-9))
    if first_x >= last_x or first_y >= last_y:
        raise MessageError(
            f"region x {x_min:g} ... {x_max:g}, y {y_min:g} ... {y_max:g} m lies off the grid, which covers "
            f"x {x0:g} ... {x0 + nx * edge:g}, y {y0:g} ... {y0 + ny * edge:g} m"
        )
    layers = {name: array[first_y:last_y, first_x:last_x].copy() for name, array in terrain.layers.items()}
    return replace(terrain, layers=layers, origin=(x0 + first_x * edge, y0 + first_y * edge))
