"""Obstacles and footholds as the message type that ROS 2 tools draw: visualization_msgs/MarkerArray."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from transport.messages.codec import make_header
from transport.messages.submessage_codec import make_point
from transport.messages.submessages import ObstacleMessage, Point
from transport.messages.typestore import MARKERS, make_message

CUBE, LINE_LIST, TEXT_VIEW_FACING = 1, 5, 9
ADD, DELETE_ALL = 0, 3
MARKER = "visualization_msgs/msg/Marker"
# Red, green, blue; the colours of steps, footholds and steppable regions in pictures and in the browser.
OBSTACLE_COLOUR, FOOTHOLD_COLOUR, REGION_COLOUR = (0.835, 0.369, 0.0), (0.0, 0.447, 0.698), (0.0, 0.35, 0.24)
# [m]
LINE_SCALE, TEXT_HEIGHT, SOLE_THICKNESS = (0.003, 0.0, 0.0), 0.018, 0.004


def markers_message(
    obstacles: Sequence[ObstacleMessage],
    footholds: Mapping[str, Point],
    sole: tuple[float, float],
    frame_id: str,
    stamp: int,
    regions: Sequence[npt.NDArray[np.float64]] = (),
) -> Any:
    """A visualization_msgs/MarkerArray message object: it replaces whatever was drawn before.

    Namespaces are `obstacles` (edges of each, from its surroundings to its top, or down to the bottom of a hole),
    `heights` (their heights in millimetres), `footholds` (a sole for each leg) and `regions` (the outline of each).

    Args:
        obstacles: what stands out of the terrain.
        footholds: (x, y, z) [m] by leg.
        sole: length (x) and width (y) [m].
        frame_id: frame of all.
        stamp: [ns] since the epoch.
        regions: corners (n, 3) of each steppable region [m].
    """
    header = make_header(stamp, frame_id)
    markers = [_marker(header, "", 0, CUBE, action=DELETE_ALL, scale=(1.0, 1.0, 1.0))]
    if obstacles:
        edges = [make_point(*point) for item in obstacles for point in _edges(item)]
        markers.append(_marker(header, "obstacles", 0, LINE_LIST, scale=LINE_SCALE, points=edges))
    for number, item in enumerate(obstacles):
        x, y, z = item.position
        label = f"{1000.0 * item.height:+.0f} mm"
        position = (x, y, max(z, z - item.height) + TEXT_HEIGHT)
        scale = (0.0, 0.0, TEXT_HEIGHT)
        markers.append(_marker(header, "heights", number, TEXT_VIEW_FACING, position=position, scale=scale, text=label))
    for number, (x, y, z) in enumerate(footholds.values()):
        scale, position = (*sole, SOLE_THICKNESS), (x, y, z + 0.5 * SOLE_THICKNESS)
        sole_marker = _marker(header, "footholds", number, CUBE, position=position, scale=scale, colour=FOOTHOLD_COLOUR)
        markers.append(sole_marker)
    if regions:
        edges = [make_point(*point) for corners in regions for pair in _sides(corners) for point in pair]
        markers.append(_marker(header, "regions", 0, LINE_LIST, scale=LINE_SCALE, points=edges, colour=REGION_COLOUR))
    return make_message(MARKERS, markers=markers)


def _sides(corners: npt.NDArray[np.float64]) -> list[tuple[Point, Point]]:
    """Both ends of each side of a polygon (n, 3)."""
    points: list[Point] = [(x, y, z) for x, y, z in corners.tolist()]
    return list(zip(points, [*points[1:], points[0]], strict=True))


def _edges(item: ObstacleMessage) -> list[Point]:
    """Pairs of points: the outline above, the outline below, and what joins them at the corners."""
    top, bottom = item.position[2], item.position[2] - item.height
    corners = np.asarray(item.outline)
    points: list[Point] = []
    for (x, y), (next_x, next_y) in zip(corners.tolist(), np.roll(corners, -1, axis=0).tolist(), strict=True):
        for z in (top, bottom):
            points += [(x, y, z), (next_x, next_y, z)]
        points += [(x, y, top), (x, y, bottom)]
    return points


def _marker(
    header: Any,
    namespace: str,
    number: int,
    kind: int,
    *,
    position: Point = (0.0, 0.0, 0.0),
    scale: Point,
    action: int = ADD,
    colour: Point = OBSTACLE_COLOUR,
    points: Sequence[Any] = (),
    text: str = "",
) -> Any:
    red, green, blue = colour
    return make_message(
        MARKER,
        header=header,
        ns=namespace,
        id=number,
        type=kind,
        action=action,
        pose=make_message("geometry_msgs/msg/Pose", position=make_point(*position)),
        scale=make_message("geometry_msgs/msg/Vector3", **dict(zip("xyz", map(float, scale), strict=True))),
        color=make_message("std_msgs/msg/ColorRGBA", r=red, g=green, b=blue, a=1.0),
        points=list(points),
        text=text,
    )
