"""From heights to hazards: slope, step, roughness, clearance and traversability of every cell."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from guara_perception.settings import TraversabilityLimits
from guara_perception.terrain.disc import Kernel, disc_kernel, fit_disc
from guara_perception.terrain.edges import EXTRA_RING_CELLS, clearance, edge_cells, half_cells
from guara_perception.terrain.hazard import UNKNOWN_MASK, Hazard

Float = npt.NDArray[np.float64]
Flags = npt.NDArray[np.uint16]

# A safe cell keeps a positive score however close to its limits it is: 0 is reserved for hazards.
LEAST_SAFE_SCORE = 0.01
# Large grids are judged in bands of rows that fit the cache; as every test is local, the result is the same.
BAND_CELLS = 60_000
# The rows that a band shares with its neighbours are judged twice: wide grids get bands of so many halos at least.
LEAST_HALOS = 6


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
    kernel = disc_kernel(limits.disc_radius / resolution)
    ny, nx = elevation.shape
    halo = half_cells(limits.sole_width, resolution) + 2 * (kernel.shape[0] // 2) + EXTRA_RING_CELLS
    rows = max(BAND_CELLS // nx, LEAST_HALOS * halo)
    bands = []
    for start in range(0, ny, rows):
        first, end = max(start - halo, 0), min(start + rows + halo, ny)
        part = slice(first, end)
        band = _assess_band(
            elevation[part], variance[part], low[part], high[part], hazard[part], kernel, resolution, limits
        )
        bands.append({name: layer[start - first : start - first + rows] for name, layer in band.items()})
    layers = bands[0] if len(bands) == 1 else {name: np.concatenate([b[name] for b in bands]) for name in bands[0]}
    return {**layers, "clearance": clearance(layers["hazard"], resolution).astype(np.float32)}


def _assess_band(
    elevation: Float,
    variance: Float,
    low: Float,
    high: Float,
    hazard: Flags,
    kernel: Kernel,
    resolution: float,
    limits: TraversabilityLimits,
) -> dict[str, npt.NDArray[Any]]:
    """All layers but the clearance for a band of rows; within a halo of its first and last row they are not valid."""
    flags = np.where(np.isfinite(elevation), hazard & ~UNKNOWN_MASK, hazard).astype(np.uint16)
    flags[~np.isfinite(elevation) & ((hazard & UNKNOWN_MASK) == 0)] |= np.uint16(Hazard.UNSCANNED)
    known = (flags & UNKNOWN_MASK) == 0
    # What follows is told of the known cells alone, often a quarter of a map.
    place = np.flatnonzero(known)
    every_rise, every_fall = steps(low, high, known, kernel)
    rise, fall = every_rise.reshape(-1)[place], every_fall.reshape(-1)[place]
    fit = fit_disc(elevation, variance, kernel, resolution)
    fitted_slope, fitted_roughness = fit.slope.reshape(-1)[place], fit.roughness.reshape(-1)[place]
    sigma = np.sqrt(variance.reshape(-1)[place])
    k = limits.confidence
    step_sigma = k * np.sqrt(2.0) * sigma
    slope = fitted_slope + k * fit.slope_sigma.reshape(-1)[place]
    roughness = fitted_roughness + k * fit.roughness_sigma.reshape(-1)[place]

    found = np.zeros(place.size, dtype=np.uint16)
    with np.errstate(invalid="ignore"):
        tests = {
            Hazard.STEEP: slope > limits.slope,
            Hazard.STEP: rise + step_sigma > limits.step,
            Hazard.DROP: fall + step_sigma > limits.drop,
            Hazard.ROUGH: roughness > limits.roughness,
            Hazard.UNCERTAIN: sigma > limits.sigma,
        }
        for flag, failed in tests.items():
            found[failed] |= np.uint16(flag)
        score = (
            _score(slope, limits.slope)
            * _score(rise + step_sigma, limits.step)
            * _score(fall + step_sigma, limits.drop)
            * _score(roughness, limits.roughness)
        )
    flags.reshape(-1)[place] |= found
    flags[known & edge_cells(flags, kernel, resolution, limits)] |= np.uint16(Hazard.EDGE)
    safe = flags.reshape(-1)[place] == 0

    def layer(values: Float, unknown: float = np.nan) -> npt.NDArray[np.float32]:
        whole = np.full(elevation.shape, unknown, dtype=np.float32)
        whole.reshape(-1)[place] = values
        return whole

    return {
        "elevation": layer(elevation.reshape(-1)[place]),
        "variance": layer(variance.reshape(-1)[place]),
        "elevation_min": layer(low.reshape(-1)[place]),
        "elevation_max": layer(high.reshape(-1)[place]),
        "slope": layer(fitted_slope),
        "step_height": layer(np.maximum(rise, fall)),
        "roughness": layer(fitted_roughness),
        "traversability": layer(np.where(safe, np.clip(score, LEAST_SAFE_SCORE, 1.0), 0.0), 0.0),
        "hazard": flags,
    }


def steps(low: Float, high: Float, known: npt.NDArray[np.bool_], kernel: Kernel) -> tuple[Float, Float]:
    """Largest rise and largest fall from each cell to any known cell of its window [m], NaN where unknown.

    Lowest and highest samples are used, so a step inside one cell counts too.
    """
    far = 1e3
    highest = cv2.dilate(np.where(known, high, -far), kernel, borderType=cv2.BORDER_CONSTANT, borderValue=(-far,))
    lowest = cv2.erode(np.where(known, low, far), kernel, borderType=cv2.BORDER_CONSTANT, borderValue=(far,))
    nan = np.where(known, 0.0, np.nan)
    return np.asarray(highest - low + nan), np.asarray(high - lowest + nan)


def _score(value: Float, limit: float) -> Float:
    return np.clip(1.0 - np.nan_to_num(value, nan=np.inf) / limit, 0.0, 1.0)
