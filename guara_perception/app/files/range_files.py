"""Range images as PNG files: 16 bit with scale and offset, 8 bit for display, and flags of the causes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from guara_perception.arrays import Float32, Grey, Image
from guara_perception.files import whole_file, write_text
from guara_perception.images import write_picture
from guara_perception.scanning.pictures import COLUMNS, ROWS, cause_image
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK, Hazard

# In 16-bit images, 0 is unknown, and any other value v is the height v * SCALE_MM + OFFSET_MM.
SCALE_MM = 0.01
OFFSET_MM = -300.0
IMAGES = ("range_image_mm", "ortho_image_mm")


def write_range_images(folder: Path, terrain: TerrainGrid) -> list[Path]:
    """Write the range images of a grid to a folder; return the paths.

    Each range image is written with 16 and with 8 bits per pixel. Further files are the causes of the unknown pixels of
    the orthorectified image, and `range_images.json`, which explains the values. As in the grid file, rows are along x
    and columns along y; images are not flipped for display.
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
    write_text(path, json.dumps(meaning, indent=1) + "\n")
    return [*paths, path]


def to_16_bit(image: Float32) -> Image:
    """Convert heights [mm] to heights above OFFSET_MM in units of SCALE_MM, clipped to 1 ... 65535; 0 = unknown."""
    values = np.clip(np.rint((np.nan_to_num(image, nan=OFFSET_MM) - OFFSET_MM) / SCALE_MM), 1, 65535)
    return np.where(np.isfinite(image), values, 0).astype(np.uint16)


def to_8_bit(image: Float32) -> tuple[Grey, float, float]:
    """Convert heights to grey levels 1 (lowest) ... 255 (highest), 0 where unknown.

    Returns:
        The image, and the lowest and highest height [mm]; both are 0 if no pixel is known.
    """
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
