"""Tests of what ROS tools draw: clouds, transforms, markers, camera; read back by rules written here again."""

import numpy as np
import pytest

import transport
from transport import MessageError, ObstacleMessage, TransformMessage

STAMP = 5_000_000_007
FLOAT32, UINT16, UINT32 = 7, 4, 6
"""Datatypes of sensor_msgs/PointField, from its definition."""


def _fields(n: int = 3) -> dict[str, np.ndarray]:
    values = np.arange(n, dtype=np.float32)
    return {"x": values, "y": values + 10, "z": values / 8, "hazard": np.full(n, 257, np.uint16)}


def test_a_cloud_is_read_by_its_own_offsets() -> None:
    """Every field lies where the message says that it does, for every point."""
    fields = {**_fields(), "rgb": np.array([0xFF0000, 0x00FF00, 0x0000FF], np.uint32)}
    message = transport.point_cloud_message(fields, "base_footprint", STAMP)
    again = transport.decode(transport.encode(message), "sensor_msgs/msg/PointCloud2")
    assert (again.height, again.width, again.is_bigendian, again.is_dense) == (1, 3, False, True)
    assert again.row_step == again.width * again.point_step == again.data.size
    assert (again.header.frame_id, again.header.stamp.sec, again.header.stamp.nanosec) == ("base_footprint", 5, 7)
    assert [(f.name, f.datatype, f.count) for f in again.fields] == [
        ("x", FLOAT32, 1),
        ("y", FLOAT32, 1),
        ("z", FLOAT32, 1),
        ("hazard", UINT16, 1),
        ("rgb", UINT32, 1),
    ]
    codes = {FLOAT32: "<f4", UINT16: "<u2", UINT32: "<u4"}
    for field in again.fields:
        kind = np.dtype(codes[field.datatype])
        read = [
            np.frombuffer(again.data.tobytes(), kind, 1, point * again.point_step + field.offset)[0]
            for point in range(again.width)
        ]
        np.testing.assert_array_equal(read, fields[field.name])


def test_an_empty_cloud_takes_away_what_was_drawn() -> None:
    """A withdrawn grid has no point; its cloud is a message all the same."""
    message = transport.point_cloud_message(_fields(0), "base_footprint", STAMP)
    assert message.width == 0 and message.data.size == 0


@pytest.mark.parametrize(
    ("change", "expected_text"),
    [
        (lambda f: f.pop("z"), "a point cloud needs x, y and z"),
        (lambda f: f.update(x=np.zeros(2, np.float32)), "one length"),
        (lambda f: f.update(x=np.zeros((3, 1), np.float32)), "one length"),
        (lambda f: f.update(hazard=np.zeros(3, np.complex64)), "field 'hazard' is complex64"),
        (lambda f: f.update(z=np.array([0, np.nan, 0], np.float32)), "NaN or infinite"),
    ],
)
def test_a_cloud_that_viewers_would_misread_is_refused(change, expected_text: str) -> None:
    """No silent gaps: lengths, types and coordinates are checked."""
    fields = _fields()
    change(fields)
    with pytest.raises(MessageError, match=expected_text):
        transport.point_cloud_message(fields, "base_footprint", STAMP)


def test_a_transform_has_its_destination_as_parent() -> None:
    """`transform_<source>_to_<destination>` is the pose of the source in the destination, as TF keeps it."""
    matrix = np.array([[0.0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]])
    made = TransformMessage(source_frame="base_link", destination_frame="base_footprint", matrix=matrix)
    message = transport.frames_message([made], STAMP)
    (found,) = transport.decode(transport.encode(message), "tf2_msgs/msg/TFMessage").transforms
    assert (found.header.frame_id, found.child_frame_id) == ("base_footprint", "base_link")
    moved, turned = found.transform.translation, found.transform.rotation
    assert (moved.x, moved.y, moved.z) == (1, 2, 3)
    np.testing.assert_allclose((turned.x, turned.y, turned.z, turned.w), (0, 0, np.sqrt(0.5), np.sqrt(0.5)))
    with pytest.raises(MessageError, match="more than once: base_link"):
        transport.frames_message([made, made], STAMP)


def test_a_camera_keeps_its_numbers() -> None:
    """K, D and P as image_geometry reads them; the rectified picture has the same matrix."""
    matrix, distortion = np.array([[500.0, 0, 320], [0, 501, 256], [0, 0, 1]]), np.arange(5) / 10
    message = transport.camera_info_message((640, 512), matrix, distortion, "camera_optical_frame", STAMP)
    again = transport.decode(transport.encode(message), "sensor_msgs/msg/CameraInfo")
    assert (again.width, again.height, again.distortion_model) == (640, 512, "plumb_bob")
    np.testing.assert_array_equal(again.k.reshape(3, 3), matrix)
    np.testing.assert_array_equal(again.d, distortion)
    np.testing.assert_array_equal(again.p.reshape(3, 4), np.column_stack((matrix, np.zeros(3))))
    with pytest.raises(MessageError, match="distortion has shape"):
        transport.camera_info_message((640, 512), matrix, np.zeros(4), "camera_optical_frame", STAMP)


def test_markers_replace_what_was_drawn_and_stand_where_things_are() -> None:
    """First everything goes, then edges from floor to top, heights as text, soles, outlines of regions."""
    box = ObstacleMessage(
        outline=np.array([[0.5, 0.0], [0.6, 0.0], [0.6, 0.1]]),
        height=0.08,
        position=(0.55, 0.05, 0.09),
        sigma=0.001,
        hazard=512,
    )
    footholds = {"lf": (0.4, 0.18, 0.01)}
    region = np.array([[0.3, 0.1, 0.01], [0.4, 0.1, 0.02], [0.35, 0.2, 0.03]])
    message = transport.markers_message([box], footholds, (0.08, 0.06), "base_footprint", STAMP, [region])
    markers = transport.decode(transport.encode(message), "visualization_msgs/msg/MarkerArray").markers
    assert [(m.ns, m.action) for m in markers] == [
        ("", 3),
        ("obstacles", 0),
        ("heights", 0),
        ("footholds", 0),
        ("regions", 0),
    ]
    edges, label, sole, sides = markers[1:]
    ends = np.array([(p.x, p.y, p.z) for p in sides.points]).reshape(-1, 2, 3)
    np.testing.assert_allclose(ends, np.stack((region, np.roll(region, -1, axis=0)), axis=1))
    assert sides.type == 5
    assert edges.type == 5 and len(edges.points) == 3 * 6
    assert {round(p.z, 6) for p in edges.points} == {0.01, 0.09}
    assert (label.type, label.text) == (9, "+80 mm")
    assert (sole.scale.x, sole.scale.y, sole.pose.position.x) == (0.08, 0.06, 0.4)
    assert all(m.color.a == 1.0 for m in markers)


def test_text_is_text() -> None:
    """A URDF goes as it is."""
    message = transport.text_message("<robot name='ü'/>")
    assert transport.decode(transport.encode(message), "std_msgs/msg/String").data == "<robot name='ü'/>"
