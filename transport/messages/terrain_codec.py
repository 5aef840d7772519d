"""CDR payload of a TerrainMessage, a guara_msgs/Terrain, and its compact form for slow links.

The compact form is the same message with values rounded to few bits, then compressed. Rounding never makes the terrain
look better than it is: minima are rounded down, maxima, slopes, steps and variances up, clearance and traversability
down; flags are unchanged. `rounding` in the metadata states the largest errors of elevation and variance.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from transport.arrays import Array, Float
from transport.exceptions import MessageError
from transport.messages.codec import check_version, decode, encode, from_ros, to_ros
from transport.messages.shuffle import FRAME_MAGIC, compress, decompress
from transport.messages.submessages import checked_shape
from transport.messages.terrain_message import LAYERS, VERSION_MAJOR, Health, TerrainMessage
from transport.messages.typestore import TERRAIN, message_class

# Units of rounding, powers of two so that multiples are exact float32: heights (noise 0.1 mm or more), differences of
# heights and clearance [m]; slope [rad].
HEIGHT_UNIT, RELIEF_UNIT, CLEARANCE_UNIT, SLOPE_UNIT = 2.0**-13, 2.0**-12, 2.0**-10, 2.0**-9
# Bits after the leading one: a variance may become an eighth larger, a local one double, a score a 32nd smaller.
VARIANCE_BITS, LOCAL_BITS, SCORE_BITS = 3, 0, 5
# Larger multiples of a unit are not rounded: they may not fit the 23 bits of a float32.
WHOLE_NUMBERS = 2.0**23
MANTISSA_BITS = 23
# Dtypes of layers, by the field of their values; the first has number 1.
FIELDS = {f"{name}_values": np.dtype(name) for name in ("float32", "uint16", "uint8")}
TYPES = {dtype: number for number, dtype in enumerate(FIELDS.values(), start=1)}


def encode_terrain(terrain: TerrainMessage) -> bytearray:
    """CDR payload of a TerrainMessage.

    Raises:
        MessageError: a field does not fit its ROS 2 type, for example a stamp past 2038.
    """
    return encode(make_terrain(terrain))


def decode_terrain(payload: bytes | bytearray | memoryview) -> TerrainMessage:
    """Decode and check the payload of a guara_msgs/Terrain: CDR, or its compact form.

    Unknown layers are ignored. The arrays are read-only views of the CDR payload.

    Raises:
        VersionError: another major version.
        MessageError: the payload is damaged, or a length, name or value is not allowed.
    """
    if bytes(payload[:4]) == FRAME_MAGIC:
        payload = decompress(payload)
    return read_terrain(decode(payload, TERRAIN))


def _make_layer(name: str, array: Array) -> Any:
    values = (array.ravel() if dtype == array.dtype else np.zeros(0, dtype) for dtype in FIELDS.values())
    return message_class("guara_msgs/msg/TerrainLayer")(name, LAYERS[name].unit, TYPES[array.dtype], *values)


def make_terrain(terrain: TerrainMessage) -> Any:
    """Make the guara_msgs/Terrain message object of a TerrainMessage."""
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
            raise MessageError(f"layer {layer.name!r} occurs twice")
        kind = LAYERS[layer.name]
        number = TYPES[kind.dtype]
        if layer.type != number or layer.unit != kind.unit:
            raise MessageError(
                f"layer {layer.name!r} has type {layer.type} and unit {layer.unit!r}; "
                f"allowed: type {number} ({kind.dtype}) and unit {kind.unit!r}"
            )
        field, lengths = list(FIELDS)[number - 1], [len(getattr(layer, name)) for name in FIELDS]
        if lengths[number - 1] != shape[0] * shape[1] or sum(lengths) != lengths[number - 1]:
            raise MessageError(
                f"layer {layer.name!r} has {lengths} values in its three arrays; allowed: "
                f"{shape[0] * shape[1]} = ny * nx in {field} and none in the others"
            )
        layers[layer.name] = getattr(layer, field).reshape(shape)
    return layers


def _pairs(names: list[str], values: Array, what: str) -> dict[str, Any]:
    if len(names) != len(values) or len(set(names)) != len(names):
        raise MessageError(f"{what} has {len(set(names))} different names and {len(values)} values")
    return dict(zip(names, values.tolist(), strict=True))


def read_terrain(message: Any) -> TerrainMessage:
    """Make a TerrainMessage from a guara_msgs/Terrain message object; errors as in `decode_terrain`."""
    check_version(message, "terrain message", VERSION_MAJOR)
    return from_ros(
        TerrainMessage,
        message,
        layers=_read_layers(message),
        point_counts=_pairs(message.point_count_names, message.point_count_values, "point counts"),
        stage_ms=_pairs(message.stage_names, message.stage_ms, "stage times"),
        health=Health(message.health),
    )


def encode_compact(terrain: TerrainMessage) -> bytes:
    """Compact payload: CDR of the `rounded` message, compressed by `transport.messages.shuffle`.

    Raises:
        MessageError: as in `encode_terrain`.
    """
    return compress(encode_terrain(rounded(terrain)))


def rounded(terrain: TerrainMessage) -> TerrainMessage:
    """Message with every layer rounded to its safe side; idempotent."""
    layers = {name: ROUND[name](array) if name in ROUND else array for name, array in terrain.layers.items()}
    metadata = {**json.loads(terrain.metadata), "rounding": dict(ROUNDING)}
    return dataclasses.replace(terrain, layers=layers, metadata=json.dumps(metadata))


def _in_multiples(unit: float, whole: Callable[[Float], Float]) -> Callable[[Array], Array]:
    def to_multiples(values: Array) -> Array:
        count = values.astype(np.float64) / unit
        return np.where(np.abs(count) < WHOLE_NUMBERS, whole(count) * unit, values).astype(np.float32)

    return to_multiples


def _in_bits(bits: int, *, up: bool) -> Callable[[Array], Array]:
    rest = np.int32((1 << (MANTISSA_BITS - bits)) - 1)

    def to_bits(values: Array) -> Array:
        """Round values that are not negative: their order is that of their bits."""
        integers = values.view(np.int32)
        result = ((integers + rest if up else integers) & ~rest).view(np.float32)
        # Values that would become infinite or 0 are not rounded.
        return np.where(np.isfinite(result) & (result > 0.0), result, values)

    return to_bits


ROUND: Mapping[str, Callable[[Array], Array]] = MappingProxyType(
    {
        "elevation": _in_multiples(HEIGHT_UNIT, np.rint),
        "elevation_min": _in_multiples(HEIGHT_UNIT, np.floor),
        "elevation_max": _in_multiples(HEIGHT_UNIT, np.ceil),
        "variance": _in_bits(VARIANCE_BITS, up=True),
        "variance_local": _in_bits(LOCAL_BITS, up=True),
        "slope": _in_multiples(SLOPE_UNIT, np.ceil),
        "step_height": _in_multiples(RELIEF_UNIT, np.ceil),
        "roughness": _in_multiples(RELIEF_UNIT, np.ceil),
        "clearance": _in_multiples(CLEARANCE_UNIT, np.floor),
        "traversability": _in_bits(SCORE_BITS, up=False),
    }
)
# Largest error of an elevation [m], and relative excess of a variance.
ROUNDING: Mapping[str, float] = MappingProxyType({"elevation": HEIGHT_UNIT / 2, "variance": 2.0**-VARIANCE_BITS})
