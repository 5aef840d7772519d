"""Topics of a recording and their types."""

from __future__ import annotations

from transport.keys import RANGE_IMAGES
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
    STANCE_STREAM,
    STATUS,
    STRIPE,
    TERRAIN,
    TEXT,
)

# Types of the volatile topics, by short name. Late subscribers to these topics receive only later messages. A short
# name is the part after `/<robot>/`, or the full name if it does not contain the robot.
STREAMED = {
    "scan/start": SCAN_START,
    "scan/stripe": STRIPE,
    "scan/dark": STRIPE,
    "scan/flash": STRIPE,
    "scan/end": SCAN_END,
    "camera/on": IMAGE,
    "camera/off": IMAGE,
    "camera/on/compressed": COMPRESSED_IMAGE,
    "camera/off/compressed": COMPRESSED_IMAGE,
    "status": STATUS,
    "stance_stream": STANCE_STREAM,
    "/tf": FRAMES,
}
# Types of all topics, by short name. The topics added here are transient local: late subscribers also receive the last
# message.
TYPES = STREAMED | {
    "terrain": TERRAIN,
    "map": TERRAIN,
    "occupancy": OCCUPANCY,
    "grid_map": GRID_MAP,
    "stance": STANCE_PAUSE,
    "camera/camera_info": CAMERA_INFO,
    "scan/points": POINT_CLOUD,
    "map/points": POINT_CLOUD,
    "map/occupancy": OCCUPANCY,
    "map/grid_map": GRID_MAP,
    "markers": MARKERS,
    **dict.fromkeys(RANGE_IMAGES, IMAGE),
    "/tf_static": FRAMES,
    "/robot_description": TEXT,
}

# Infinite duration in ROS 2: 2^63 - 1 ns.
_ENDLESS = "{sec: 9223372036, nsec: 854775807}"

# Name of the attachment that contains the calibration.
CALIBRATION_NAME = "calibration.json"


def full_name(short: str, robot: str) -> str:
    """Return the full name of a topic, such as `/guara/scan/start`."""
    return short if short.startswith("/") else f"/{robot}/{short}"


def short_name(topic: str) -> str:
    """Return the short name of a topic (inverse of `full_name`); empty if nothing follows the robot's name."""
    return topic if topic in TYPES else topic.lstrip("/").partition("/")[2]


def quality_of_service(short: str) -> str:
    """Return the quality of service of a topic for `ros2 bag play`, as YAML of rosbag2."""
    depth, durability = (10, "volatile") if short in STREAMED else (1, "transient_local")
    return f"""\
- history: keep_last
  depth: {depth}
  reliability: reliable
  durability: {durability}
  deadline: {_ENDLESS}
  lifespan: {_ENDLESS}
  liveliness: automatic
  liveliness_lease_duration: {_ENDLESS}
  avoid_ros_namespace_conventions: false"""
