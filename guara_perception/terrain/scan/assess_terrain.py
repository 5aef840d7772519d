"""Terrain grid from any elevation array."""

from __future__ import annotations

from functools import cache

import numpy as np
import numpy.typing as npt

from guara_perception.arrays import Float
from guara_perception.exceptions import InvalidInput
from guara_perception.settings import Settings, TraversabilityLimits
from guara_perception.terrain.assessment.assess import assess_layers
from guara_perception.terrain.assessment.raster import Raster
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.layers.geometry import GridGeometry
from guara_perception.terrain.layers.hazard import Hazard
from guara_perception.terrain.layers.layered_grid import numbers
from guara_perception.terrain.layers.record import ScanRecord
from kinematics import load_robot

# Largest magnitude of a height; above it the roughness is lost in rounding errors, which reach 0.3 mm at 10 km.
HIGHEST_M = 1e4


def assess_terrain(
    elevation: npt.ArrayLike,
    resolution: float,
    origin: tuple[float, float] = (0.0, 0.0),
    variance: npt.ArrayLike | None = None,
    limits: TraversabilityLimits | None = None,
    *,
    lowest: npt.ArrayLike | None = None,
    highest: npt.ArrayLike | None = None,
) -> TerrainGrid:
    """Assess any elevation array as if the rangefinder had measured it.

    Args:
        elevation: (ny, nx) heights [m], indexed [iy, ix]; NaN or masked = unknown, flagged UNSCANNED.
        resolution: cell edge [m].
        origin: corner (x, y) of cell (0, 0) with the smallest coordinates [m].
        variance: (ny, nx) variances of the heights [m^2]; None = exact.
        limits: traversability limits; None = those of the Guará's robot.toml.
        lowest, highest: (ny, nx) lowest and highest height measured in each cell [m]; None = `elevation`. They show
            edges within coarse cells.

    Raises:
        InvalidInput: an array is not numeric or has the wrong shape; resolution, origin or limits are invalid; an
            elevation is infinite or beyond 10 km; or, where the height is known, the variance is NaN, infinite or
            negative, or the lowest or highest height is missing, infinite or on the wrong side of `elevation`.
    """
    heights, variances = check_heights(elevation, variance)
    low, high = _bound(lowest, "lowest", heights, -1), _bound(highest, "highest", heights, 1)
    try:
        (x, y), edge = map(float, origin), float(resolution)
    except (TypeError, ValueError):
        raise InvalidInput(
            f"resolution is {resolution!r}, origin is {origin!r}: one number and a pair (x, y) are needed"
        ) from None
    geometry = GridGeometry((x, y), edge, (heights.shape[0], heights.shape[1]))
    known = np.isfinite(heights)
    hazard = np.where(known, 0, np.uint16(Hazard.UNSCANNED)).astype(np.uint16)
    if limits is None:
        limits = default_limits()
    elif not isinstance(limits, TraversabilityLimits):
        raise InvalidInput(f"limits is {limits!r}, allowed: TraversabilityLimits, or None for those of the Guará")
    layers = assess_layers(Raster(heights, variances, low, high), hazard, geometry.resolution, limits)
    return TerrainGrid(layers=layers, geometry=geometry, record=ScanRecord(limits=limits))


def _bound(bound: npt.ArrayLike | None, name: str, heights: Float, side: int) -> Float:
    """Check the lowest (side -1) or highest (side 1) heights of the cells, and return them as a float64 grid."""
    if bound is None:
        return heights
    bounds = numbers(bound, name)
    known = np.isfinite(heights)
    if (
        bounds.shape != heights.shape
        or not (np.isfinite(bounds[known]) & (side * (bounds[known] - heights[known]) >= 0)).all()
    ):
        beyond = "at or below" if side < 0 else "at or above"
        raise InvalidInput(
            f"{name} has shape {bounds.shape}; allowed: the shape of elevation, {heights.shape}, and in known cells "
            f"finite heights {beyond} elevation [m]"
        )
    return np.where(known, bounds, np.nan)


@cache
def default_limits() -> TraversabilityLimits:
    """Limits of the Guará, cached because reading them takes longer than assessing a grid."""
    return Settings.of(load_robot("guara")).limits


def check_heights(elevation: npt.ArrayLike, variance: npt.ArrayLike | None) -> tuple[Float, Float]:
    """Convert elevation and variance to float64 grids and check them.

    Raises:
        InvalidInput: the values are not numbers or have the wrong shape, a height is infinite or beyond HIGHEST_M, or
            the variance of a known height is NaN, infinite or negative.
    """
    heights = numbers(elevation, "elevation")
    if heights.ndim != 2 or heights.size == 0:
        raise InvalidInput(f"elevation has shape {heights.shape}; it must be (ny, nx) with one cell or more")
    if np.isinf(heights).any():
        raise InvalidInput("elevation contains infinite heights: use NaN for unknown cells")
    known = np.isfinite(heights)
    if known.any() and np.abs(heights[known]).max() > HIGHEST_M:
        raise InvalidInput(
            f"elevation reaches {np.abs(heights[known]).max():.4g} m; at most {HIGHEST_M:.0f} m is allowed: "
            "give metres, and subtract a common height first"
        )
    variances = np.where(known, 0.0, np.nan) if variance is None else numbers(variance, "variance")
    if variances.shape != heights.shape:
        raise InvalidInput(f"variance has shape {variances.shape}, elevation has {heights.shape}: they must be equal")
    if (~np.isfinite(variances[known])).any() or (variances[known] < 0).any():
        raise InvalidInput("variance is NaN, infinite or negative at a known height; it must be 0 or more [m^2]")
    return heights, np.where(known, variances, np.nan)
