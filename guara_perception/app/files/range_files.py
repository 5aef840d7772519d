"""Range images as image files: 16 bits with scale and offset, 8 bits for display, causes as flags."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from guara_perception.app.files.write_picture import write_picture
from guara_perception.arrays import Float32, Grey, Image
from guara_perception.files import whole_file
from guara_perception.ranging.range_images import COLUMNS, ROWS
from guara_perception.scanning.pictures import cause_image
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK, Hazard

# Value 0 means unknown; value v means v * SCALE_MM + OFFSET_MM.
SCALE_MM = 0.01
OFFSET_MM = -300.0
IMAGES = ("range_image_mm", "ortho_image_mm")


def write_range_images(folder: Path, terrain: TerrainGrid) -> list[Path]:
    """Write both range images in 16 and 8 bits, the causes of unknown pixels in the orthorectified one, and a key.

    Pixel (r, c) is row r along x, column c along y, as in the grid file; nothing is flipped for display here.
    """
    paths = []
    shown: dict[str, tuple[float, float]] = {}
    for name in IMAGES:
        image = terrain.pictures[name]
        stem = name.removesuffix("_mm")
        paths.append(_write(folder / f"{stem}_16bit.png", to_16_bit(image)))
        shades, low, high = to_8_bit(image)
        paths.append(_write(folder / f"{stem}_8bit.png", shades))
        shown[stem] = (low, high)
    paths.append(_write(folder / "ortho_image_causes.png", cause_image(terrain)))
    meaning = {
        "16bit": {"unknown": 0, "scale_mm": SCALE_MM, "offset_mm": OFFSET_MM, "height_mm": "value * scale + offset"},
        "8bit": {name: {"unknown": 0, "value_1_mm": low, "value_255_mm": high} for name, (low, high) in shown.items()},
        "causes": {flag.name: int(flag) for flag in Hazard if int(flag) & int(UNKNOWN_MASK)},
        "pixels": {"rows": "along x", "columns": "along y", "size": [ROWS, COLUMNS]},
    }
    path = folder / "range_images.json"
    with whole_file(path) as temporary:
        temporary.write_text(json.dumps(meaning, indent=1) + "\n", encoding="utf-8")
    return [*paths, path]


def to_16_bit(image: Float32) -> Image:
    """Heights above OFFSET_MM in units of SCALE_MM, 0 where unknown."""
    values = np.clip(np.rint((np.nan_to_num(image, nan=OFFSET_MM) - OFFSET_MM) / SCALE_MM), 1, 65535)
    return np.where(np.isfinite(image), values, 0).astype(np.uint16)


def to_8_bit(image: Float32) -> tuple[Grey, float, float]:
    """Grey levels 1 ... 255 from the lowest to the highest height, 0 where unknown; and those two heights [mm]."""
    known = np.isfinite(image)
    if not known.any():
        return np.zeros(image.shape, dtype=np.uint8), 0.0, 0.0
    low, high = float(image[known].min()), float(image[known].max())
    share = (np.nan_to_num(image, nan=low) - low) / max(high - low, 1e-6)
    return np.where(known, 1 + np.rint(254 * share), 0).astype(np.uint8), low, high


def _write(path: Path, image: Image) -> Path:
    with whole_file(path) as temporary:
        write_picture(temporary, image)
    return path
