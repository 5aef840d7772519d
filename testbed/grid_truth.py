"""Truth of a scan per grid cell, and errors of a grid, both as defined in the README of the recorded data."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

import guara_perception as gp

# Height difference within 3 x 3 mm that counts as a jump. Cells nearer to a jump than the margin are not interior.
JUMP_M = 0.003
INTERIOR_MARGIN_MM = 6
# Tolerance of the height of a known cell that could not be seen, beyond the range of its true heights.
UNSEEN_TOLERANCE_M = 0.002
MADE_UP_M = 0.005


@dataclass(frozen=True)
class Truth:
    """Truth of a scan per grid cell, as arrays (ny, nx)."""

    mean: npt.NDArray[np.float64]
    low: npt.NDArray[np.float64]
    high: npt.NDArray[np.float64]
    interior: npt.NDArray[np.bool_]
    unseen: npt.NDArray[np.bool_]
    dark: npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Figures:
    """Figures of one scan, in millimetres and per cent; `unseen_wrong` and `unsafe` are numbers of cells."""

    mean: float
    p95: float
    worst: float
    near: float
    far: float
    bias: float
    bias_near: float
    bias_far: float
    known: float
    unseen_known: float
    unseen_wrong: int
    dark_known: float
    unsafe: int


def load_truth(path: Path, cell_mm: int) -> Truth:
    """Read the truth of a recorded scan."""
    with np.load(path) as data:
        seen = data["visible"] & data["lit"] & ~data["dark"]
        return truth_of(data["elevation"].astype(np.float64), seen, data["dark"], cell_mm)


def truth_of(
    elevation: npt.NDArray[np.float64], seen: npt.NDArray[np.bool_], dark: npt.NDArray[np.bool_], cell_mm: int
) -> Truth:
    """Gather truth in a raster a[iy, ix] of 1 mm into cells of `cell_mm`."""
    kernel = np.ones((3, 3), np.uint8)
    relief = cv2.dilate(elevation, kernel) - cv2.erode(elevation, kernel)
    side = 2 * INTERIOR_MARGIN_MM + 1
    near_jump = cv2.dilate((relief > JUMP_M).astype(np.uint8), np.ones((side, side), np.uint8)) > 0

    def cells(layer: npt.NDArray[np.generic]) -> npt.NDArray[np.generic]:
        ny, nx = (n // cell_mm for n in layer.shape)
        return layer.reshape(ny, cell_mm, nx, cell_mm).swapaxes(1, 2).reshape(ny, nx, -1)

    heights = cells(elevation)
    return Truth(
        mean=heights.mean(axis=-1),
        low=heights.min(axis=-1),
        high=heights.max(axis=-1),
        interior=np.asarray(cells(seen & ~near_jump).all(axis=-1)),
        unseen=np.asarray(~cells(seen).any(axis=-1)),
        dark=np.asarray(cells(dark).all(axis=-1)),
    )


def figures(terrain: gp.TerrainGrid, truth: Truth) -> Figures:
    """Compare a grid with its truth."""
    elevation = terrain.elevation.astype(np.float64)
    known = np.isfinite(elevation)
    error = (elevation - truth.mean) * 1e3
    used = truth.interior & known
    third = elevation.shape[1] // 3
    near, far = used.copy(), used.copy()
    near[:, third:] = False
    far[:, : elevation.shape[1] - third] = False
    unseen = truth.unseen & known
    wrong = unseen & ((elevation > truth.high + UNSEEN_TOLERANCE_M) | (elevation < truth.low - UNSEEN_TOLERANCE_M))
    traversable = terrain.traversability > 0
    return Figures(
        mean=_mean(np.abs(error[used])),
        p95=float(np.percentile(np.abs(error[used]), 95)) if used.any() else np.nan,
        worst=float(np.abs(error[used]).max()) if used.any() else np.nan,
        near=_mean(np.abs(error[near])),
        far=_mean(np.abs(error[far])),
        bias=_mean(error[used]),
        bias_near=_mean(error[near]),
        bias_far=_mean(error[far]),
        known=_percent(used, truth.interior),
        unseen_known=_percent(unseen, truth.unseen),
        unseen_wrong=int(wrong.sum()),
        dark_known=_percent(truth.dark & known, truth.dark),
        unsafe=int((traversable & (truth.unseen | truth.dark)).sum()),
    )


def made_up(terrain: gp.TerrainGrid, truth: Truth) -> int:
    """Count the traversable cells whose height is more than MADE_UP_M outside the range of their true heights."""
    height = np.asarray(terrain.elevation, np.float64)
    beyond = (height > truth.high + MADE_UP_M) | (height < truth.low - MADE_UP_M)
    return int(np.count_nonzero(beyond & (np.asarray(terrain.traversability) > 0)))


def _mean(values: npt.NDArray[np.float64]) -> float:
    return float(values.mean()) if values.size else np.nan


def _percent(part: npt.NDArray[np.bool_], whole: npt.NDArray[np.bool_]) -> float:
    return 100.0 * float(part.sum()) / float(whole.sum()) if whole.any() else 0.0
