"""Messages derived from a fused map, with their CDR payloads: a quantised summary, and the steppable regions."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, ClassVar

import numpy as np

from transport.arrays import Array, Float
from transport.exceptions import MessageError
from transport.keys import check_name
from transport.messages.codec import (
    check_version,
    decode,
    encode,
    from_ros,
    make_point,
    to_ros,
)
from transport.messages.quaternions import matrix_from_quaternion, quaternion_from_matrix
from transport.messages.shuffle import compress, decompress
from transport.messages.submessages import checked_array, checked_origin, checked_shape, finite, frozen, set_fields
from transport.messages.terrain_message import TerrainMessage
from transport.messages.typestore import QUATERNION, REGIONS, SUMMARY, check_value, message_class

VERSION_MAJOR, VERSION_MINOR = 1, 0


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class MapOrigin:
    """Common fields of messages derived from a map; all but type and version are copied from the map's message.

    Attributes:
        type_name: ROS 2 type of the message.
        robot: instance name.
        sequence: sequence number of the map.
        step: number of the stance pause.
        stamp, scan_end: time of the map, and time of the last frame [ns since the Unix epoch].
        valid_for: time after `scan_end` during which the message may be used [s]; may be infinite.
        valid_pauses: number of pauses after `step` for which the message may be used.
        run, epoch: identities of the node's run and of the walk; empty if the map has none.
        scan_end_clock: end of the scan on the node's monotonic clock [s]; None if the map has none.
        provisional, withdrawn: as in `TerrainMessage`.
        frame_id: frame of the content.
        version: (major, minor) of the message.
        stale_because: as in `TerrainMessage`.
    """

    type_name: ClassVar[str]

    robot: str
    sequence: int
    step: int
    stamp: int
    scan_end: int
    valid_for: float
    valid_pauses: int
    run: str = ""
    epoch: str = ""
    scan_end_clock: float | None = None
    provisional: bool = False
    withdrawn: bool = False
    frame_id: str = "base_footprint"
    version: tuple[int, int] = (VERSION_MAJOR, VERSION_MINOR)
    stale_because: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Check the fields."""
        check_name(self.robot)
        for name in ("valid_for", "run", "epoch"):
            check_value(self.type_name, name, getattr(self, name))
        if self.scan_end_clock is not None:
            finite(self.scan_end_clock, "scan_end_clock")


def origin_of(terrain: TerrainMessage) -> dict[str, Any]:
    """Return the fields of `MapOrigin`, except the version, copied from the message of a map."""
    return {field.name: getattr(terrain, field.name) for field in fields(MapOrigin) if field.name != "version"}


# Value of an unknown height.
UNKNOWN_HEIGHT = -32768
# Dtypes of the layers in the payload, little endian.
LAYERS: Mapping[str, np.dtype[Any]] = {
    "heights": np.dtype("<i2"),
    "hazard": np.dtype("<u2"),
    "traversability": np.dtype("u1"),
}


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SummaryMessage(MapOrigin):
    """Quantised map: height, hazard flags and traversability of each cell.

    Attributes:
        resolution: edge length of a cell [m].
        origin: (x, y) of the corner of cell (0, 0) in `frame_id` [m].
        heights: (ny, nx) int16 [mm], `UNKNOWN_HEIGHT` where unknown.
        hazard: (ny, nx) uint16 flags.
        traversability: (ny, nx) uint8 [1/255]; 0 = not steppable.
    """

    # A separate kind of grid, so that `GridJudge` orders summaries independently of maps.
    extent: ClassVar[str] = "summary"
    type_name: ClassVar[str] = SUMMARY

    resolution: float
    origin: tuple[float, float]
    heights: Array
    hazard: Array
    traversability: Array

    def __post_init__(self) -> None:
        """Check the fields and make the arrays read-only."""
        # `super()` without arguments would refer to the class that `slots=True` replaced.
        super(SummaryMessage, self).__post_init__()
        shape = checked_shape(self.heights.shape, "summary")
        for name, dtype in LAYERS.items():
            array = getattr(self, name)
            if array.shape != shape or array.dtype != dtype:
                raise MessageError(
                    f"layer {name!r} of a summary is {array.dtype} {array.shape}; allowed: {dtype} {shape}"
                )
            set_fields(self, **{name: frozen(array)})
        if self.withdrawn and ((self.heights != UNKNOWN_HEIGHT).any() or self.traversability.any()):
            raise MessageError("summary is withdrawn, but has known cells; allowed: none")
        checked_origin(self.origin)
        check_value(SUMMARY, "resolution", finite(self.resolution, "resolution"))

    @property
    def shape(self) -> tuple[int, int]:
        """Shape (ny, nx) of the grid."""
        ny, nx = self.heights.shape
        return ny, nx


def encode_summary(summary: SummaryMessage) -> bytearray:
    """Encode a summary as CDR of guara_msgs/TerrainSummary.

    Raises:
        MessageError: a field does not fit its ROS 2 type.
    """
    packed = {
        name: np.frombuffer(compress(getattr(summary, name).tobytes(), dtype.itemsize), np.uint8)
        for name, dtype in LAYERS.items()
    }
    return encode(to_ros(SUMMARY, summary, **packed))


def decode_summary(payload: bytes | bytearray | memoryview) -> SummaryMessage:
    """Decode and check the CDR payload of a summary.

    Raises:
        VersionError: the message has another major version.
        MessageError: the payload is damaged, or a length or value is not allowed.
    """
    message = decode(payload, SUMMARY)
    check_version(message, "summary", VERSION_MAJOR)
    shape = checked_shape((message.ny, message.nx), "summary")
    layers: dict[str, Any] = {
        name: _unpack(getattr(message, name), name, dtype, shape) for name, dtype in LAYERS.items()
    }
    return from_ros(SummaryMessage, message, **layers)


def _unpack(packed: Array, name: str, dtype: np.dtype[Any], shape: tuple[int, int]) -> Array:
    size = shape[0] * shape[1] * dtype.itemsize
    plain = decompress(packed.tobytes(), dtype.itemsize, maximum=size)
    if len(plain) != size:
        raise MessageError(f"layer {name!r} of a summary has {len(plain)} bytes; ny * nx values need {size}")
    return np.frombuffer(plain, dtype).reshape(shape)


MAXIMUM_REGIONS, MAXIMUM_CORNERS = 1000, 256
# Tolerance of the length of a half-plane's normal, and of the distances of corners from half-planes and plane [m]; also
# the smallest vertical component of a plane's unit normal.
TOLERANCE = 1e-6


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RegionMessage:
    """Convex area in which the centre of a sole may be placed, in the frame of the message that contains it.

    Attributes:
        halfspaces: (n, 3) rows a, b, c of a x + b y <= c, with a^2 + b^2 = 1 and c in [m].
        vertices: (m, 3) corners of the area on the plane, counter-clockwise [m].
        plane: (3,) coefficients p of z = p[0] x + p[1] y + p[2].
        sigma: standard deviation of the ground relative to the plane, including measurement errors [m].
        area: horizontal area [m^2].
    """

    halfspaces: Float
    vertices: Float
    plane: Float
    sigma: float
    area: float

    def __post_init__(self) -> None:
        """Copy and check the fields; half-planes and corners must describe the same polygon."""
        halfspaces = checked_array(self.halfspaces, (None, 3), "half-planes of a region")
        vertices = checked_array(self.vertices, (None, 3), "corners of a region")
        for name, count in (("half-planes", len(halfspaces)), ("corners", len(vertices))):
            if not 3 <= count <= MAXIMUM_CORNERS:
                raise MessageError(f"region of {count} {name}; allowed: 3 to {MAXIMUM_CORNERS}")
        plane = checked_array(self.plane, (3,), "plane of a region")
        if np.abs(np.hypot(halfspaces[:, 0], halfspaces[:, 1]) - 1.0).max() > TOLERANCE:
            raise MessageError("a half-plane of a region has a normal whose length is not 1")
        if (vertices[:, :2] @ halfspaces[:, :2].T - halfspaces[:, 2]).max() > TOLERANCE:
            raise MessageError("a corner of a region is outside one of its half-planes")
        if np.abs(vertices[:, :2] @ plane[:2] + plane[2] - vertices[:, 2]).max() > TOLERANCE:
            raise MessageError("a corner of a region is not on its plane")
        if not _is_outlined(halfspaces, vertices[:, :2]):
            raise MessageError("half-planes of a region enclose more than its corners do, or the corners are clockwise")
        for name in ("sigma", "area"):
            value = finite(getattr(self, name), f"{name} of a region")
            if value < 0:
                raise MessageError(f"{name} of a region is {value}; allowed: 0 or more")
            set_fields(self, **{name: value})
        set_fields(self, halfspaces=halfspaces, vertices=vertices, plane=plane)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RegionsMessage(MapOrigin):
    """Steppable regions of a map.

    Attributes:
        regions: the regions, in the order given by the sender.
    """

    # A separate kind of grid, as in `SummaryMessage`.
    extent: ClassVar[str] = "regions"
    type_name: ClassVar[str] = REGIONS

    regions: tuple[RegionMessage, ...]

    def __post_init__(self) -> None:
        """Check the fields."""
        super(RegionsMessage, self).__post_init__()
        set_fields(self, regions=tuple(self.regions))
        if len(self.regions) > MAXIMUM_REGIONS:
            raise MessageError(f"{len(self.regions)} regions; allowed: up to {MAXIMUM_REGIONS}")
        if self.withdrawn and self.regions:
            raise MessageError(f"message is withdrawn, but has {len(self.regions)} regions; allowed: none")


def encode_regions(message: RegionsMessage) -> bytearray:
    """Encode regions as CDR of guara_msgs/SteppableRegions.

    Raises:
        MessageError: a field does not fit its ROS 2 type.
    """
    return encode(to_ros(REGIONS, message, regions=[_make_region(region) for region in message.regions]))


def decode_regions(payload: bytes | bytearray | memoryview) -> RegionsMessage:
    """Decode and check the CDR payload of regions.

    Raises:
        VersionError: the message has another major version.
        MessageError: the payload is damaged, or a length or value is not allowed.
    """
    message = decode(payload, REGIONS)
    check_version(message, "regions", VERSION_MAJOR)
    return from_ros(RegionsMessage, message, regions=tuple(_read_region(region) for region in message.regions))


def _is_outlined(halfspaces: Float, corners: Float) -> bool:
    """Check that half-planes bound exactly the polygon of the corners (m, 2), which must lie inside every half-plane.

    This is the case if every edge lies on the border of a half-plane and the edges enclose a positive area: if the
    region were unbounded, a closed path along its border would run back along itself and enclose no area.
    """
    on_line = np.abs(corners @ halfspaces[:, :2].T - halfspaces[:, 2]) <= TOLERANCE
    on_border = (on_line & np.roll(on_line, -1, axis=0)).any(axis=1)
    x, y = (corners - corners[0]).T
    return bool(on_border.all() and (x * np.roll(y, -1) - y * np.roll(x, -1)).sum() > 0.0)


def _make_region(region: RegionMessage) -> Any:
    """Convert to guara_msgs/SteppableRegion.

    The x axis of the plane's pose is the x axis of the grid, projected vertically onto the plane.
    """
    x, y = region.vertices[:, :2].mean(axis=0)
    a, b, c = region.plane
    normal = np.array([-a, -b, 1.0]) / math.sqrt(a * a + b * b + 1.0)
    ahead = np.array([1.0, 0.0, a]) / math.hypot(1.0, a)
    rotation = np.column_stack((ahead, np.cross(normal, ahead), normal))
    orientation = message_class(QUATERNION)(*quaternion_from_matrix(rotation))
    pose = message_class("geometry_msgs/msg/Pose")(make_point(x, y, a * x + b * y + c), orientation)
    corners = [make_point(*corner) for corner in region.vertices.tolist()]
    halfspaces = region.halfspaces.ravel().copy()
    return to_ros(
        "guara_msgs/msg/SteppableRegion", region, plane_parameters=pose, boundary=corners, halfspaces=halfspaces
    )


def _read_region(message: Any) -> RegionMessage:
    point, q = message.plane_parameters.position, message.plane_parameters.orientation
    normal = matrix_from_quaternion((q.x, q.y, q.z, q.w), "plane_parameters of a region")[:, 2]
    if not normal[2] > TOLERANCE:
        raise MessageError("the plane of a region does not face upwards")
    a, b = -normal[:2] / normal[2]
    if len(message.halfspaces) % 3:
        raise MessageError(f"half-planes of a region have {len(message.halfspaces)} numbers; allowed: 3 for each")
    return RegionMessage(
        halfspaces=message.halfspaces.reshape(-1, 3),
        vertices=np.array([(p.x, p.y, p.z) for p in message.boundary], np.float64).reshape(-1, 3),
        plane=np.array([a, b, point.z - a * point.x - b * point.y]),
        sigma=message.sigma,
        area=message.area,
    )
