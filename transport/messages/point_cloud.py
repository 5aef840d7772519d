"""Makes point clouds as ROS 2 has them: sensor_msgs/PointCloud2."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from transport.arrays import Array
from transport.exceptions import MessageError
from transport.messages.codec import make_header
from transport.messages.typestore import POINT_CLOUD, make_message, message_class

# The numbers of sensor_msgs/PointField.
DATATYPES = {"int8": 1, "uint8": 2, "int16": 3, "uint16": 4, "int32": 5, "uint32": 6, "float32": 7, "float64": 8}


def point_cloud_message(fields: Mapping[str, Array], frame_id: str, stamp: int) -> Any:
    """A sensor_msgs/PointCloud2 message object: one row of points, little endian, no gaps.

    Args:
        fields: (n,) arrays by name, `x`, `y` and `z` [m] among them; each keeps its dtype. Viewers take
            colours from `rgb`: uint32, 0x00RRGGBB.
        frame_id: frame of the points.
        stamp: [ns] since the epoch.

    Raises:
        MessageError: x, y or z is missing, the lengths differ, a dtype is none of DATATYPES, or a coordinate is not
            finite.
    """
    missing = [name for name in ("x", "y", "z") if name not in fields]
    if missing:
        raise MessageError(f"fields given: {', '.join(fields) or 'none'}; a cloud needs x, y and z")
    shapes = {np.shape(array) for array in fields.values()}
    if len(shapes) != 1 or len(next(iter(shapes))) != 1:
        given = ", ".join(f"{name} {np.shape(array)}" for name, array in fields.items())
        raise MessageError(f"fields given: {given}; allowed: one length (n,) for all")
    for name, array in fields.items():
        if array.dtype.name not in DATATYPES:
            raise MessageError(f"field {name!r} is {array.dtype}; allowed: {', '.join(DATATYPES)}")
    if not all(np.isfinite(fields[name]).all() for name in ("x", "y", "z")):
        raise MessageError("a coordinate of a cloud is NaN or infinite; leave such points out")
    kinds = [(name, array.dtype.newbyteorder("<")) for name, array in fields.items()]
    points = np.empty(next(iter(shapes))[0], dtype=kinds)
    for name, array in fields.items():
        points[name] = array
    field_class = message_class("sensor_msgs/msg/PointField")
    offsets: Any = points.dtype.fields
    return make_message(
        POINT_CLOUD,
        header=make_header(stamp, frame_id),
        height=1,
        width=points.size,
        fields=[field_class(name, offsets[name][1], DATATYPES[array.dtype.name], 1) for name, array in fields.items()],
        point_step=points.itemsize,
        row_step=points.nbytes,
        data=points.view(np.uint8).reshape(-1),
        is_dense=True,
    )
