"""Reader of the NumPy files written by `save_terrain`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from guara_perception.arrays import Array
from guara_perception.exceptions import FileFormatError, PerceptionError
from guara_perception.fields import parse_json
from guara_perception.files import existing_file, read_arrays
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.layers.geometry import GridGeometry
from guara_perception.terrain.layers.layers import LAYERS
from guara_perception.terrain.layers.record import RECORDS, ScanRecord

PICTURES = ("ortho_image_mm", "range_image_mm")


def load_terrain(path: str | Path) -> TerrainGrid:
    """Read a grid written by `save_terrain`, and check the safety invariant.

    A grid that was saved when it was stale still is, and `stale_because` gives the reasons.

    Raises:
        MissingFile: there is no such file.
        FileFormatError: the file is not a terrain file, its arrays or metadata are invalid, or the grid violates the
            safety invariant.
    """
    path = existing_file(path)
    wanted = [layer.name for layer in LAYERS] + ["origin", "resolution", "frame", "stamp", "step", "metadata"]
    data: dict[str, Any] = dict(read_arrays(path, [*wanted, *PICTURES]))
    if "variance" in data:
        # Files of earlier versions contain neither the local variance nor ceilings.
        data.setdefault("variance_local", data["variance"])
        data.setdefault("ceiling", np.full_like(data["variance"], np.nan))
    missing = [name for name in wanted if name not in data]
    if missing:
        raise FileFormatError(f"{path}: not a terrain file; missing arrays: {', '.join(missing)}")
    x, y = (float(v) for v in _checked(data, path, "origin", "fiu", (2,)))
    text = str(_checked(data, path, "metadata", "U", ()))
    fields = parse_json(text.encode(errors="surrogatepass"), f"{path}: metadata")
    metadata = dict(fields.data)
    stale_because = fields.sequence("stale_because") if metadata.pop("stale_because", None) is not None else ()
    try:
        return TerrainGrid(
            layers={layer.name: data[layer.name] for layer in LAYERS},
            geometry=GridGeometry(
                (x, y), float(_checked(data, path, "resolution", "fiu", ())), data["elevation"].shape
            ),
            frame=str(_checked(data, path, "frame", "U", ())),
            stamp=int(_checked(data, path, "stamp", "iu", ())),
            step=int(_checked(data, path, "step", "iu", ())),
            extent=(extent := metadata.pop("extent", "footprint")),
            record=RECORDS.get(str(extent), ScanRecord).from_json(metadata),
            pictures={name: _checked(data, path, name, "f", (None, None)) for name in PICTURES if name in data},
            stale_because=tuple(map(str, stale_because)),
        )
    except FileFormatError:
        raise
    except PerceptionError as error:
        raise FileFormatError(f"{path}: {error}") from None


def _checked(data: dict[str, Any], path: Path, name: str, kinds: str, shape: tuple[int | None, ...]) -> Array:
    """Array of the file, checked for its type (`kinds`: NumPy kind codes) and shape (None = any length)."""
    array = np.asarray(data[name])
    fits = len(array.shape) == len(shape) and all(w in (None, n) for w, n in zip(shape, array.shape, strict=True))
    if array.dtype.kind not in kinds or not fits:
        sides = " x ".join("n" if n is None else str(n) for n in shape)
        noun = {"U": "text", "iu": "whole number", "f": "floating-point number"}.get(kinds, "number")
        wanted = f"{sides or 'one'} {noun}{'s' if shape else ''}"
        raise FileFormatError(f"{path}: {name} is {array.dtype} of shape {array.shape}; it must be {wanted}")
    return array
