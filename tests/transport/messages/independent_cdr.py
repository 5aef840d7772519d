"""A second CDR reader, written from the rules of the format alone: it shares no code with the one that it checks.

Reads the fields of `.msg` texts, given as a list of (type, name), with `struct`; alignment counts from the
end of the 4-byte header, as XCDR1 has it.
"""

import re
import struct
from pathlib import Path

SIZES = {
    "bool": "?",
    "byte": "B",
    "uint8": "B",
    "int8": "b",
    "uint16": "H",
    "int16": "h",
    "uint32": "I",
    "int32": "i",
    "uint64": "Q",
    "int64": "q",
    "float32": "f",
    "float64": "d",
}

STANDARD = {
    "builtin_interfaces/Time": [("int32", "sec"), ("uint32", "nanosec")],
    "std_msgs/Header": [("builtin_interfaces/Time", "stamp"), ("string", "frame_id")],
    "geometry_msgs/Point": [("float64", "x"), ("float64", "y"), ("float64", "z")],
    "geometry_msgs/Vector3": [("float64", "x"), ("float64", "y"), ("float64", "z")],
    "geometry_msgs/Quaternion": [("float64", n) for n in "xyzw"],
    "geometry_msgs/Pose": [("geometry_msgs/Point", "position"), ("geometry_msgs/Quaternion", "orientation")],
    "geometry_msgs/Transform": [
        ("geometry_msgs/Vector3", "translation"),
        ("geometry_msgs/Quaternion", "rotation"),
    ],
    "nav_msgs/MapMetaData": [
        ("builtin_interfaces/Time", "map_load_time"),
        ("float32", "resolution"),
        ("uint32", "width"),
        ("uint32", "height"),
        ("geometry_msgs/Pose", "origin"),
    ],
    "nav_msgs/OccupancyGrid": [
        ("std_msgs/Header", "header"),
        ("nav_msgs/MapMetaData", "info"),
        ("int8[]", "data"),
    ],
    "std_msgs/MultiArrayDimension": [("string", "label"), ("uint32", "size"), ("uint32", "stride")],
    "std_msgs/MultiArrayLayout": [("std_msgs/MultiArrayDimension[]", "dim"), ("uint32", "data_offset")],
    "std_msgs/Float32MultiArray": [("std_msgs/MultiArrayLayout", "layout"), ("float32[]", "data")],
    "diagnostic_msgs/KeyValue": [("string", "key"), ("string", "value")],
    "diagnostic_msgs/DiagnosticStatus": [
        ("byte", "level"),
        ("string", "name"),
        ("string", "message"),
        ("string", "hardware_id"),
        ("diagnostic_msgs/KeyValue[]", "values"),
    ],
    "diagnostic_msgs/DiagnosticArray": [
        ("std_msgs/Header", "header"),
        ("diagnostic_msgs/DiagnosticStatus[]", "status"),
    ],
}


def definitions(folder: Path, package: str) -> dict[str, list[tuple[str, str]]]:
    """Fields of every `.msg` file of a folder, by `package/Name`."""
    found = {}
    for path in sorted(folder.glob("*.msg")):
        fields = []
        for line in path.read_text().splitlines():
            match = re.match(r"([A-Za-z0-9_/\[\]]+)\s+([a-z][a-z0-9_]*)\s*(#.*)?$", line)
            if match:
                fields.append((match[1], match[2]))
        found[f"{package}/{path.stem}"] = fields
    return found


class Reader:
    """Reads one payload."""

    def __init__(self, payload: bytes, types: dict[str, list[tuple[str, str]]], package: str) -> None:
        if payload[:2] != b"\x00\x01":
            raise ValueError("not little-endian CDR")
        self.data, self.types, self.package = payload[4:], types, package
        self.at = 0

    def number(self, code: str):
        size = struct.calcsize(code)
        self.at += -self.at % size
        (value,) = struct.unpack_from("<" + code, self.data, self.at)
        self.at += size
        return value

    def text(self) -> str:
        length = self.number("I")
        value = self.data[self.at : self.at + length]
        if value[-1:] != b"\x00":
            raise ValueError("text without its end")
        self.at += length
        return value[:-1].decode()

    def read(self, kind: str):
        if kind.endswith("[]"):
            return [self.read(kind[:-2]) for _ in range(self.number("I"))]
        if kind == "string":
            return self.text()
        if kind in SIZES:
            return self.number(SIZES[kind])
        name = kind if "/" in kind else f"{self.package}/{kind}"
        return {field: self.read(field_type) for field_type, field in self.types[name]}


def read(payload: bytes, kind: str, folder: Path) -> dict:
    """One message as nested dictionaries and lists; every byte must be used."""
    types = STANDARD | definitions(folder, "guara_msgs")
    types |= definitions(folder / "grid_map_msgs", "grid_map_msgs")
    reader = Reader(payload, types, kind.split("/")[0])
    value = reader.read(kind)
    if reader.at != len(reader.data):
        raise ValueError(f"{len(reader.data) - reader.at} bytes left over")
    return value
