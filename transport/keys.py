"""Zenoh keys of all messages, queryables and liveliness tokens."""

from __future__ import annotations

import re
from functools import partial

from transport.exceptions import KeyNameError, check_choice

# Default instance name of a robot.
DEFAULT_ROBOT = "guara"

# Major version of all keys below `<robot>/perception`; another major version has other keys.
PERCEPTION_VERSION = "v1"

# Name of the perception node's liveliness token.
NODE_ROLE = "node"

# Encodings of Terrain messages.
ENCODINGS = ("lossless", "compact")

NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_\-]*")


def check_name(name: str, what: str = "robot") -> str:
    """Check that a name can be one chunk of a key; return the name.

    Args:
        name: name to check, such as the instance name of a robot.
        what: what the name belongs to, for the error message.

    Raises:
        KeyNameError: the name does not consist of ASCII letters, digits, `_` and `-`, or begins with `-`.
    """
    if not isinstance(name, str) or NAME.fullmatch(name) is None:
        raise KeyNameError(
            f"{what} name {name!r} cannot be part of a key; use letters, digits, '_' and '-', "
            f"starting with a letter, a digit or '_'"
        )
    return name


def perception_prefix(robot: str = DEFAULT_ROBOT) -> str:
    """Key prefix of everything that the perception node publishes, without a trailing slash."""
    return f"{check_name(robot)}/perception/{PERCEPTION_VERSION}"


def check_encoding(encoding: str) -> str:
    """Check an encoding of Terrain messages; return the encoding.

    Raises:
        KeyNameError: the encoding is not in `ENCODINGS`.
    """
    check_choice("encoding", encoding, ENCODINGS, KeyNameError)
    return encoding


def terrain_key(robot: str = DEFAULT_ROBOT, extent: str = "footprint", encoding: str = "lossless") -> str:
    """Key of the Terrain messages of one extent: "footprint" (one scan) or "map" (fused).

    Args:
        robot: instance name.
        extent: "footprint" or "map".
        encoding: "lossless", or "compact" for slow links (see `transport.messages.terrain_message`).

    Raises:
        KeyNameError: extent or encoding is unknown, or the robot name cannot be part of a key.
    """
    names = {"footprint": "terrain", "map": "map"}
    check_choice("extent", extent, names, KeyNameError)
    below = "/compact" if check_encoding(encoding) == "compact" else ""
    return f"{perception_prefix(robot)}{below}/{names[extent]}"


def perception_key(name: str, robot: str = DEFAULT_ROBOT) -> str:
    """Key that consists of `perception_prefix` and `name`."""
    return f"{perception_prefix(robot)}/{name}"


# nav_msgs/OccupancyGrid and grid_map_msgs/GridMap of the last scan.
occupancy_key = partial(perception_key, "occupancy")
grid_map_key = partial(perception_key, "grid_map")
# Steppable regions of the newest map, and its summary for slow links.
regions_key = partial(perception_key, "regions")
summary_key = partial(perception_key, "summary")
# Queryables for scan requests, and for queries of the newest grid or a region of it.
scan_key = partial(perception_key, "scan")
query_key = partial(perception_key, "query")
# diagnostic_msgs/DiagnosticArray of the node, and its liveliness token.
status_key = partial(perception_key, "status")
alive_key = partial(perception_key, f"@alive/{NODE_ROLE}")
# Points of the last scan, and the camera image of one of its stripes, for viewers.
points_key = partial(perception_key, "points")
picture_key = partial(perception_key, "picture")


def grid_keys(robot: str = DEFAULT_ROBOT) -> tuple[str, ...]:
    """Keys of all grids and of the regions of the map, which are both published and queryable."""
    terrain = (terrain_key(robot, extent, encoding) for extent in ("footprint", "map") for encoding in ENCODINGS)
    return (*terrain, occupancy_key(robot), grid_map_key(robot), regions_key(robot))


def alive_keys_of_all_versions(robot: str = DEFAULT_ROBOT) -> str:
    """Key expression of the liveliness tokens of a robot's nodes, of any major version."""
    return f"{check_name(robot)}/perception/*/@alive/{NODE_ROLE}"


def run_key(robot: str = DEFAULT_ROBOT, run: str = "*") -> str:
    """Key of the liveliness token of one run of the node; run `*` matches all."""
    return f"{perception_prefix(robot)}/@alive/run/{run}"


def claim_key(robot: str = DEFAULT_ROBOT, run: str = "*") -> str:
    """Key of the liveliness token with which a node claims its name; run `*` matches all."""
    return f"{perception_prefix(robot)}/@alive/claim/{run}"


def gait_key(name: str, robot: str = DEFAULT_ROBOT) -> str:
    """Key of what the gait controller publishes or answers under `name`."""
    return f"{check_name(robot)}/gait/v1/{name}"


# Stance pauses, and the stream of joint samples.
stance_key = partial(gait_key, "stance")
stance_stream_key = partial(gait_key, "stance_stream")
# Queryable that returns the current time of the clock that stamps the stance pauses.
gait_clock_key = partial(gait_key, "clock")

# Names of the orthorectified range image, the causes of its unknown pixels, and its standard deviations.
RANGE_IMAGES = ("range_image", "range_image_causes", "range_image_sigma")

# Key expressions of the status and the liveliness tokens of all robots.
FLEET_STATUS = f"*/perception/{PERCEPTION_VERSION}/status"
FLEET_ALIVE = f"*/perception/{PERCEPTION_VERSION}/@alive/{NODE_ROLE}"


def robot_of(key: str) -> str:
    """Instance name of the robot in a key."""
    return key.partition("/")[0]
