"""Export of grids as PLY, PCD or CSV for other tools."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np

from guara_perception.arrays import Array
from guara_perception.files import check_target, whole_file
from guara_perception.terrain.drawing.style import hazard_picture
from guara_perception.terrain.layers.hazard import Hazard
from guara_perception.terrain.layers.layered_grid import LayeredGrid
from guara_perception.terrain.questions.points import known_cells

COLUMNS = ("x", "y", "elevation", "sigma", "slope", "step_height", "roughness", "traversability", "hazard")


def export_terrain(terrain: LayeredGrid, path: str | Path) -> int:
    """Write a grid in the format of the file's ending, whole or not at all.

    `.ply` and `.pcd` (binary) hold a point per known cell: x, y, z and sigma [m], hazard flags, and the colour that
    pictures give the cell's foremost hazard. `.csv` holds a line per cell, unknown ones too: their heights are empty
    and their hazard names the cause.

    Returns:
        Number of points or lines written.

    Raises:
        InvalidInput: another ending.
        MissingFile: the folder does not exist.
    """
    write = WRITERS[check_target(path, *WRITERS).suffix.lower()]
    with whole_file(path) as temporary:
        return write(terrain, temporary)


def _write_ply(terrain: LayeredGrid, path: Path) -> int:
    points = _points(terrain)
    names = {"<f4": "float", "<u2": "ushort", "|u1": "uchar"}
    properties = [f"property {names[points.dtype[name].str]} {name}" for name in points.dtype.names or ()]
    header = ["ply", "format binary_little_endian 1.0", f"comment {_origin(terrain)}", f"element vertex {points.size}"]
    content = "\n".join([*header, *properties, "end_header", ""]).encode("ascii") + points.tobytes()
    path.write_bytes(content)
    return int(points.size)


def _write_pcd(terrain: LayeredGrid, path: Path) -> int:
    points = _points(terrain)
    colour = np.zeros(points.size, np.uint32)
    for name, shift in (("red", 16), ("green", 8), ("blue", 0)):
        colour |= points[name].astype(np.uint32) << shift
    cloud = np.zeros(
        points.size, [*((name, "<f4") for name in ("x", "y", "z", "sigma")), ("hazard", "<u2"), ("rgb", "<u4")]
    )
    for name in ("x", "y", "z", "sigma", "hazard"):
        cloud[name] = points[name]
    cloud["rgb"] = colour
    header = [
        f"# {_origin(terrain)}",
        "VERSION 0.7",
        "FIELDS x y z sigma hazard rgb",
        "SIZE 4 4 4 4 2 4",
        "TYPE F F F F U U",
        "COUNT 1 1 1 1 1 1",
        f"WIDTH {cloud.size}",
        "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {cloud.size}",
        "DATA binary",
        "",
    ]
    path.write_bytes("\n".join(header).encode("ascii") + cloud.tobytes())
    return int(cloud.size)


def _write_csv(terrain: LayeredGrid, path: Path) -> int:
    x, y = (axis.ravel() for axis in np.meshgrid(*terrain.geometry.centres()))
    layers = {name: terrain.layers[name].ravel() for name in COLUMNS if name in terrain.layers}
    layers["sigma"] = np.sqrt(terrain.layers["variance"]).ravel()
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(COLUMNS)
        for cell in range(x.size):
            numbers = (f"{layers[name][cell]:.6g}" for name in COLUMNS[2:-1])
            flags = "|".join(str(flag.name) for flag in Hazard(int(layers["hazard"][cell])))
            writer.writerow([f"{x[cell]:.6g}", f"{y[cell]:.6g}", *("" if n == "nan" else n for n in numbers), flags])
    return int(x.size)


def _points(terrain: LayeredGrid) -> Array:
    known = known_cells(terrain)
    x, y = np.meshgrid(*terrain.geometry.centres())
    kinds = [(name, "<f4") for name in ("x", "y", "z", "sigma")] + [("hazard", "<u2")]
    points = np.zeros(int(known.sum()), [*kinds, *((name, "u1") for name in ("red", "green", "blue"))])
    points["x"], points["y"] = x[known], y[known]
    points["z"], points["sigma"] = terrain.layers["elevation"][known], np.sqrt(terrain.layers["variance"][known])
    points["hazard"] = terrain.layers["hazard"][known]
    colours = np.rint(255 * hazard_picture(terrain.layers["hazard"])[0][known]).astype(np.uint8)
    for channel, name in enumerate(("red", "green", "blue")):
        points[name] = colours[:, channel]
    return points


def _origin(terrain: LayeredGrid) -> str:
    return f"guara-perception {terrain.extent} grid of step {terrain.step}, metres in {terrain.frame}"


WRITERS: dict[str, Callable[[LayeredGrid, Path], int]] = {".ply": _write_ply, ".pcd": _write_pcd, ".csv": _write_csv}
