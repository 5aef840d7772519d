"""Topics of a recording, and the type of each."""

from __future__ import annotations

from dataclasses import dataclass

from transport.keys import check_name
from transport.messages.typestore import (
    CAMERA_INFO,
    COMPRESSED_IMAGE,
    FRAMES,
    GRID_MAP,
    IMAGE,
    MARKERS,
    OCCUPANCY,
    POINT_CLOUD,
    SCAN_END,
    SCAN_START,
    STANCE_PAUSE,
    STATUS,
    STRIPE,
    TERRAIN,
    TEXT,
)

# Type of each topic by its short name: what follows `/<robot>/`, or the whole name where no robot's stands in it.
TYPES = {
    "scan/start": SCAN_START,
    "scan/stripe": STRIPE,
    "scan/end": SCAN_END,
    "camera/on": IMAGE,
    "camera/off": IMAGE,
    "camera/on/compressed": COMPRESSED_IMAGE,
    "camera/off/compressed": COMPRESSED_IMAGE,
    "terrain": TERRAIN,
    "map": TERRAIN,
    "occupancy": OCCUPANCY,
    "grid_map": GRID_MAP,
    "status": STATUS,
    "stance": STANCE_PAUSE,
    "camera/camera_info": CAMERA_INFO,
    "scan/points": POINT_CLOUD,
    "map/points": POINT_CLOUD,
    "map/occupancy": OCCUPANCY,
    "map/grid_map": GRID_MAP,
    "markers": MARKERS,
    "/tf": FRAMES,
    "/tf_static": FRAMES,
    "/robot_description": TEXT,
}

# Topics whose last message a late subscriber wants; of the others it wants only the messages that follow.
LATCHED = frozenset(TYPES) - {
    "scan/start",
    "scan/stripe",
    "scan/end",
    "camera/on",
    "camera/off",
    "camera/on/compressed",
    "camera/off/compressed",
    "status",
    "/tf",
}

# What ROS 2 takes for no limit of time: 2^63 - 1 ns.
_ENDLESS = "{sec: 9223372036, nsec: 854775807}"

# Name of the attachment that holds the calibration.
CALIBRATION_NAME = "calibration.json"


@dataclass(frozen=True, slots=True)
class Topics:
    """Topics of one robot."""

    robot: str

    def __post_init__(self) -> None:
        """Check the name."""
        check_name(self.robot)

    def name(self, short: str) -> str:
        """Full name of a topic, as `/guara/scan/start`; KeyError for one that is not in `TYPES`."""
        if short not in TYPES:
            raise KeyError(short)
        return short if short.startswith("/") else f"/{self.robot}/{short}"


def short_name(topic: str) -> str:
    """A topic's name without the robot's, empty when nothing follows; names that hold no robot's stay as they are."""
    return topic if topic in TYPES else topic.lstrip("/").partition("/")[2]


def quality_of_service(short: str) -> str:
    """How a topic is offered, in rosbag2's YAML: `ros2 bag play` publishes it with these settings."""
    depth, durability = (1, "transient_local") if short in LATCHED else (10, "volatile")
    return "\n".join(
        (
            "- history: keep_last",
            f"  depth: {depth}",
            "  reliability: reliable",
            f"  durability: {durability}",
            f"  deadline: {_ENDLESS}",
            f"  lifespan: {_ENDLESS}",
            "  liveliness: automatic",
            f"  liveliness_lease_duration: {_ENDLESS}",
            "  avoid_ros_namespace_conventions: false",
        )
    )
