"""Saves and loads terrain as one NumPy file."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from guara_perception.exceptions import FileFormatError, MissingFile, PerceptionError
from guara_perception.terrain.geometry import GridGeometry
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.layers import LAYERS
from guara_perception.whole_file import whole_file

PICTURES = ("ortho_image_mm", "range_image_mm")


def save_terrain(terrain: TerrainGrid, path: str | Path) -> None:
    """Write a grid to an .npz file, whole or not at all (contract, section 4, `OUT.npz`).

    Raises:
        MissingFile: the folder does not exist.
    """
    metadata = {**terrain.metadata, "extent": terrain.extent}
    with whole_file(path) as temporary, temporary.open("wb") as stream:
        np.savez_compressed(
            stream,
            allow_pickle=False,
            **terrain.layers,
            **terrain.pictures,
            origin=np.array(terrain.origin, dtype=np.float64),
            resolution=np.float64(terrain.resolution),
            frame=np.array(terrain.frame),
            stamp=np.int64(terrain.stamp),
            step=np.int64(terrain.step),
            metadata=np.array(json.dumps(metadata)),
        )


def load_terrain(path: str | Path) -> TerrainGrid:
    """Read a grid written by `save_terrain`; the safety invariant is checked again.

    Raises:
        MissingFile: no such file.
        FileFormatError: not such a file, a layer missing or of another type, or an unsafe grid.
    """
    path = Path(path)
    if not path.is_file():
        raise MissingFile(f"{path}: no such file")
    try:
        with np.load(path, allow_pickle=False) as content:
            data: dict[str, Any] = {name: content[name] for name in content.files}
    except (ValueError, OSError, EOFError, KeyError, zipfile.BadZipFile) as error:
        raise FileFormatError(f"{path}: not a terrain file ({error})") from None
    wanted = [layer.name for layer in LAYERS] + ["origin", "resolution", "frame", "stamp", "step", "metadata"]
    missing = [name for name in wanted if name not in data]
    if missing:
        raise FileFormatError(f"{path}: {', '.join(missing)} missing, it is not a terrain file")
    try:
        metadata = json.loads(str(data["metadata"]))
        x, y = (float(v) for v in data["origin"])
        return TerrainGrid(
            layers={layer.name: data[layer.name] for layer in LAYERS},
            geometry=GridGeometry((x, y), float(data["resolution"]), data["elevation"].shape),
            frame=str(data["frame"]),
            stamp=int(data["stamp"]),
            step=int(data["step"]),
            extent=metadata.pop("extent", "footprint"),
            metadata=metadata,
            pictures={name: data[name] for name in PICTURES if name in data},
        )
    except (PerceptionError, ValueError, TypeError, AttributeError) as error:
        raise FileFormatError(f"{path}: {error}") from None
