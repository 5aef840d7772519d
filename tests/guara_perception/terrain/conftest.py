"""Scans and walks for the tests of the terrain, made from heights without frames."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.settings import Settings, TraversabilityLimits
from guara_perception.terrain.assessment.assess import assess_layers
from guara_perception.terrain.assessment.raster import Raster
from guara_perception.terrain.layers.geometry import GridGeometry
from guara_perception.terrain.layers.record import ScanRecord, limits_to_dict
from kinematics import RobotModel

MakeScan = Callable[..., gp.TerrainGrid]


@pytest.fixture(scope="session")
def limits(robot: RobotModel) -> TraversabilityLimits:
    """Traversability limits of the Guará."""
    return Settings.of(robot).limits


@pytest.fixture(scope="session")
def scan_grid(robot: RobotModel) -> GridGeometry:
    """Geometry of a single scan."""
    settings = Settings.of(robot)
    return GridGeometry.over(settings.footprint_x, settings.footprint_y, settings.resolution)


@pytest.fixture(scope="session")
def make_scan(robot: RobotModel, scan_grid: GridGeometry, limits: TraversabilityLimits) -> MakeScan:
    """Grid of a scan from heights (one number or (ny, nx)) and unknown flags, without a stance in its metadata."""

    def make(
        heights: Any = 0.0,
        *,
        flags: Any = 0,
        step: int = 0,
        stamp: int | None = None,
        sigma: float = 0.0002,
        metadata: dict[str, Any] | None = None,
    ) -> gp.TerrainGrid:
        hazard = np.broadcast_to(np.asarray(flags, np.uint16), scan_grid.shape).copy()
        unknown = (hazard & 0xFF) != 0
        elevation = np.where(unknown, np.nan, np.broadcast_to(np.asarray(heights, np.float64), scan_grid.shape))
        variance = np.where(unknown, np.nan, sigma**2)
        layers = assess_layers(Raster(elevation, variance, elevation, elevation), hazard, scan_grid.resolution, limits)
        layers["age"] = np.where(unknown, 255, 0).astype(np.uint8)
        layers["looks"] = (~unknown).astype(np.uint8)
        return gp.TerrainGrid(
            layers=layers,
            geometry=scan_grid,
            step=step,
            stamp=step * 4_000_000_000 if stamp is None else stamp,
            record=ScanRecord.from_json({"robot": robot.name, "limits": limits_to_dict(limits), **(metadata or {})}),
        )

    return make
