"""TerrainMessage to the CDR payload of a guara_msgs/Terrain, and back with every check."""

from __future__ import annotations

from typing import Any

import numpy as np

from transport.arrays import Array
from transport.exceptions import MessageError
from transport.messages.codec import decode, encode
from transport.messages.map_origin import check_version
from transport.messages.shuffle import FRAME_MAGIC, decompress
from transport.messages.submessage_codec import from_ros, to_ros
from transport.messages.submessages import checked_shape
from transport.messages.terrain_message import LAYERS, VERSION_MAJOR, Health, TerrainMessage
from transport.messages.typestore import TERRAIN, message_class

FIELDS = ("float32_values", "uint16_values", "uint8_values")
EMPTY = tuple(np.zeros(0, dtype) for dtype in (np.float32, np.uint16, np.uint8))
TYPES = {np.dtype(np.float32): 1, np.dtype(np.uint16): 2, np.dtype(np.uint8): 3}


def encode_terrain(terrain: TerrainMessage) -> bytearray:
    """The CDR payload of one TerrainMessage.

    Raises:
        MessageError: a field does not fit its ROS 2 type, for example a stamp past 2038.
    """
    return encode(make_terrain(terrain))


def decode_terrain(payload: bytes | bytearray | memoryview) -> TerrainMessage:
    """Read and check the payload of a guara_msgs/Terrain: CDR, or its compact form (`transport.messages.compact`).

    Layers that this version does not know are ignored. The arrays are read-only views of the CDR payload.

    Raises:
        VersionError: another major version.
        MessageError: the payload is damaged, or a length, name or number is not what the message allows.
    """
    if bytes(payload[:4]) == FRAME_MAGIC:
        payload = decompress(payload)
    return read_terrain(decode(payload, TERRAIN))


def _make_layer(name: str, array: Array) -> Any:
    number = TYPES[array.dtype]
    values = list(EMPTY)
    values[number - 1] = array.ravel()
    return message_class("guara_msgs/msg/TerrainLayer")(name, LAYERS[name].unit, number, *values)


def make_terrain(terrain: TerrainMessage) -> Any:
    """The guara_msgs/Terrain message object of one TerrainMessage."""
    return to_ros(
        TERRAIN,
        terrain,
        layers=[_make_layer(name, array) for name, array in terrain.layers.items()],
        point_count_names=list(terrain.point_counts),
        point_count_values=np.array(list(terrain.point_counts.values()), dtype=np.uint64),
        stage_names=list(terrain.stage_ms),
        stage_ms=np.array(list(terrain.stage_ms.values()), dtype=np.float64),
    )


def _read_layers(message: Any) -> dict[str, Array]:
    shape = checked_shape((message.ny, message.nx), "grid")
    layers: dict[str, Array] = {}
    for layer in message.layers:
        if layer.name not in LAYERS:
            continue
        if layer.name in layers:
            raise MessageError(f"layer {layer.name!r} comes twice")
        kind = LAYERS[layer.name]
        number = TYPES[kind.dtype]
        if layer.type != number or layer.unit != kind.unit:
            raise MessageError(
                f"layer {layer.name!r} has type {layer.type} and unit {layer.unit!r}; "
                f"allowed: type {number} ({kind.dtype}) and unit {kind.unit!r}"
            )
        lengths = [len(getattr(layer, name)) for name in FIELDS]
        if lengths[number - 1] != shape[0] * shape[1] or sum(lengths) != lengths[number - 1]:
            raise MessageError(
                f"layer {layer.name!r} has {lengths} values in its three arrays; allowed: "
                f"{shape[0] * shape[1]} = ny * nx in {FIELDS[number - 1]} and none in the others"
            )
        layers[layer.name] = getattr(layer, FIELDS[number - 1]).reshape(shape)
    return layers


def _pairs(names: list[str], values: Array, what: str) -> dict[str, Any]:
    if len(names) != len(values) or len(set(names)) != len(names):
        raise MessageError(f"{what} has {len(set(names))} different names and {len(values)} values")
    return dict(zip(names, values.tolist(), strict=True))


def read_terrain(message: Any) -> TerrainMessage:
    """A checked TerrainMessage from a guara_msgs/Terrain message object; errors as in `decode_terrain`."""
    check_version(message, "terrain message", VERSION_MAJOR)
    return from_ros(
        TerrainMessage,
        message,
        layers=_read_layers(message),
        point_counts=_pairs(message.point_count_names, message.point_count_values, "point counts"),
        stage_ms=_pairs(message.stage_names, message.stage_ms, "stage times"),
        health=Health(message.health),
    )
