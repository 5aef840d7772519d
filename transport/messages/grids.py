"""Grids as the message types that ROS 2 knows: nav_msgs/OccupancyGrid and grid_map_msgs/GridMap."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from transport.arrays import Array, Percent
from transport.exceptions import MessageError
from transport.messages.codec import make_header, make_time
from transport.messages.submessage_codec import make_point
from transport.messages.submessages import checked_origin, finite
from transport.messages.typestore import GRID_MAP, OCCUPANCY, make_message, message_class

# Layer that says where a cell of a GridMap is known.
BASIC_LAYER = "elevation"


def _geometry(resolution: float, origin: Sequence[float]) -> tuple[float, float, float]:
    edge = finite(resolution, "resolution")
    if edge <= 0.0:
        raise MessageError(f"resolution is {edge} m; allowed: more than 0")
    return edge, *checked_origin(origin)


def _make_pose(x: float, y: float) -> Any:
    return make_message("geometry_msgs/msg/Pose", position=make_point(x, y, 0.0))


def occupancy_message(values: Percent, resolution: float, origin: Sequence[float], frame_id: str, stamp: int) -> Any:
    """A nav_msgs/OccupancyGrid message object.

    Args:
        values: (ny, nx) int8, x fastest; 0 free ... 100 occupied, -1 unknown.
        resolution: [m] edge of a cell.
        origin: [m] (x, y) of the corner of cell (0, 0), at minimum x and y.
        frame_id: frame of the grid.
        stamp: [ns] since the epoch.

    Raises:
        MessageError: another dtype or shape, a value out of range, or geometry that is not finite.
    """
    edge, x, y = _geometry(resolution, origin)
    if values.dtype != np.int8 or values.ndim != 2 or values.size == 0:
        raise MessageError(f"occupancy is {values.dtype} of shape {values.shape}; allowed: int8 (ny, nx)")
    if values.min() < -1 or values.max() > 100:
        raise MessageError(f"occupancy runs from {values.min()} to {values.max()}; allowed: -1 to 100")
    info = message_class("nav_msgs/msg/MapMetaData")(
        map_load_time=make_time(stamp),
        resolution=edge,
        width=values.shape[1],
        height=values.shape[0],
        origin=_make_pose(x, y),
    )
    return message_class(OCCUPANCY)(make_header(stamp, frame_id), info, np.ascontiguousarray(values).ravel())


def grid_map_message(
    layers: Mapping[str, Array],
    resolution: float,
    origin: Sequence[float],
    frame_id: str,
    stamp: int,
) -> Any:
    """A grid_map_msgs/GridMap message object.

    A GridMap counts its cells from the corner at maximum x and y, rows along -x, columns along -y, and stores
    them column-major. Data of `a[iy, ix]`, x fastest, are therefore `a[::-1, ::-1].ravel()`.

    Args:
        layers: (ny, nx) arrays by name, all of one shape, "elevation" among them; converted to float32, the only type
            of a GridMap.
        resolution: [m] edge of a cell.
        origin: [m] (x, y) of the corner of cell (0, 0), at minimum x and y.
        frame_id: frame of the grid.
        stamp: [ns] since the epoch.

    Raises:
        MessageError: shapes that differ, no layer "elevation", or geometry that is not finite.
    """
    edge, x, y = _geometry(resolution, origin)
    shapes = {np.shape(array) for array in layers.values()}
    shape = shapes.pop() if len(shapes) == 1 else ()
    if len(shape) != 2 or 0 in shape:
        given = ", ".join(f"{name} {np.shape(array)}" for name, array in layers.items()) or "none"
        raise MessageError(f"layers given: {given}; allowed: one shape (ny, nx) for all")
    if BASIC_LAYER not in layers:
        raise MessageError(f"layers given: {', '.join(layers)}; allowed: {BASIC_LAYER!r} and others")
    ny, nx = shape
    dimension = message_class("std_msgs/msg/MultiArrayDimension")
    layout = message_class("std_msgs/msg/MultiArrayLayout")(
        [dimension("column_index", ny, ny * nx), dimension("row_index", nx, nx)], 0
    )
    array_class = message_class("std_msgs/msg/Float32MultiArray")
    data = [array_class(layout, np.asarray(array, dtype=np.float32)[::-1, ::-1].ravel()) for array in layers.values()]
    # The pose of a GridMap is its centre.
    info = message_class("grid_map_msgs/msg/GridMapInfo")(
        edge, nx * edge, ny * edge, _make_pose(x + 0.5 * nx * edge, y + 0.5 * ny * edge)
    )
    return message_class(GRID_MAP)(make_header(stamp, frame_id), info, list(layers), [BASIC_LAYER], data, 0, 0)
