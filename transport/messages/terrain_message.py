"""Terrain message: all layers of a grid with geometry, stance and validity; encoding as plain or compact CDR."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from enum import IntEnum
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from transport.arrays import Array, Float
from transport.exceptions import MessageError, check_choice
from transport.keys import check_name
from transport.messages.codec import check_version, decode, encode, from_ros, to_ros
from transport.messages.shuffle import FRAME_MAGIC, compress, decompress
from transport.messages.submessages import (
    ObstacleMessage,
    StanceMessage,
    TransformMessage,
    checked_origin,
    checked_shape,
    finite,
    frozen,
    set_fields,
    texts,
)
from transport.messages.typestore import TERRAIN, check_value, message_class

VERSION_MAJOR = 1
VERSION_MINOR = 0
EXTENTS = ("footprint", "map")
MODES = ("coarse", "standard")
ATTITUDE_SOURCES = ("imu", "odometry", "support_plane", "level")
# Longest identity of a walk or run [characters].
MAXIMUM_IDENTITY = 100
# Rounding units of elevations, of step height and roughness, of clearance (all in [m]), and of slopes [rad]: powers of
# two, so that their multiples are exact in float32. The unit of elevations is 0.12 mm; their noise is at least 0.1 mm.
HEIGHT_UNIT, RELIEF_UNIT, CLEARANCE_UNIT, SLOPE_UNIT = 2.0**-13, 2.0**-12, 2.0**-10, 2.0**-9
# Mantissa bits kept when rounding: a variance grows by at most 1/8, a local variance at most doubles, a traversability
# shrinks by at most 1/32.
VARIANCE_BITS, LOCAL_BITS, SCORE_BITS = 3, 0, 5
# Values of this many units or more are not rounded: a float32 has 23 mantissa bits, so they are already multiples.
WHOLE_NUMBERS = 2.0**23
MANTISSA_BITS = 23
# Dtype of a layer by the message field that holds its values. Messages number the types from 1 in this order.
FIELDS = {f"{name}_values": np.dtype(name) for name in ("float32", "uint16", "uint8")}
TYPES = {dtype: number for number, dtype in enumerate(FIELDS.values(), start=1)}


class LayerKind(NamedTuple):
    """Type of a layer: dtype of its array and unit of its values."""

    dtype: np.dtype[Any]
    unit: str


FLOAT = np.dtype(np.float32)
# Layers of a Terrain message of this major version. All are required, except those that `_check_grid` fills in; other
# layers are ignored.
LAYERS: Mapping[str, LayerKind] = MappingProxyType(
    {
        "elevation": LayerKind(FLOAT, "m"),
        "variance": LayerKind(FLOAT, "m^2"),
        "variance_local": LayerKind(FLOAT, "m^2"),
        "elevation_min": LayerKind(FLOAT, "m"),
        "elevation_max": LayerKind(FLOAT, "m"),
        "slope": LayerKind(FLOAT, "rad"),
        "step_height": LayerKind(FLOAT, "m"),
        "roughness": LayerKind(FLOAT, "m"),
        "clearance": LayerKind(FLOAT, "m"),
        "traversability": LayerKind(FLOAT, "1"),
        "hazard": LayerKind(np.dtype(np.uint16), "flags"),
        "age": LayerKind(np.dtype(np.uint8), "pauses"),
        "looks": LayerKind(np.dtype(np.uint8), "scans"),
        "ceiling": LayerKind(FLOAT, "m"),
    }
)


# Values of layers in an unscanned cell; the layers not listed are NaN. The value of `hazard` is the flag UNSCANNED.
EMPTY = {"clearance": 0.0, "traversability": 0.0, "hazard": 4, "age": 255, "looks": 0}


class Health(IntEnum):
    """Health of a scan or of the node, with the numbers of diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


def _check_layer(name: str, array: Array, shape: tuple[int, int]) -> Array:
    kind = LAYERS[name]
    if not isinstance(array, np.ndarray) or array.dtype != kind.dtype:
        given = array.dtype if isinstance(array, np.ndarray) else type(array).__name__
        raise MessageError(f"layer {name!r} is {given}; allowed: {kind.dtype}")
    if array.shape != shape:
        raise MessageError(f"layer {name!r} has shape {array.shape}; allowed: (ny, nx) = {shape}")
    return frozen(array)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class TerrainMessage:
    """Grid of one scan (extent "footprint"), or snapshot of the fused map (extent "map").

    Cell (0, 0) is at the corner of minimum x and y. The centre of cell (iy, ix) is
    `origin + (ix + 0.5, iy + 0.5) * resolution` in `frame_id`.

    Attributes:
        robot: instance name.
        extent: "footprint" or "map".
        sequence: number of the message, ascending from 1 within its extent and run; numbers may be skipped.
        step: number of the stance pause.
        stamp: end of the scan; time of the withdrawal for a withdrawn grid [ns since the Unix epoch].
        scan_start: time of the first frame [ns].
        scan_end: time of the last frame [ns].
        valid_for: time after `scan_end` during which the grid may be used [s]; may be infinite.
        valid_pauses: number of pauses after `step` for which the grid may be used.
        mode: "coarse" or "standard".
        method: stripe extraction method.
        calibration_hash: hash of the calibration.
        resolution: edge length of a cell [m].
        origin: (x, y) of the corner of cell (0, 0) [m].
        layers: read-only arrays of shape (ny, nx), with the dtypes of `LAYERS`; values of unknown cells are NaN, except
            in the layers of `EMPTY` and in `ceiling`, which is an upper bound of unknown heights.
        stance: posture during the scan.
        attitude_source: source of the body's attitude: "imu", "odometry", "support_plane" or "level".
        transforms: transforms at the time of the scan.
        obstacles: obstacles and holes.
        point_counts: number of image columns of all stripes by status, such as OK or DROPOUT.
        stage_ms: processing time by stage [ms].
        coverage: fraction of cells that are known, 0 ... 1. For a processed scan, cells flagged UNSCANNED, OCCLUDED or
            SELF are excluded from the total.
        health: health of the grid.
        health_reasons: reasons why `health` is not OK.
        metadata: text of a JSON object.
        frame_id: frame of the grid.
        version: (major, minor) of the message.
        epoch: identity of the walk, from the metadata; may be empty.
        run: identity of the run of the sending node, from the metadata; may be empty.
        provisional: True until the node confirms that the robot stood still during the scan; from the metadata.
        refinement_follows: True if a finer grid of the same pause follows; from the metadata.
        withdrawn: True if this message withdraws an earlier grid; all its cells are then unknown. From the metadata.
        scan_end_clock: end of the scan on the node's monotonic clock [s], from the metadata; may be None.
        stale_because: reasons why the grid is stale although the client returned it; set by the client, never sent.
    """

    robot: str
    extent: str
    sequence: int
    step: int
    stamp: int
    scan_start: int
    scan_end: int
    valid_for: float
    valid_pauses: int
    mode: str
    method: str
    calibration_hash: str
    resolution: float
    origin: tuple[float, float]
    layers: Mapping[str, Array]
    stance: StanceMessage
    attitude_source: str
    transforms: tuple[TransformMessage, ...] = ()
    obstacles: tuple[ObstacleMessage, ...] = ()
    point_counts: Mapping[str, int] = field(default_factory=dict)
    stage_ms: Mapping[str, float] = field(default_factory=dict)
    coverage: float = 0.0
    health: Health = Health.OK
    health_reasons: tuple[str, ...] = ()
    metadata: str = "{}"
    frame_id: str = "base_footprint"
    version: tuple[int, int] = (VERSION_MAJOR, VERSION_MINOR)
    stale_because: tuple[str, ...] = ()
    epoch: str = field(init=False, default="")
    run: str = field(init=False, default="")
    provisional: bool = field(init=False, default=False)
    refinement_follows: bool = field(init=False, default=False)
    withdrawn: bool = field(init=False, default=False)
    scan_end_clock: float | None = field(init=False, default=None)

    def __post_init__(self) -> None:
        """Check the fields, and make read-only copies of mutable values.

        Raises:
            MessageError: a value is not allowed; the error message names the field.
            KeyNameError: the robot's name cannot be part of a key.
        """
        check_name(self.robot)
        for name, allowed in (("extent", EXTENTS), ("mode", MODES), ("attitude_source", ATTITUDE_SOURCES)):
            check_choice(name, getattr(self, name), allowed)
        for name in ("sequence", "valid_for", "valid_pauses", "coverage", "health"):
            check_value(TERRAIN, name, getattr(self, name))
        if self.scan_end < self.scan_start:
            raise MessageError(f"scan_end {self.scan_end} ns is before scan_start {self.scan_start} ns")
        self._check_grid()
        self._freeze_details()

    def _check_grid(self) -> None:
        resolution = finite(self.resolution, "resolution")
        check_value(TERRAIN, "resolution", resolution)
        origin = checked_origin(self.origin)
        given = dict(self.layers)
        if "variance" in given:
            # Nodes of earlier versions send only the total variance, and the message of a scan omits its empty ceiling.
            given.setdefault("variance_local", given["variance"])
            given.setdefault("ceiling", np.full(np.shape(given["variance"]), np.nan, np.float32))
        missing = [name for name in LAYERS if name not in given]
        if missing:
            raise MessageError(f"missing layers: {', '.join(missing)}; needed: {', '.join(LAYERS)}")
        shape = checked_shape(np.shape(self.layers["elevation"]), "layer 'elevation'")
        layers = {name: _check_layer(name, given[name], shape) for name in LAYERS}
        set_fields(self, resolution=resolution, origin=origin, layers=MappingProxyType(layers))

    def _freeze_details(self) -> None:
        reasons = texts(self.health_reasons, "health_reasons")
        set_fields(self, transforms=tuple(self.transforms), obstacles=tuple(self.obstacles), health_reasons=reasons)
        counts = {str(name): int(count) for name, count in self.point_counts.items()}
        if any(not 0 <= count < 2**64 for count in counts.values()):
            raise MessageError(f"point_counts are {counts}; allowed: 0 to 2^64 - 1")
        stages = {str(name): finite(ms, f"time of stage {name!r}") for name, ms in self.stage_ms.items()}
        set_fields(self, point_counts=MappingProxyType(counts), stage_ms=MappingProxyType(stages))
        set_fields(self, health=Health(int(self.health)))
        try:
            data = json.loads(self.metadata)
        except (TypeError, ValueError, RecursionError) as error:
            raise MessageError(f"metadata is not JSON text: {error}") from error
        if not isinstance(data, dict):
            raise MessageError("metadata is JSON, but not an object; write it as {...}")
        self._take_from(data)

    def _take_from(self, data: Mapping[str, Any]) -> None:
        """Set the fields that are sent in the metadata, where receivers of earlier versions ignore them."""
        for name in ("epoch", "run"):
            text = data.get(name, "")
            if not isinstance(text, str) or len(text) > MAXIMUM_IDENTITY:
                raise MessageError(
                    f"{name} in the metadata is {text!r}; allowed: text of up to {MAXIMUM_IDENTITY} characters"
                )
            set_fields(self, **{name: text})
        for name in ("provisional", "refinement_follows", "withdrawn"):
            flag = data.get(name, False)
            if not isinstance(flag, bool):
                raise MessageError(f"{name} in the metadata is {flag!r}; allowed: true or false")
            set_fields(self, **{name: flag})
        if self.withdrawn and (np.isfinite(self.layers["elevation"]).any() or self.layers["traversability"].any()):
            raise MessageError("grid is withdrawn, but has known cells; allowed: none")
        if data.get("scan_end_clock") is not None:
            set_fields(self, scan_end_clock=finite(data["scan_end_clock"], "scan_end_clock in the metadata"))

    @property
    def shape(self) -> tuple[int, int]:
        """Shape (ny, nx) of every layer."""
        ny, nx = self.layers["elevation"].shape
        return ny, nx

    def emptied(self, stamp: int, reason: str) -> TerrainMessage:
        """Return a withdrawn copy with all cells unknown, for readers that cannot tell when a grid becomes invalid.

        Args:
            stamp: stamp of the copy [ns since the Unix epoch].
            reason: reason for the withdrawal, the only entry of `health_reasons`.
        """
        layers = {name: np.full(self.shape, EMPTY.get(name, np.nan), kind.dtype) for name, kind in LAYERS.items()}
        withdrawn = {**json.loads(self.metadata), "provisional": False, "withdrawn": True}
        return replace(
            self,
            stamp=stamp,
            layers=layers,
            obstacles=(),
            coverage=0.0,
            health=Health.STALE,
            health_reasons=(reason,),
            metadata=json.dumps(withdrawn),
        )


def crop_terrain(terrain: TerrainMessage, region: tuple[float, float, float, float]) -> TerrainMessage:
    """Crop a grid to the cells that overlap a region.

    Values are not recomputed: `clearance`, for example, still refers to the border of the whole grid. All obstacles are
    kept, even those outside the region.

    Args:
        terrain: the whole grid.
        region: (x_min, x_max, y_min, y_max) in the frame of the grid [m].

    Raises:
        MessageError: the region is empty or outside the grid.
    """
    ny, nx = terrain.shape
    x_min, x_max, y_min, y_max = region
    edge, (x0, y0) = terrain.resolution, terrain.origin
    # A tolerance of 1e-9 cells: rounding of a limit at the border of a cell must not add the neighbouring cell.
    first_x, first_y = (max(0, math.floor((low - o) / edge + 1e-9)) for low, o in ((x_min, x0), (y_min, y0)))
    last_x = min(nx, math.ceil((x_max - x0) / edge - 1e-9))
    last_y = min(ny, math.ceil((y_max - y0) / edge - 1e-9))
    if first_x >= last_x or first_y >= last_y:
        raise MessageError(
            f"region x {x_min:g} ... {x_max:g}, y {y_min:g} ... {y_max:g} m is empty or outside the grid, which covers "
            f"x {x0:g} ... {x0 + nx * edge:g}, y {y0:g} ... {y0 + ny * edge:g} m"
        )
    layers = {name: array[first_y:last_y, first_x:last_x].copy() for name, array in terrain.layers.items()}
    return replace(terrain, layers=layers, origin=(x0 + first_x * edge, y0 + first_y * edge))


def encode_terrain(terrain: TerrainMessage) -> bytearray:
    """Encode a TerrainMessage as CDR.

    Raises:
        MessageError: a field does not fit its ROS 2 type, for example a stamp after 2038-01-19.
    """
    return encode(make_terrain(terrain))


def decode_terrain(payload: bytes | bytearray | memoryview) -> TerrainMessage:
    """Decode and check the payload of a guara_msgs/Terrain, plain CDR or compressed.

    Unknown layers are ignored. The arrays are read-only.

    Raises:
        VersionError: the message has another major version.
        MessageError: the payload is damaged, or a length, name or value is not allowed.
    """
    if bytes(payload[:4]) == FRAME_MAGIC:
        payload = decompress(payload)
    return read_terrain(decode(payload, TERRAIN))


def _make_layer(name: str, array: Array) -> Any:
    values = (array.ravel() if dtype == array.dtype else np.zeros(0, dtype) for dtype in FIELDS.values())
    return message_class("guara_msgs/msg/TerrainLayer")(name, LAYERS[name].unit, TYPES[array.dtype], *values)


def _is_absent(name: str, array: Array) -> bool:
    """Return True if a layer is not sent: a ceiling without any value, as in every scan."""
    return name == "ceiling" and bool(np.isnan(array).all())


def make_terrain(terrain: TerrainMessage) -> Any:
    """Convert a TerrainMessage to a guara_msgs/Terrain message object."""
    return to_ros(
        TERRAIN,
        terrain,
        layers=[_make_layer(name, array) for name, array in terrain.layers.items() if not _is_absent(name, array)],
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
        raise MessageError(
            f"{what}: {len(set(names))} distinct names, {len(values)} values; allowed: one value per name"
        )
    return dict(zip(names, values.tolist(), strict=True))


def read_terrain(message: Any) -> TerrainMessage:
    """Convert a guara_msgs/Terrain message object to a TerrainMessage; errors as in `decode_terrain`."""
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
    """Encode a message in the compact form: CDR of the `rounded` message, compressed by `transport.messages.shuffle`.

    Raises:
        MessageError: as in `encode_terrain`.
    """
    return compress(encode_terrain(rounded(terrain)))


def rounded(terrain: TerrainMessage) -> TerrainMessage:
    """Return a copy with rounded float32 layers; rounding it again changes nothing.

    Elevations are rounded to the nearest unit, other layers conservatively. `ROUNDING` is added to the metadata.
    """
    layers = {name: ROUND[name](array) if name in ROUND else array for name, array in terrain.layers.items()}
    metadata = {**json.loads(terrain.metadata), "rounding": dict(ROUNDING)}
    return replace(terrain, layers=layers, metadata=json.dumps(metadata))


def _in_multiples(unit: float, whole: Callable[[Float], Float]) -> Callable[[Array], Array]:
    def to_multiples(values: Array) -> Array:
        count = values.astype(np.float64) / unit
        return np.where(np.abs(count) < WHOLE_NUMBERS, whole(count) * unit, values).astype(np.float32)

    return to_multiples


def _in_bits(bits: int, *, up: bool) -> Callable[[Array], Array]:
    rest = np.int32((1 << (MANTISSA_BITS - bits)) - 1)

    def to_bits(values: Array) -> Array:
        """Round non-negative values, whose bit patterns are in the same order as the values."""
        integers = values.view(np.int32)
        result = ((integers + rest if up else integers) & ~rest).view(np.float32)
        # Do not round a value that would become 0 or infinite.
        return np.where(np.isfinite(result) & (result > 0.0), result, values)

    return to_bits


ROUND: Mapping[str, Callable[[Array], Array]] = MappingProxyType(
    {
        "elevation": _in_multiples(HEIGHT_UNIT, np.rint),
        "elevation_min": _in_multiples(HEIGHT_UNIT, np.floor),
        "elevation_max": _in_multiples(HEIGHT_UNIT, np.ceil),
        "ceiling": _in_multiples(HEIGHT_UNIT, np.ceil),
        "variance": _in_bits(VARIANCE_BITS, up=True),
        "variance_local": _in_bits(LOCAL_BITS, up=True),
        "slope": _in_multiples(SLOPE_UNIT, np.ceil),
        "step_height": _in_multiples(RELIEF_UNIT, np.ceil),
        "roughness": _in_multiples(RELIEF_UNIT, np.ceil),
        "clearance": _in_multiples(CLEARANCE_UNIT, np.floor),
        "traversability": _in_bits(SCORE_BITS, up=False),
    }
)
# Largest rounding error of an elevation [m], and largest relative increase of the layer `variance`.
ROUNDING: Mapping[str, float] = MappingProxyType({"elevation": HEIGHT_UNIT / 2, "variance": 2.0**-VARIANCE_BITS})
