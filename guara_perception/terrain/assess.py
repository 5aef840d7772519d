"""From heights to hazards: slope, step, roughness, clearance and traversability of every cell."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from guara_perception.exceptions import InvalidInput
from guara_perception.settings import TraversabilityLimits
from guara_perception.terrain.disc import disc_kernel, fit_disc
from guara_perception.terrain.hazard import ALL_BUT_EDGE, UNKNOWN_MASK, Hazard

Float = npt.NDArray[np.float64]
Flags = npt.NDArray[np.uint16]

# A safe cell keeps a positive score however close to its limits it is: 0 is reserved for hazards.
LEAST_SAFE_SCORE = 0.01
# The value of a cell may change when something is lost beside it, so one more ring must be known.
EXTRA_RING_CELLS = 1


def assess_layers(
    elevation: Float,
    variance: Float,
    low: Float,
    high: Float,
    hazard: Flags,
    resolution: float,
    limits: TraversabilityLimits,
) -> dict[str, npt.NDArray[Any]]:
    """Judge every cell; return all layers of a grid that follow from the heights.

    Every test reads a fixed window. A cell whose windows, or those of the cells its sole would cover, are not wholly
    known gets EDGE whatever the values say: so losing an observation never makes another cell safe.

    Args:
        elevation, variance, low, high: (ny, nx) heights [m], variances [m^2], lowest and highest sample [m].
        hazard: (ny, nx) uint16, flags known beforehand (causes of unknown, CONFLICT, STALE).
        resolution: cell edge [m].
        limits: what the feet can bear.

    Returns:
        Layers by name, in the types of the contract: elevation, variance, elevation_min, elevation_max, slope,
        step_height, roughness, clearance, traversability, hazard.
    """
    flags = np.where(np.isfinite(elevation), hazard & ~UNKNOWN_MASK, hazard).astype(np.uint16)
    flags[~np.isfinite(elevation) & ((hazard & UNKNOWN_MASK) == 0)] |= np.uint16(Hazard.UNSCANNED)
    known = (flags & UNKNOWN_MASK) == 0
    kernel = disc_kernel(limits.disc_radius / resolution)
    rise, fall = steps(low, high, known, kernel)
    fit = fit_disc(elevation, variance, kernel, resolution)
    sigma = np.sqrt(variance)
    k = limits.confidence
    step_sigma = k * np.sqrt(2.0) * sigma

    with np.errstate(invalid="ignore"):
        tests = {
            Hazard.STEEP: fit.slope + k * fit.slope_sigma > limits.slope,
            Hazard.STEP: rise + step_sigma > limits.step,
            Hazard.DROP: fall + step_sigma > limits.drop,
            Hazard.ROUGH: fit.roughness > limits.roughness,
            Hazard.UNCERTAIN: sigma > limits.sigma,
        }
        for flag, failed in tests.items():
            flags[known & failed] |= np.uint16(flag)
        score = (
            _score(fit.slope + k * fit.slope_sigma, limits.slope)
            * _score(rise + step_sigma, limits.step)
            * _score(fall + step_sigma, limits.drop)
            * _score(fit.roughness, limits.roughness)
        )
    flags[known & edge_cells(flags, kernel, resolution, limits)] |= np.uint16(Hazard.EDGE)
    safe = flags == 0
    nan = np.where(known, 0.0, np.nan)
    return {
        "elevation": (elevation + nan).astype(np.float32),
        "variance": (variance + nan).astype(np.float32),
        "elevation_min": (low + nan).astype(np.float32),
        "elevation_max": (high + nan).astype(np.float32),
        "slope": (fit.slope + nan).astype(np.float32),
        "step_height": np.maximum(rise, fall).astype(np.float32),
        "roughness": (fit.roughness + nan).astype(np.float32),
        "clearance": clearance(flags, resolution).astype(np.float32),
        "traversability": np.where(safe, np.clip(score, LEAST_SAFE_SCORE, 1.0), 0.0).astype(np.float32),
        "hazard": flags,
    }


def steps(low: Float, high: Float, known: npt.NDArray[np.bool_], kernel: npt.NDArray[np.uint8]) -> tuple[Float, Float]:
    """Largest rise and largest fall from each cell to any known cell of its window [m], NaN where unknown.

    Lowest and highest samples are used, so a step inside one cell counts too.
    """
    far = 1e3
    highest = cv2.dilate(np.where(known, high, -far), kernel, borderType=cv2.BORDER_CONSTANT, borderValue=(-far,))
    lowest = cv2.erode(np.where(known, low, far), kernel, borderType=cv2.BORDER_CONSTANT, borderValue=(far,))
    nan = np.where(known, 0.0, np.nan)
    return np.asarray(highest - low + nan), np.asarray(high - lowest + nan)


def edge_cells(
    flags: Flags, kernel: npt.NDArray[np.uint8], resolution: float, limits: TraversabilityLimits
) -> npt.NDArray[np.bool_]:
    """Cells where the sole would cover, or a test would read, something unknown, hazardous or off the grid."""
    half_x = _half_cells(limits.sole_length, resolution)
    half_y = _half_cells(limits.sole_width, resolution)
    sole = np.ones((2 * half_y + 1, 2 * half_x + 1), np.uint8)
    reach = kernel.shape[0] // 2 + EXTRA_RING_CELLS
    window = np.ones((2 * (half_y + reach) + 1, 2 * (half_x + reach) + 1), np.uint8)
    bad = ((flags & ALL_BUT_EDGE) != 0).astype(np.uint8)
    unknown = ((flags & UNKNOWN_MASK) != 0).astype(np.uint8)

    def reaches(cells: npt.NDArray[np.uint8], area: npt.NDArray[np.uint8]) -> npt.NDArray[np.bool_]:
        return np.asarray(cv2.dilate(cells, area, borderType=cv2.BORDER_CONSTANT, borderValue=(1,)), dtype=bool)

    return reaches(bad, sole) | reaches(unknown, window)


def clearance(flags: Flags, resolution: float) -> Float:
    """Signed distance to the nearest cell that carries a flag other than EDGE, or to the border [m]; negative inside.

    Distances are from cell centre to the nearer face of the other cell, hence the half cells.
    """
    ny, nx = flags.shape
    bad = (flags & ALL_BUT_EDGE) != 0
    iy, ix = np.arange(ny)[:, None], np.arange(nx)[None, :]
    to_border = np.minimum(np.minimum(iy, ny - 1 - iy), np.minimum(ix, nx - 1 - ix)) + 0.5
    outside = to_border.astype(np.float64)
    inside = np.zeros((ny, nx))
    if bad.any():
        outside = np.minimum(outside, _distance_cells(~bad) - 0.5)
    if not bad.all():
        inside = _distance_cells(bad) - 0.5
    else:
        inside = to_border
    return np.where(bad, -inside, outside) * resolution


def _distance_cells(mask: npt.NDArray[np.bool_]) -> Float:
    return cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE).astype(np.float64)


def _half_cells(length: float, resolution: float) -> int:
    """Cells to each side of the centre cell that a sole of this length touches."""
    return int(np.ceil((length / 2 - resolution / 2) / resolution - 1e-9)) if length > resolution else 0


def _score(value: Float, limit: float) -> Float:
    return np.clip(1.0 - np.nan_to_num(value, nan=np.inf) / limit, 0.0, 1.0)


def check_heights(elevation: npt.ArrayLike, variance: npt.ArrayLike | None) -> tuple[Float, Float]:
    """Elevation and variance as float64 grids, or a clear refusal.

    Raises:
        InvalidInput: wrong shape, infinite heights, negative or missing variance at a known height.
    """
    heights = np.array(elevation, dtype=np.float64)
    if heights.ndim != 2 or heights.size == 0:
        raise InvalidInput(f"elevation has shape {heights.shape}, it must be (ny, nx) with one cell or more")
    if np.isinf(heights).any():
        raise InvalidInput("elevation holds infinite heights, use NaN for unknown cells")
    known = np.isfinite(heights)
    spread = np.where(known, 0.0, np.nan) if variance is None else np.array(variance, dtype=np.float64)
    if spread.shape != heights.shape:
        raise InvalidInput(f"variance has shape {spread.shape}, elevation has {heights.shape}: they must be alike")
    if (~np.isfinite(spread[known])).any() or (spread[known] < 0).any():
        raise InvalidInput("variance is NaN, infinite or negative at a known height, it must be 0 or more [m^2]")
    return heights, np.where(known, spread, np.nan)
