"""Terrain grids from the points of other sensors, such as a depth camera."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from guara_perception.arrays import Flags, Float, Mask
from guara_perception.exceptions import InvalidInput
from guara_perception.settings import RobotLike, Settings, robot_model
from guara_perception.terrain.assessment.assess import assess_layers
from guara_perception.terrain.assessment.causes import behind_surface
from guara_perception.terrain.assessment.raster import Raster, cells_of, merge, rasterise, without_cells
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.layers.geometry import GridGeometry, cell_edge
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK, Hazard, cells_by_flag
from guara_perception.terrain.layers.layered_grid import numbers
from guara_perception.terrain.layers.record import Health, ScanRecord
from kinematics import RobotModel


def terrain_from_points(
    points: npt.ArrayLike,
    sigma: npt.ArrayLike,
    sensor_origin: npt.ArrayLike,
    robot: RobotLike | None = None,
    *,
    no_returns: npt.ArrayLike | None = None,
    resolution: float | None = None,
    stamp: int = 0,
    step: int = 0,
    metadata: Mapping[str, Any] | None = None,
) -> TerrainGrid:
    """Assess measured points like a scan; return a grid of extent "footprint" that `TerrainMap` accepts.

    A cell is known if it contains points, all of them within the height limits of the robot. Nothing is interpolated,
    so cells must not be smaller than the spacing of the points. An unknown cell is OUT_OF_RANGE if it contains points.
    Otherwise it is OCCLUDED if the measured surface hides it from the sensor, DROPOUT if a ray without a return meets
    it (both flags may be set), and UNSCANNED if neither applies.

    Args:
        points: (n, 3) in base_footprint [m]; rows with NaN or infinity are ignored. Remove points of the robot itself
            beforehand.
        sigma: standard deviation of the heights, a scalar or (n,) [m].
        sensor_origin: (3,) position of the sensor in base_footprint [m].
        robot: model, name or folder; defines area, height limits and traversability limits; None = the Guará.
        no_returns: (m, 3) directions in base_footprint of rays without a return, for instance of depth pixels without a
            value. A map forgets the cells that these rays meet at the lowest, median or highest known height, or at
            z = 0 if no cell is known. None = unknown: a map keeps such cells, and they age.
        resolution: cell edge [m]; None = the robot's default.
        stamp: time of the measurement [ns since the Unix epoch].
        step: number of the stance pause.
        metadata: further metadata fields, for instance `stance` and `transform_base_to_footprint` of the pause.

    Raises:
        InvalidInput: an array is not numeric or has the wrong shape, sigma is negative or not finite, the origin is
            not finite, or the resolution is not positive, does not divide the area or gives too many cells.
        kinematics.KinematicsError: the robot cannot be loaded.
    """
    robot, settings, geometry = prepare_grid(robot, resolution)
    cloud = _rows(points, "points")
    sigmas = numbers(sigma, "sigma")
    if sigmas.shape not in ((), (len(cloud),)) or not (np.isfinite(sigmas) & (sigmas >= 0)).all():
        raise InvalidInput("sigma must be one number or one for each point; allowed: finite, 0 or more [m]")
    sigmas = np.broadcast_to(sigmas, (len(cloud),))
    origin = numbers(sensor_origin, "sensor_origin")
    if origin.shape != (3,) or not np.isfinite(origin).all():
        raise InvalidInput(f"sensor_origin has shape {origin.shape}; it must be three finite numbers [m]")
    finite = np.isfinite(cloud).all(axis=1)
    cloud, sigmas = cloud[finite], sigmas[finite]
    within = (cloud[:, 2] >= settings.minimum_height) & (cloud[:, 2] <= settings.maximum_height)
    raster = merge([rasterise(cloud[within], sigmas[within] ** 2, geometry)], geometry)
    beyond = _cells_of(cloud[~within], geometry)
    # One point outside the height limits makes a cell unknown.
    raster = without_cells(raster, beyond)
    rays = _rows(no_returns, "no_returns") if no_returns is not None else np.empty((0, 3))
    hazard = _causes(raster, geometry, origin, beyond, rays)
    raster = without_cells(raster, (hazard & UNKNOWN_MASK) != 0)
    grid = judged_grid(raster, hazard, geometry, robot, "points", int(within.sum()), stamp, step)
    if not metadata:
        return grid
    return dataclasses.replace(grid, record=ScanRecord.from_json({**grid.record.to_json(), **metadata}))


def prepare_grid(
    robot: RobotLike | None, resolution: float | None, area: npt.ArrayLike | None = None
) -> tuple[RobotModel, Settings, GridGeometry]:
    """Robot (None = the Guará), its settings, and the geometry of a grid over an area (None = that of a scan).

    Raises:
        InvalidInput: the area does not consist of two finite and ascending ranges, or the resolution is not positive,
            does not divide the area or gives too many cells.
        kinematics.KinematicsError: the robot cannot be loaded.
    """
    model = robot_model("guara" if robot is None else robot)
    settings = Settings.of(model)
    ranges = numbers((settings.footprint_x, settings.footprint_y) if area is None else area, "area")
    if ranges.shape != (2, 2) or not np.isfinite(ranges).all() or not (ranges[:, 0] < ranges[:, 1]).all():
        raise InvalidInput(f"area is {area!r}, allowed: ((x_min, x_max), (y_min, y_max)), finite and ascending [m]")
    (x_min, x_max), (y_min, y_max) = ranges.tolist()
    cell = cell_edge(resolution, settings.resolution)
    return model, settings, GridGeometry.over((x_min, x_max), (y_min, y_max), cell)


def judged_grid(
    raster: Raster,
    hazard: Flags,
    geometry: GridGeometry,
    robot: RobotModel,
    method: str,
    points_used: int,
    stamp: int,
    step: int,
) -> TerrainGrid:
    """Assess rasterised heights like a scan; `hazard` contains the causes of the unknown cells."""
    settings = Settings.of(robot)
    layers = assess_layers(raster, hazard, geometry.resolution, settings.limits)
    seen = np.isfinite(layers["elevation"])
    record = ScanRecord(
        robot=robot.name,
        method=method,
        limits=settings.limits,
        validity_pauses=settings.validity_pauses,
        validity_seconds=settings.validity_seconds,
        points_used=points_used,
        coverage=float(seen.mean()),
        known=float(seen.mean()),
        hazard_cells=cells_by_flag(np.asarray(layers["hazard"], np.uint16)),
        health=Health.of(() if seen.any() else ("no point was used",)),
    )
    return TerrainGrid(layers=layers, geometry=geometry, record=record, stamp=stamp, step=step)


def _causes(raster: Raster, geometry: GridGeometry, origin: Float, beyond: Mask, rays: Float) -> Flags:
    """Flags of unknown cells and of cells with points outside the height limits; 0 elsewhere."""
    unknown = np.isnan(raster.elevation)
    flags = np.zeros(geometry.shape, np.uint16)
    known = ~unknown
    flags[unknown] = np.uint16(Hazard.UNSCANNED)
    # Without a known cell, the ground is assumed to be at the height of the soles.
    heights = np.zeros(1)
    if known.any():
        # Unknown ground is assumed to be as low as the lowest known ground, because lower ground is hidden more often.
        lowest = float(np.min(raster.low[known]))
        x, y = geometry.centres()
        iy, ix = np.nonzero(unknown)
        targets = np.column_stack((x[ix], y[iy], np.full(ix.size, lowest)))
        is_hidden = behind_surface(raster.high, targets, origin, geometry)
        flags[iy[is_hidden], ix[is_hidden]] = np.uint16(Hazard.OCCLUDED)
        heights = np.unique((lowest, float(np.median(raster.elevation[known])), float(np.max(raster.high[known]))))
    empty = rays[np.isfinite(rays).all(axis=1)]
    empty = empty[empty[:, 2] < 0]
    # The height at which the rays meet the ground is unknown, so they are intersected with the lowest, median and
    # highest known height.
    for height in heights:
        distance = (height - origin[2]) / empty[:, 2]
        hit = np.column_stack((origin[:2] + distance[:, None] * empty[:, :2], np.full(len(empty), height)))
        mask = _cells_of(hit[distance > 0], geometry) & unknown
        flags[mask] = (flags[mask] & ~np.uint16(Hazard.UNSCANNED)) | np.uint16(Hazard.DROPOUT)
    flags[beyond] = np.uint16(Hazard.OUT_OF_RANGE)
    return flags


def _cells_of(points: Float, geometry: GridGeometry) -> Mask:
    mask = np.zeros(geometry.shape, dtype=bool)
    mask.ravel()[cells_of(points, geometry)[0]] = True
    return mask


def _rows(values: npt.ArrayLike, name: str) -> Float:
    array = numbers(values, name)
    if array.ndim != 2 or array.shape[1] != 3:
        raise InvalidInput(f"{name} have shape {array.shape}; allowed: (n, 3)")
    return array
