"""Terrain grid from an orthorectified range image."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from guara_perception.arrays import Flags, Float, Mask
from guara_perception.exceptions import InvalidInput
from guara_perception.settings import RobotLike
from guara_perception.terrain.assessment.raster import merge, rasterise, without_cells
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK, Hazard
from guara_perception.terrain.layers.layered_grid import numbers
from guara_perception.terrain.scan.assess_terrain import HIGHEST_M
from guara_perception.terrain.scan.from_points import judged_grid, prepare_grid

# Largest accepted aspect ratio of a pixel. The ratio is 1.04 in the paper (0.879 mm x 0.844 mm), and 1.5 if the image
# is rotated by 90 degrees.
LARGEST_PIXEL_RATIO = 1.25


def terrain_from_range_image(
    ortho_image_mm: npt.ArrayLike,
    causes: npt.ArrayLike | None = None,
    *,
    sigma_mm: npt.ArrayLike | None = None,
    area: tuple[tuple[float, float], tuple[float, float]] = ((0.50, 0.95), (-0.27, 0.27)),
    robot: RobotLike | None = None,
    resolution: float | None = None,
    stamp: int = 0,
    step: int = 0,
) -> TerrainGrid:
    """Assess an orthorectified range image like a scan; return a grid of extent "footprint".

    A cell is known if it contains the centre of a known pixel and no pixel outside the height limits; nothing is
    interpolated. An image that was mirrored or scaled beforehand is not detected.

    Args:
        ortho_image_mm: (rows, columns) heights [mm above z = 0], row r along x, column c along y, NaN = unknown, as in
            `terrain.pictures["ortho_image_mm"]`.
        causes: (rows, columns) uint8 `Hazard` flags of the causes of unknown pixels, 0 where known. None, or 0 in an
            unknown pixel = UNSCANNED.
        sigma_mm: standard deviation of the heights, one number or (rows, columns) [mm]. None = exact heights: no cell
            is UNCERTAIN, and the tests have no margin for errors of the heights.
        area: ((x_min, x_max), (y_min, y_max)) covered by the image, in base_footprint [m].
        robot: model, name or folder; defines the limits of heights and traversability; None = the Guará.
        resolution: cell edge [m]; None = the robot's default. It must divide the area.
        stamp: time of the measurement [ns since the Unix epoch].
        step: number of the stance pause.

    Raises:
        InvalidInput: an argument is not numeric; the shape does not fit the area (pixels must be nearly square);
            heights are infinite or beyond 10 km; causes or sigma have another shape or values that are not allowed;
            causes contradict the heights; the area is invalid; the resolution is not positive, does not divide the area
            or gives too many cells.
        kinematics.KinematicsError: the robot cannot be loaded.
    """
    robot, settings, geometry = prepare_grid(robot, resolution, area)
    (x_min, x_max), (y_min, y_max) = area
    heights = _picture(ortho_image_mm, (x_max - x_min, y_max - y_min))
    known = np.isfinite(heights)
    flags = _causes(causes, known)
    variance = _sigma(sigma_mm, known) ** 2
    rows, columns = heights.shape
    x = x_min + (np.arange(rows) + 0.5) * (x_max - x_min) / rows
    y = y_min + (np.arange(columns) + 0.5) * (y_max - y_min) / columns
    points = np.dstack((*np.broadcast_arrays(x[:, None], y[None, :]), heights)).reshape(-1, 3)
    raster = merge([rasterise(points, variance.ravel(), geometry)], geometry)
    iy, ix = geometry.indices(x[:, None], y[None, :])
    hazard = np.zeros(geometry.shape, np.uint16)
    np.bitwise_or.at(hazard, (iy, ix), flags)
    with np.errstate(invalid="ignore"):
        beyond = (heights < settings.minimum_height) | (heights > settings.maximum_height)
    out = np.zeros(geometry.shape, dtype=bool)
    np.logical_or.at(out, (iy, ix), beyond)
    hazard[out] |= np.uint16(Hazard.OUT_OF_RANGE)
    raster = without_cells(raster, out)
    return judged_grid(raster, hazard, geometry, robot, "range_image", int(known.sum()), stamp, step)


def _picture(image_mm: npt.ArrayLike, size: tuple[float, float]) -> Float:
    """Heights (rows, columns) [m] from an image that covers an area of this size (along x, along y) [m]."""
    heights = numbers(image_mm, "ortho_image_mm") * 1e-3
    if heights.ndim != 2 or not heights.size:
        raise InvalidInput(f"ortho_image_mm has shape {heights.shape}, allowed: (rows along x, columns along y)")
    length, width = (edge / count for edge, count in zip(size, heights.shape, strict=True))
    if max(length, width) > LARGEST_PIXEL_RATIO * min(length, width):
        raise InvalidInput(
            f"ortho_image_mm has shape {heights.shape}, so pixels are {length * 1e3:.3g} x {width * 1e3:.3g} mm; the "
            f"ratio of the sides must not exceed {LARGEST_PIXEL_RATIO}. Rows must run along x and columns along y: "
            "transpose the image or correct `area`"
        )
    if np.isinf(heights).any() or (np.abs(heights) > HIGHEST_M).any():
        raise InvalidInput(
            f"ortho_image_mm contains heights that are infinite or beyond {HIGHEST_M * 1e3:.0f} mm, allowed: heights "
            "in mm, NaN for unknown"
        )
    return heights


def _causes(causes: npt.ArrayLike | None, known: Mask) -> Flags:
    """Flags (rows, columns) of the causes of unknown pixels; 0 in known pixels."""
    if causes is None:
        return np.where(known, 0, np.uint16(Hazard.UNSCANNED)).astype(np.uint16)
    given = numbers(causes, "causes")
    if given.shape != known.shape:
        raise InvalidInput(f"causes have shape {given.shape}; allowed: the shape {known.shape} of the heights")
    if not np.isin(given, np.arange(int(UNKNOWN_MASK) + 1)).all():
        raise InvalidInput(
            "causes contain flags other than those of unknown cells, allowed: combinations of the bits "
            f"{int(UNKNOWN_MASK):#x}"
        )
    flags = given.astype(np.uint16)
    if (flags[known] != 0).any():
        raise InvalidInput(
            f"causes contradict the heights: {np.count_nonzero(flags[known])} pixels have both a height and a cause "
            "for being unknown, allowed: 0 where the height is known"
        )
    flags[~known & (flags == 0)] = np.uint16(Hazard.UNSCANNED)
    return flags


def _sigma(sigma_mm: npt.ArrayLike | None, known: Mask) -> Float:
    """Standard deviations (rows, columns) [m], 0 where the height is unknown."""
    sigma = numbers(0.0 if sigma_mm is None else sigma_mm, "sigma_mm") * 1e-3
    if sigma.shape not in ((), known.shape):
        raise InvalidInput(
            f"sigma_mm has shape {sigma.shape}, allowed: one number or the shape {known.shape} of the heights"
        )
    sigma = np.where(known, sigma, 0.0)
    if not (np.isfinite(sigma) & (sigma >= 0)).all():
        raise InvalidInput("sigma_mm is NaN, infinite or negative at a known height, allowed: 0 or more [mm]")
    return sigma
