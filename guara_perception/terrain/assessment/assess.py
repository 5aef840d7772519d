"""Assessment of heights: slope, step, roughness, clearance, traversability and hazards of every cell."""

from __future__ import annotations

import cv2
import numpy as np

from guara_perception.arrays import Array, Flags, Float, Float32, Index, Mask
from guara_perception.settings import TraversabilityLimits
from guara_perception.terrain.assessment.disc import clearance, edge_cells, fit_disc
from guara_perception.terrain.assessment.raster import Raster
from guara_perception.terrain.layers.geometry import (
    EXTRA_RING_CELLS,
    LARGEST_DRIFT_CELLS,
    Kernel,
    disc_kernel,
    half_cells,
)
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK, Hazard

# Minimum score of a safe cell, because 0 is reserved for hazards and unknown cells.
LEAST_SAFE_SCORE = 0.01
# Number of cells in a block of rows, chosen to fit the processor's cache. All tests are local, so the blocks do not
# change the result.
BLOCK_CELLS = 60_000
# Minimum height of a block in multiples of its margin; rows of the margin are assessed twice.
LEAST_MARGINS = 6


def assess_layers(
    raster: Raster,
    hazard: Flags,
    resolution: float,
    limits: TraversabilityLimits,
    drift: Index | None = None,
    *,
    shared: Float | float = 0.0,
    attitude_sigma: float = 0.0,
    beyond: int = 0,
) -> dict[str, Array]:
    """Compute all layers of a grid from its heights.

    Every test reads a fixed window. A cell gets EDGE if a sole centred on it would cover a hazard, or if the window of
    any cell under this sole contains an unknown cell or extends off the grid. The loss of an observation therefore
    never makes another cell safe.

    Args:
        raster: heights, local variances (the part that neighbouring cells do not share), lowest and highest samples.
        hazard: (ny, nx) uint16 initial flags: causes of unknown cells, and flags such as SOFT, CONFLICT and STALE.
        resolution: cell edge [m].
        limits: traversability limits.
        drift: (ny, nx, 2) possible drift of each cell of the fused map along y and x [cells]; None for a single scan.
        shared: (ny, nx) variance shared by neighbouring cells [m^2]. It is part of `variance`; no test uses it.
        attitude_sigma: standard deviation of the frame's tilt relative to gravity, per axis [rad].
        beyond: width of a margin on each side that the tests read but the returned layers do not contain [cells].

    Returns:
        All layers by name, read-only, in the types of `LAYERS`, with age and looks of a single scan.

    Raises:
        InvalidInput: the radius of the disc is too large for these cells, see `disc_kernel`.
    """
    known = np.isfinite(raster.elevation)
    # Known cells have no cause, and unknown cells without a cause get UNSCANNED.
    flags = np.where(known, hazard & ~UNKNOWN_MASK, hazard).astype(np.uint16)
    flags[~known & ((hazard & UNKNOWN_MASK) == 0)] |= np.uint16(Hazard.UNSCANNED)
    # Cells outside the range of known cells are unknown, which is equivalent to being off the grid.
    window = _extent(known, axis=0), _extent(known, axis=1)
    drift = None if drift is None else np.ascontiguousarray(drift[window])
    own_flags = np.ascontiguousarray(flags[window])
    judged = _assess_in_blocks(raster.window(window), own_flags, resolution, limits, drift, attitude_sigma)
    layers: dict[str, Array] = {}
    for name, values in judged.items():
        layers[name] = flags if name == "hazard" else np.full(known.shape, _unknown(name), np.float32)
        layers[name][window] = values
    layers["variance"] = (layers["variance_local"] + shared).astype(np.float32)
    if beyond:
        inner = np.s_[beyond:-beyond, beyond:-beyond]
        layers = {name: np.ascontiguousarray(layer[inner]) for name, layer in layers.items()}
        flags = layers["hazard"]
        off_grid = _sole_off_grid(flags.shape, resolution, limits) & ((flags & UNKNOWN_MASK) == 0)
        flags[off_grid] |= np.uint16(Hazard.EDGE)
        layers["traversability"][off_grid] = 0.0
    known = np.isfinite(layers["elevation"])
    layers |= {
        "clearance": clearance(layers["hazard"], resolution).astype(np.float32),
        "age": np.where(known, 0, 255).astype(np.uint8),
        "looks": known.astype(np.uint8),
        "ceiling": np.full(known.shape, np.nan, np.float32),
    }
    for layer in layers.values():
        # A grid does not copy read-only layers.
        layer.setflags(write=False)
    return layers


def _unknown(layer: str) -> float:
    """Value of unknown cells."""
    return 0.0 if layer == "traversability" else np.nan


def _sole_off_grid(shape: tuple[int, ...], resolution: float, limits: TraversabilityLimits) -> Mask:
    """Mask of the cells on which a sole would extend beyond the border."""
    y, x = (half_cells(length, resolution) for length in (limits.sole_width, limits.sole_length))
    result = np.ones(shape, dtype=bool)
    result[y : max(shape[0] - y, 0), x : max(shape[1] - x, 0)] = False
    return result


def _extent(known: Mask, axis: int) -> slice:
    """Range of the rows (axis 0) or columns (axis 1) with known cells; the first row or column if there are none."""
    occupied = np.flatnonzero(known.any(axis=1 - axis))
    return slice(int(occupied[0]), int(occupied[-1]) + 1) if occupied.size else slice(0, 1)


def _assess_in_blocks(
    raster: Raster,
    flags: Flags,
    resolution: float,
    limits: TraversabilityLimits,
    drift: Index | None,
    attitude_sigma: float,
) -> dict[str, Array]:
    """Layers that depend on heights (not clearance, total variance, age, looks, ceiling), in blocks of rows."""
    kernel = disc_kernel(limits.disc_radius / resolution)
    ny, nx = flags.shape
    margin = half_cells(limits.sole_width, resolution) + 2 * (kernel.shape[0] // 2)
    margin += max(EXTRA_RING_CELLS, LARGEST_DRIFT_CELLS)
    rows = max(BLOCK_CELLS // nx, LEAST_MARGINS * margin)
    blocks = []
    for start in range(0, ny, rows):
        first, end = max(start - margin, 0), min(start + rows + margin, ny)
        drifted = None if drift is None else drift[first:end]
        part = raster.window(np.s_[first:end, :])
        block = _assess_discs(part, flags[first:end], kernel, resolution, limits, attitude_sigma)
        hazard = block["hazard"]
        edge = edge_cells(hazard, kernel, resolution, limits, drifted) & ((hazard & UNKNOWN_MASK) == 0)
        hazard[edge] |= np.uint16(Hazard.EDGE)
        block["traversability"][edge] = 0.0
        blocks.append({name: layer[start - first : start - first + rows] for name, layer in block.items()})
    return blocks[0] if len(blocks) == 1 else {name: np.concatenate([b[name] for b in blocks]) for name in blocks[0]}


def _assess_discs(
    raster: Raster,
    flags: Flags,
    kernel: Kernel,
    resolution: float,
    limits: TraversabilityLimits,
    attitude_sigma: float,
) -> dict[str, Array]:
    """Layers of `_assess_in_blocks` without EDGE, computed from a disc around each cell.

    Args:
        raster, resolution, limits, attitude_sigma: as in `assess_layers`.
        flags: initial flags, with a cause in exactly the unknown cells.
        kernel: the disc. Cells closer to the border than its radius get other values than in a larger grid.
    """
    known = (flags & UNKNOWN_MASK) == 0
    # Only known cells are computed, often a quarter of a map. Results are stored in single precision at once, which
    # saves most of the memory.
    index = np.flatnonzero(known)

    def layer(name: str, values: Float) -> Float32:
        whole = np.full(flags.shape, _unknown(name), dtype=np.float32)
        whole.reshape(-1)[index] = values
        return whole

    fit = fit_disc(raster.elevation, raster.variance, kernel, resolution)
    slope_layer, roughness_layer = layer("slope", fit.slope), layer("roughness", fit.roughness)
    k = limits.confidence
    slope = fit.slope + k * np.hypot(fit.slope_sigma, attitude_sigma)
    roughness = fit.roughness + k * fit.roughness_sigma
    del fit
    rise, fall = rises(raster.low, raster.high, known, kernel)
    step_layer = layer("step_height", np.maximum(rise, fall))
    sigma = np.sqrt(raster.variance.take(index))
    step_sigma = k * np.sqrt(2.0) * sigma
    # From here on, rise and fall include their uncertainty.
    rise += step_sigma
    fall += step_sigma

    found = flags.take(index)
    with np.errstate(invalid="ignore"):
        tests = {
            Hazard.STEEP: slope > limits.slope,
            Hazard.STEP: rise > limits.step,
            Hazard.DROP: fall > limits.drop,
            Hazard.ROUGH: roughness > limits.roughness,
            Hazard.UNCERTAIN: sigma > limits.sigma,
        }
        for flag, failed in tests.items():
            found |= failed * np.uint16(flag)
        score = _score(slope, limits.slope) * _score(rise, limits.step)
        score *= _score(fall, limits.drop) * _score(roughness, limits.roughness)
    del slope, roughness, rise, fall, sigma, step_sigma
    hazard = flags.copy()
    hazard.reshape(-1)[index] = found
    return {
        "elevation": layer("elevation", raster.elevation.take(index)),
        "variance_local": layer("variance_local", raster.variance.take(index)),
        "elevation_min": layer("elevation_min", raster.low.take(index)),
        "elevation_max": layer("elevation_max", raster.high.take(index)),
        "slope": slope_layer,
        "step_height": step_layer,
        "roughness": roughness_layer,
        "traversability": layer("traversability", np.where(found == 0, np.maximum(score, LEAST_SAFE_SCORE), 0.0)),
        "hazard": hazard,
    }


def rises(low: Float, high: Float, known: Mask, kernel: Kernel) -> tuple[Float, Float]:
    """Largest rise and largest fall (n,) from each known cell to any known cell of its window [m].

    They are computed from lowest and highest samples, so that a step within one cell counts.
    """
    far = 1e3
    highest = cv2.dilate(np.where(known, high, -far), kernel, borderType=cv2.BORDER_CONSTANT, borderValue=(-far,))
    lowest = cv2.erode(np.where(known, low, far), kernel, borderType=cv2.BORDER_CONSTANT, borderValue=(far,))
    index = np.flatnonzero(known)
    return highest.take(index) - low.take(index), high.take(index) - lowest.take(index)


def _score(value: Float, limit: float) -> Float:
    """Score that decreases from 1 at zero to 0 at the limit; 0 for NaN."""
    return np.minimum(np.fmax(1.0 - value / limit, 0.0), 1.0)
