"""Message of the steppable regions of a fused map, and its CDR payload."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from transport.arrays import Float
from transport.exceptions import MessageError
from transport.messages.codec import decode, encode
from transport.messages.map_origin import MapOrigin, check_version
from transport.messages.rotation import matrix_from_quaternion, quaternion_from_matrix
from transport.messages.submessage_codec import from_ros, make_point, to_ros
from transport.messages.submessages import checked_array, finite, set_fields
from transport.messages.typestore import QUATERNION, REGIONS, message_class

MAXIMUM_REGIONS, MAXIMUM_CORNERS = 1000, 256
# Tolerance of the length of a half-plane's normal, and of the distance of a corner outside a half-plane or off the
# plane [m].
TOLERANCE = 1e-6


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RegionMessage:
    """A convex area in which a sole may be centred, in the frame of the message that carries it.

    Attributes:
        halfspaces: (n, 3) a, b, c of a x + b y <= c, (a, b) of length 1 [m].
        vertices: (m, 3) corners on the plane, counter-clockwise [m].
        plane: (3,) p of z = p[0] x + p[1] y + p[2].
        sigma: standard deviation of the ground about the plane [m].
        area: area seen from above [m^2].
    """

    halfspaces: Float
    vertices: Float
    plane: Float
    sigma: float
    area: float

    def __post_init__(self) -> None:
        """Copy the arrays and check that half-planes and corners describe the same polygon."""
        halfspaces = checked_array(self.halfspaces, (None, 3), "half-planes of a region")
        vertices = checked_array(self.vertices, (None, 3), "corners of a region")
        for name, count in (("half-planes", len(halfspaces)), ("corners", len(vertices))):
            if not 3 <= count <= MAXIMUM_CORNERS:
                raise MessageError(f"region of {count} {name}; allowed: 3 to {MAXIMUM_CORNERS}")
        plane = checked_array(self.plane, (3,), "plane of a region")
        if np.abs(np.hypot(halfspaces[:, 0], halfspaces[:, 1]) - 1.0).max() > TOLERANCE:
            raise MessageError("a half-plane of a region has a normal whose length is not 1")
        if (vertices[:, :2] @ halfspaces[:, :2].T - halfspaces[:, 2]).max() > TOLERANCE:
            raise MessageError("a corner of a region lies outside of one of its half-planes")
        if np.abs(vertices[:, :2] @ plane[:2] + plane[2] - vertices[:, 2]).max() > TOLERANCE:
            raise MessageError("a corner of a region lies off its plane")
        if not _is_outlined(halfspaces, vertices[:, :2]):
            raise MessageError("half-planes of a region enclose more than its corners do, or these run clockwise")
        for name in ("sigma", "area"):
            value = finite(getattr(self, name), f"{name} of a region")
            if value < 0:
                raise MessageError(f"{name} of a region is {value}; allowed: 0 or more")
            set_fields(self, **{name: value})
        set_fields(self, halfspaces=halfspaces, vertices=vertices, plane=plane)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RegionsMessage(MapOrigin):
    """All steppable regions of a map.

    Attributes:
        regions: in the order in which they were found.
    """

    # Separate kind of grid for `GridJudge`, which orders the messages of each kind.
    extent: ClassVar[str] = "regions"
    type_name: ClassVar[str] = REGIONS

    regions: tuple[RegionMessage, ...]

    def __post_init__(self) -> None:
        """Check the fields."""
        # Without arguments `super` would look in the class that `slots` replaced.
        super(RegionsMessage, self).__post_init__()
        object.__setattr__(self, "regions", tuple(self.regions))
        if len(self.regions) > MAXIMUM_REGIONS:
            raise MessageError(f"{len(self.regions)} regions; allowed: up to {MAXIMUM_REGIONS}")
        if self.withdrawn and self.regions:
            raise MessageError(f"withdrawn, and yet {len(self.regions)} regions; allowed: none")


def encode_regions(message: RegionsMessage) -> bytearray:
    """The CDR payload of regions, a guara_msgs/SteppableRegions.

    Raises:
        MessageError: a field does not fit its ROS 2 type.
    """
    return encode(to_ros(REGIONS, message, regions=[_make_region(region) for region in message.regions]))


def decode_regions(payload: bytes | bytearray | memoryview) -> RegionsMessage:
    """Regions from their CDR payload.

    Raises:
        VersionError: another major version.
        MessageError: the payload is damaged, or a length or value is not allowed.
    """
    message = decode(payload, REGIONS)
    check_version(message, "regions")
    return from_ros(RegionsMessage, message, regions=tuple(_read_region(region) for region in message.regions))


def _is_outlined(halfspaces: Float, corners: Float) -> bool:
    """Check that the half-planes bound exactly the polygon of corners (m, 2), which all lie in every half-plane.

    True if every edge lies on the line of a half-plane and the edges enclose a positive area. A closed path along the
    border of an unbounded region returns on itself and encloses none.
    """
    on_line = np.abs(corners @ halfspaces[:, :2].T - halfspaces[:, 2]) <= TOLERANCE
    on_border = (on_line & np.roll(on_line, -1, axis=0)).any(axis=1)
    x, y = (corners - corners[0]).T
    return bool(on_border.all() and (x * np.roll(y, -1) - y * np.roll(x, -1)).sum() > 0.0)


def _make_region(region: RegionMessage) -> Any:
    """A guara_msgs/SteppableRegion; the x axis of the plane's frame is the x axis of the grid, projected."""
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
    point, rotation = message.plane_parameters.position, message.plane_parameters.orientation
    normal = matrix_from_quaternion((rotation.x, rotation.y, rotation.z, rotation.w), "plane_parameters of a region")[
        :, 2
    ]
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
