"""Writer of grids to NumPy files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from guara_perception.exceptions import InvalidInput
from guara_perception.files import whole_file
from guara_perception.terrain.layers.layered_grid import LayeredGrid


def save_terrain(terrain: LayeredGrid, path: str | Path) -> None:
    """Write the grid to an .npz file; `load_terrain` reads it back.

    Raises:
        InvalidInput: the name does not end in .npz, or is that of a folder.
        MissingFile: the folder does not exist.
        OSError: the file cannot be written.
    """
    if Path(path).suffix != ".npz":
        raise InvalidInput(f"{path}: a grid is saved as .npz; `guara convert` writes .ply, .pcd and .csv")
    metadata = {**terrain.record.to_json(), "extent": terrain.extent}
    if terrain.stale_because:
        metadata["stale_because"] = list(terrain.stale_because)
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
