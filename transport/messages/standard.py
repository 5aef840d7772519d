"""Message objects of standard ROS 2 types for viewers and tools: grids, clouds, markers, transforms, camera, text."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from transport.arrays import Array, Percent
from transport.exceptions import MessageError
from transport.messages.codec import make_header, make_point, make_time, make_transform
from transport.messages.submessages import (
    ObstacleMessage,
    Point,
    TransformMessage,
    checked_array,
    checked_origin,
    finite,
)
from transport.messages.typestore import (
    CAMERA_INFO,
    FRAMES,
    GRID_MAP,
    MARKERS,
    OCCUPANCY,
    POINT_CLOUD,
    TEXT,
    make_message,
    message_class,
)

# Layer that determines which cells of a GridMap are known.
BASIC_LAYER = "elevation"


def _geometry(resolution: float, origin: Sequence[float]) -> tuple[float, float, float]:
    edge = finite(resolution, "resolution")
    if edge <= 0.0:
        raise MessageError(f"resolution is {edge} m; allowed: more than 0")
    return edge, *checked_origin(origin)


def _make_pose(x: float, y: float, z: float = 0.0) -> Any:
    return make_message("geometry_msgs/msg/Pose", position=make_point(x, y, z))


def occupancy_message(values: Percent, resolution: float, origin: Sequence[float], frame_id: str, stamp: int) -> Any:
    """Make a nav_msgs/OccupancyGrid message object.

    Args:
        values: (ny, nx) int8, x fastest; 0 free ... 100 occupied, -1 unknown.
        resolution: edge length of a cell [m].
        origin: (x, y) of the corner of cell (0, 0), at minimum x and y [m].
        frame_id: frame of the grid.
        stamp: time [ns since the Unix epoch].

    Raises:
        MessageError: `values` is not a non-empty int8 array (ny, nx), a value is out of range, or the geometry or the
            stamp is not valid.
    """
    edge, x, y = _geometry(resolution, origin)
    if values.dtype != np.int8 or values.ndim != 2 or values.size == 0:
        raise MessageError(f"occupancy is {values.dtype} of shape {values.shape}; allowed: int8 (ny, nx), not empty")
    if values.min() < -1 or values.max() > 100:
        raise MessageError(f"occupancy runs from {values.min()} to {values.max()}; allowed: -1 to 100")
    info = message_class("nav_msgs/msg/MapMetaData")(
        map_load_time=make_time(stamp),
        resolution=edge,
        width=values.shape[1],
        height=values.shape[0],
        origin=_make_pose(x, y),
    )
    return message_class(OCCUPANCY)(make_header(stamp, frame_id), info, np.ascontiguousarray(values).ravel())


def grid_map_message(
    layers: Mapping[str, Array],
    resolution: float,
    origin: Sequence[float],
    frame_id: str,
    stamp: int,
) -> Any:
    """Make a grid_map_msgs/GridMap message object.

    A GridMap starts at the corner of maximum x and y; its row index increases along -x, and its column index along -y.
    It is stored in column-major order. The data of `a[iy, ix]`, x fastest, are therefore `a[::-1, ::-1].ravel()`.

    Args:
        layers: (ny, nx) arrays of equal shape by name, including "elevation"; converted to float32.
        resolution: edge length of a cell [m].
        origin: (x, y) of the corner of cell (0, 0), at minimum x and y [m].
        frame_id: frame of the grid.
        stamp: time [ns since the Unix epoch].

    Raises:
        MessageError: the layers do not have a common, non-empty shape (ny, nx), "elevation" is missing, or the geometry
            or the stamp is not valid.
    """
    edge, x, y = _geometry(resolution, origin)
    shapes = {np.shape(array) for array in layers.values()}
    shape = shapes.pop() if len(shapes) == 1 else ()
    if len(shape) != 2 or 0 in shape:
        given = ", ".join(f"{name} {np.shape(array)}" for name, array in layers.items()) or "none"
        raise MessageError(f"layers given: {given}; allowed: one shape (ny, nx) for all")
    if BASIC_LAYER not in layers:
        raise MessageError(f"layers given: {', '.join(layers)}; {BASIC_LAYER!r} is missing")
    ny, nx = shape
    dimension = message_class("std_msgs/msg/MultiArrayDimension")
    layout = message_class("std_msgs/msg/MultiArrayLayout")(
        [dimension("column_index", ny, ny * nx), dimension("row_index", nx, nx)], 0
    )
    array_class = message_class("std_msgs/msg/Float32MultiArray")
    data = [array_class(layout, np.asarray(array, dtype=np.float32)[::-1, ::-1].ravel()) for array in layers.values()]
    # The pose of a GridMap is the pose of its centre.
    info = message_class("grid_map_msgs/msg/GridMapInfo")(
        edge, nx * edge, ny * edge, _make_pose(x + 0.5 * nx * edge, y + 0.5 * ny * edge)
    )
    return message_class(GRID_MAP)(make_header(stamp, frame_id), info, list(layers), [BASIC_LAYER], data, 0, 0)


# Data types of sensor_msgs/PointField.
DATATYPES = {"int8": 1, "uint8": 2, "int16": 3, "uint16": 4, "int32": 5, "uint32": 6, "float32": 7, "float64": 8}


def point_cloud_message(fields: Mapping[str, Array], frame_id: str, stamp: int) -> Any:
    """Make a sensor_msgs/PointCloud2 message object: one row of points, little endian, without padding.

    Args:
        fields: (n,) arrays by name, including `x`, `y` and `z` [m]; dtypes are kept. Viewers read colours from a field
            `rgb`, uint32 0x00RRGGBB.
        frame_id: frame of the points.
        stamp: time [ns since the Unix epoch].

    Raises:
        MessageError: x, y or z is missing, the fields do not have a common shape (n,), a dtype is not in DATATYPES, a
            coordinate is not finite, or the stamp is not valid.
    """
    missing = [name for name in ("x", "y", "z") if name not in fields]
    if missing:
        raise MessageError(f"fields given: {', '.join(fields) or 'none'}; a point cloud needs x, y and z")
    shapes = {np.shape(array) for array in fields.values()}
    if len(shapes) != 1 or len(next(iter(shapes))) != 1:
        given = ", ".join(f"{name} {np.shape(array)}" for name, array in fields.items())
        raise MessageError(f"fields given: {given}; allowed: one length (n,) for all")
    for name, array in fields.items():
        if array.dtype.name not in DATATYPES:
            raise MessageError(f"field {name!r} is {array.dtype}; allowed: {', '.join(DATATYPES)}")
    if not all(np.isfinite(fields[name]).all() for name in ("x", "y", "z")):
        raise MessageError("a coordinate of a point cloud is NaN or infinite; leave such points out")
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


CUBE, LINE_LIST, TEXT_VIEW_FACING, DELETE_ALL = 1, 5, 9, 3
MARKER = "visualization_msgs/msg/Marker"
# RGB colours of obstacles (and holes), footholds and steppable regions.
OBSTACLE_COLOUR, FOOTHOLD_COLOUR, REGION_COLOUR = (0.835, 0.369, 0.0), (0.0, 0.447, 0.698), (0.0, 0.35, 0.24)
# Height of labels and thickness of soles [m]; scales of lines, whose width is 3 mm, and of labels.
TEXT_HEIGHT, SOLE_THICKNESS = 0.018, 0.004
LINE_SCALE, TEXT_SCALE = (0.003, 0.0, 0.0), (0.0, 0.0, TEXT_HEIGHT)


def markers_message(
    obstacles: Sequence[ObstacleMessage],
    footholds: Mapping[str, Point],
    sole: tuple[float, float],
    frame_id: str,
    stamp: int,
    regions: Sequence[npt.NDArray[np.float64]] = (),
) -> Any:
    """Make a visualization_msgs/MarkerArray message object that replaces everything drawn before.

    Namespaces are `obstacles` (wireframes between the surroundings and the top, or the bottom of a hole), `heights`
    (labels in millimetres), `footholds` (a sole for each leg) and `regions` (outlines).

    Args:
        obstacles: obstacles and holes.
        footholds: (x, y, z) [m] by leg.
        sole: length (x) and width (y) [m].
        frame_id: frame of all coordinates.
        stamp: time [ns since the Unix epoch].
        regions: corners (n, 3) of each steppable region [m].

    Raises:
        MessageError: the stamp is not valid.
    """
    header = make_header(stamp, frame_id)
    markers = [_marker(header, "", 0, CUBE, (1.0, 1.0, 1.0), action=DELETE_ALL)]
    if obstacles:
        edges = [point for item in obstacles for point in _wireframe(item)]
        markers.append(_marker(header, "obstacles", 0, LINE_LIST, LINE_SCALE, points=edges))
    for number, item in enumerate(obstacles):
        x, y, z = item.position
        above = (x, y, max(z, z - item.height) + TEXT_HEIGHT)
        label = f"{1000.0 * item.height:+.0f} mm"
        markers.append(_marker(header, "heights", number, TEXT_VIEW_FACING, TEXT_SCALE, above, text=label))
    for number, (x, y, z) in enumerate(footholds.values()):
        size, centre = (*sole, SOLE_THICKNESS), (x, y, z + 0.5 * SOLE_THICKNESS)
        markers.append(_marker(header, "footholds", number, CUBE, size, centre, FOOTHOLD_COLOUR))
    if regions:
        edges = [point for corners in regions for point in _lines(corners, _next(corners))]
        markers.append(_marker(header, "regions", 0, LINE_LIST, LINE_SCALE, colour=REGION_COLOUR, points=edges))
    return make_message(MARKERS, markers=markers)


def _lines(*ends: Array) -> list[Any]:
    """Message points of the lines from ends[0] to ends[1], from ends[2] to ends[3] and so on, all (n, 3)."""
    return [make_point(*point) for point in np.stack(ends, axis=1).reshape(-1, 3).tolist()]


def _next(corners: Array) -> Array:
    """Next corner of a polygon after each corner (n, 3)."""
    return np.roll(corners, -1, axis=0)


def _wireframe(item: ObstacleMessage) -> list[Any]:
    """Outlines at the top (or the bottom of a hole) and at the surroundings, and vertical edges."""
    top, bottom = (np.insert(item.outline, 2, z, axis=1) for z in (item.position[2], item.position[2] - item.height))
    return _lines(top, _next(top), bottom, _next(bottom), top, bottom)


def _marker(
    header: Any,
    namespace: str,
    number: int,
    kind: int,
    scale: Point,
    position: Point = (0.0, 0.0, 0.0),
    colour: Point = OBSTACLE_COLOUR,
    **further: Any,
) -> Any:
    red, green, blue = colour
    return make_message(
        MARKER,
        header=header,
        ns=namespace,
        id=number,
        type=kind,
        pose=_make_pose(*position),
        scale=make_message("geometry_msgs/msg/Vector3", **dict(zip("xyz", map(float, scale), strict=True))),
        color=make_message("std_msgs/msg/ColorRGBA", r=red, g=green, b=blue, a=1.0),
        **further,
    )


def frames_message(transforms: Iterable[TransformMessage], stamp: int) -> Any:
    """Make a tf2_msgs/TFMessage message object.

    A transform takes coordinates from its source to its destination: in ROS terms the destination is the parent
    (`header.frame_id`) and the source is the child.

    Args:
        transforms: transforms that form a forest; each source occurs at most once.
        stamp: stamp of all transforms [ns since the Unix epoch].

    Raises:
        MessageError: a source occurs more than once, or the stamp is not valid.
    """
    stamped: Any = message_class("geometry_msgs/msg/TransformStamped")
    given = list(transforms)
    sources = [item.source_frame for item in given]
    twice = sorted({name for name in sources if sources.count(name) > 1})
    if twice:
        raise MessageError(f"source frame occurs more than once: {', '.join(twice)}; allowed: one transform for each")
    return message_class(FRAMES)(
        [
            stamped(make_header(stamp, item.destination_frame), item.source_frame, make_transform(item).transform)
            for item in given
        ]
    )


def camera_info_message(
    size: Sequence[int], matrix: npt.ArrayLike, distortion: npt.ArrayLike, frame_id: str, stamp: int
) -> Any:
    """Make a sensor_msgs/CameraInfo message object, model `plumb_bob`; the rectified image has the same matrix.

    Args:
        size: width and height [px].
        matrix: (3, 3) camera matrix [px].
        distortion: (5,) k1, k2, p1, p2, k3.
        frame_id: optical frame of the camera.
        stamp: time [ns since the Unix epoch].

    Raises:
        MessageError: `matrix` or `distortion` has another shape or is not finite, or the stamp is not valid.
    """
    intrinsic = checked_array(matrix, (3, 3), "camera matrix")
    width, height = size
    return make_message(
        CAMERA_INFO,
        header=make_header(stamp, frame_id),
        height=int(height),
        width=int(width),
        distortion_model="plumb_bob",
        d=checked_array(distortion, (5,), "distortion"),
        k=intrinsic.ravel(),
        r=np.eye(3).ravel(),
        p=np.column_stack((intrinsic, np.zeros(3))).ravel(),
    )


def text_message(text: str) -> Any:
    """Make a std_msgs/String message object."""
    return message_class(TEXT)(text)
