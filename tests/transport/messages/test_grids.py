"""Tests of OccupancyGrid and GridMap: the order of their bytes, which is what breaks silently."""

import struct

import numpy as np
import pytest

from transport import MessageError, encode, grid_map_message, occupancy_message

STAMP = 5_000_000_007
VALUES = np.array([[1, 2, 3], [4, 5, 6]])
"""a[iy, ix] with ny = 2, nx = 3."""


def _text(value: str) -> bytes:
    data = value.encode() + b"\x00"
    return struct.pack("<I", len(data)) + data


class Bytes:
    """CDR bytes written by hand: alignment counts from the end of the header."""

    def __init__(self) -> None:
        self.data = b""

    def add(self, code: str, *values: float) -> "Bytes":
        for value in values:
            self.data += b"\x00" * (-len(self.data) % struct.calcsize(code))
            self.data += struct.pack("<" + code, value)
        return self

    def text(self, value: str) -> "Bytes":
        self.data += b"\x00" * (-len(self.data) % 4)
        self.data += _text(value)
        return self

    def payload(self) -> bytes:
        return b"\x00\x01\x00\x00" + self.data


def test_occupancy_bytes_are_golden() -> None:
    """An OccupancyGrid is row-major from the corner at minimum x and y, byte by byte."""
    expected = Bytes().add("i", 5).add("I", 7).text("base_footprint")
    expected.add("i", 5).add("I", 7).add("f", 0.25).add("I", 3, 2)
    expected.add("d", 0.5, -0.25, 0.0).add("d", 0.0, 0.0, 0.0, 1.0)
    expected.add("I", 6).add("b", 1, 2, 3, 4, 5, 6)
    message = occupancy_message(VALUES.astype(np.int8), 0.25, (0.5, -0.25), "base_footprint", STAMP)
    assert encode(message) == expected.payload()


def test_grid_map_bytes_are_golden() -> None:
    """A GridMap starts at maximum x and y, runs along -x first, and is labelled column-major."""
    expected = Bytes().add("i", 5).add("I", 7).text("base_footprint")
    expected.add("d", 0.25, 0.75, 0.5)
    expected.add("d", 0.5 + 0.375, -0.25 + 0.25, 0.0).add("d", 0.0, 0.0, 0.0, 1.0)
    expected.add("I", 1).text("elevation").add("I", 1).text("elevation")
    expected.add("I", 1)
    expected.add("I", 2).text("column_index").add("I", 2, 6).text("row_index").add("I", 3, 3)
    expected.add("I", 0)
    expected.add("I", 6).add("f", 6, 5, 4, 3, 2, 1)
    expected.add("H", 0, 0)
    layers = {"elevation": VALUES.astype(np.float32)}
    message = grid_map_message(layers, 0.25, (0.5, -0.25), "base_footprint", STAMP)
    assert encode(message) == expected.payload()


def test_grid_map_index_rule_finds_each_cell() -> None:
    """By the rule of grid_map (rows along -x, columns along -y, column-major), each cell has its own value."""
    edge, (x0, y0) = 0.25, (0.5, -0.25)
    message = grid_map_message({"elevation": VALUES.astype(np.float32)}, edge, (x0, y0), "f", 0)
    info, data = message.info, message.data[0]
    columns, rows = data.layout.dim
    for iy in range(2):
        for ix in range(3):
            x, y = x0 + (ix + 0.5) * edge, y0 + (iy + 0.5) * edge
            row = int((info.pose.position.x + info.length_x / 2 - x) / edge)
            column = int((info.pose.position.y + info.length_y / 2 - y) / edge)
            assert row < rows.size and column < columns.size
            assert data.data[column * rows.stride + row] == VALUES[iy, ix]


def test_grid_map_layers_become_float32() -> None:
    """Integer layers are converted: a GridMap holds nothing else."""
    message = grid_map_message({"elevation": VALUES.astype(np.uint16)}, 1, (0, 0), "f", 0)
    assert message.data[0].data.dtype == np.float32


@pytest.mark.parametrize(
    ("values", "expected_text"),
    [
        (np.zeros((2, 2)), "occupancy is float64"),
        (np.zeros(4, np.int8), r"shape \(4,\); allowed: int8 \(ny, nx\)"),
        (np.full((2, 2), 101, np.int8), "from 101 to 101; allowed: -1 to 100"),
        (np.full((2, 2), -2, np.int8), "from -2 to -2"),
    ],
)
def test_wrong_occupancy_is_refused(values: np.ndarray, expected_text: str) -> None:
    """Type, shape and range are checked."""
    with pytest.raises(MessageError, match=expected_text):
        occupancy_message(values, 0.1, (0, 0), "f", 0)


def test_wrong_geometry_is_refused() -> None:
    """Resolution and origin must be finite, the resolution positive."""
    values = np.zeros((2, 2), np.int8)
    for resolution, origin, expected_text in (
        (0.0, (0, 0), "resolution is 0.0 m"),
        (np.nan, (0, 0), "resolution is nan"),
        (0.1, (0, np.inf), "origin y is inf"),
        (0.1, (0, 0, 0), "origin has 3 numbers"),
    ):
        with pytest.raises(MessageError, match=expected_text):
            occupancy_message(values, resolution, origin, "f", 0)


def test_wrong_layers_are_refused() -> None:
    """A GridMap needs layers of one shape, the elevation among them."""
    a, b = np.zeros((2, 3), np.float32), np.zeros((3, 2), np.float32)
    with pytest.raises(MessageError, match=r"a \(2, 3\), b \(3, 2\); allowed: one shape"):
        grid_map_message({"a": a, "b": b}, 0.1, (0, 0), "f", 0)
    with pytest.raises(MessageError, match="layers given: none"):
        grid_map_message({}, 0.1, (0, 0), "f", 0)
    with pytest.raises(MessageError, match="layers given: a; 'elevation' is missing"):
        grid_map_message({"a": a}, 0.1, (0, 0), "f", 0)
