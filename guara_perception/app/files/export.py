"""Export of grids to PLY, PCD or CSV files."""

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
    """Write a grid atomically in the format given by the file's ending.

    `.ply` and `.pcd` (binary) contain a point for each known cell: x, y, z and sigma [m], hazard flags, and the colour
    of the cell in figures. `.csv` contains a line for each cell; an unknown cell has no height, and its flags give the
    cause.

    Returns:
        Number of points, or of lines without the header.

    Raises:
        InvalidInput: the path has another ending or is a folder.
        MissingFile: the folder does not exist.
    """
    write = WRITERS[check_target(path, *WRITERS).suffix.lower()]
    with whole_file(path) as temporary:
        return write(terrain, temporary)


def cell_cloud(terrain: LayeredGrid) -> dict[str, Array]:
    """Convert a grid to points at the centres of its known cells.

    The fields are x, y, z and sigma [m], hazard flags, and the colour of the cell in figures as 0x00RRGGBB. Unknown
    cells have no height and therefore no point.
    """
    known = known_cells(terrain)
    x, y = np.meshgrid(*terrain.geometry.centres())
    red, green, blue = np.rint(255.0 * hazard_picture(terrain.layers["hazard"])[0][known]).astype(np.uint32).T
    return {
        "x": x[known].astype(np.float32),
        "y": y[known].astype(np.float32),
        "z": terrain.layers["elevation"][known],
        "sigma": np.sqrt(terrain.layers["variance"][known]),
        "hazard": terrain.layers["hazard"][known],
        "rgb": red << 16 | green << 8 | blue,
    }


def _write_ply(terrain: LayeredGrid, path: Path) -> int:
    cloud = cell_cloud(terrain)
    rgb = cloud.pop("rgb")
    cloud |= {name: (rgb >> shift & 0xFF).astype(np.uint8) for name, shift in (("red", 16), ("green", 8), ("blue", 0))}
    kinds = {"<f4": "float", "<u2": "ushort", "|u1": "uchar"}
    properties = [f"property {kinds[values.dtype.str]} {name}" for name, values in cloud.items()]
    header = ["ply", "format binary_little_endian 1.0", f"comment {_origin(terrain)}", f"element vertex {rgb.size}"]
    return _write_points(path, [*header, *properties, "end_header"], cloud)


def _write_pcd(terrain: LayeredGrid, path: Path) -> int:
    cloud = cell_cloud(terrain)
    count = cloud["x"].size
    header = [
        f"# {_origin(terrain)}",
        "VERSION 0.7",
        f"FIELDS {' '.join(cloud)}",
        "SIZE 4 4 4 4 2 4",
        "TYPE F F F F U U",
        "COUNT 1 1 1 1 1 1",
        f"WIDTH {count}",
        "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {count}",
        "DATA binary",
    ]
    return _write_points(path, header, cloud)


def _write_points(path: Path, header: list[str], cloud: dict[str, Array]) -> int:
    """Write the header followed by the points as packed records; return the number of points."""
    points = np.rec.fromarrays(list(cloud.values()), dtype=[(name, values.dtype) for name, values in cloud.items()])
    path.write_bytes("\n".join([*header, ""]).encode("ascii") + points.tobytes())
    return int(points.size)


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


def _origin(terrain: LayeredGrid) -> str:
    return f"guara-perception {terrain.extent} grid of step {terrain.step}, metres in {terrain.frame}"


WRITERS: dict[str, Callable[[LayeredGrid, Path], int]] = {".ply": _write_ply, ".pcd": _write_pcd, ".csv": _write_csv}
