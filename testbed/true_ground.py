"""True grids: the grid of a simulated world that a map would have if all ground were known exactly."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

import guara_perception as gp
from guara_perception.arrays import Float, Mask
from guara_perception.settings import Settings
from guara_perception.simulation.features import material_index
from guara_perception.simulation.world import World
from guara_perception.terrain.assessment.assess import assess_layers
from guara_perception.terrain.assessment.raster import Raster
from guara_perception.terrain.layers.geometry import GridGeometry
from guara_perception.terrain.layers.record import ScanRecord, limits_to_dict
from kinematics import RobotModel

CELL_M = 0.001
# The elevation of a cell is the mean of the heights within this distance of its highest point, as in scans.
TOP_LAYER_M = 0.004
# Width of the margin around the grid that is assessed too, so that the border does not affect cells.
BEYOND_M = 0.100


@dataclass(frozen=True)
class TrueGround:
    """Raster of ground in millimetre cells.

    Attributes:
        corner: x and y of the corner of cell (0, 0), at minimum x and y [m].
        heights: (ny, nx) heights [m].
        is_dark: (ny, nx) mask of the ground that absorbs the laser light.
    """

    corner: tuple[float, float]
    heights: npt.NDArray[np.float32]
    is_dark: Mask

    @staticmethod
    def of(world: World) -> TrueGround:
        """Rasterise a whole world."""
        heights, materials = world.raster(world.x, world.y, CELL_M)
        corner = world.x[0], world.y[0]
        return TrueGround(corner, heights.astype(np.float32), materials == material_index("dark"))

    @staticmethod
    def under(scan: Path) -> TrueGround:
        """Read the ground of a rendered scan (`truth.npz` in its folder), in base_footprint of the scan."""
        with np.load(scan / "truth.npz", allow_pickle=False) as truth:
            x, y = (float(truth[axis][0]) - CELL_M / 2 for axis in ("x", "y"))
            return TrueGround((x, y), truth["elevation"], truth["dark"])

    def grid(
        self, transform_footprint_to_world: Float, geometry: GridGeometry, robot: RobotModel, **metadata: object
    ) -> tuple[gp.TerrainGrid, Mask]:
        """Create the true grid in a footprint, and a mask of its cells that are at least partly dark.

        The grid is assessed with the robot's limits and sole, without variance, and with the ground beyond its border.
        """
        settings = Settings.of(robot)
        per_cell = round(geometry.resolution / CELL_M)
        beyond = round(BEYOND_M / geometry.resolution)
        ny, nx = (n + 2 * beyond for n in geometry.shape)
        x = geometry.origin[0] - BEYOND_M + (np.arange(nx * per_cell) + 0.5) * CELL_M
        y = geometry.origin[1] - BEYOND_M + (np.arange(ny * per_cell) + 0.5) * CELL_M
        transform = transform_footprint_to_world
        columns, rows = (
            ((np.add.outer(transform[i, 1] * y, transform[i, 0] * x) + transform[i, 3] - low) / CELL_M - 0.5).astype(
                np.float32
            )
            for i, low in enumerate(self.corner)
        )
        world_z = cv2.remap(self.heights, columns, rows, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE)
        dark = cv2.remap(self.is_dark.astype(np.uint8), columns, rows, cv2.INTER_NEAREST)
        plane_z = np.add.outer(transform[2, 1] * y, transform[2, 0] * x) + transform[2, 3]
        height = (world_z - plane_z) / transform[2, 2]

        def cells(values: npt.NDArray[np.generic]) -> npt.NDArray[np.generic]:
            return values.reshape(ny, per_cell, nx, per_cell).swapaxes(1, 2).reshape(ny, nx, -1)

        samples = cells(height)
        high, low = samples.max(axis=-1), samples.min(axis=-1)
        on_top = samples > high[..., None] - TOP_LAYER_M
        mean = np.where(on_top, samples, 0.0).sum(axis=-1) / on_top.sum(axis=-1)
        raster = Raster(mean, np.zeros(mean.shape), low, high)
        layers = assess_layers(raster, np.zeros(mean.shape, np.uint16), geometry.resolution, settings.limits)
        inner = np.s_[beyond:-beyond, beyond:-beyond]
        cut = {name: np.ascontiguousarray(layer[inner]) for name, layer in layers.items()}
        cut["age"] = np.zeros(geometry.shape, np.uint8)
        cut["looks"] = np.ones(geometry.shape, np.uint8)
        grid = gp.TerrainGrid(
            layers=cut,
            geometry=geometry,
            extent="map",
            record=ScanRecord.from_json({"robot": robot.name, "limits": limits_to_dict(settings.limits), **metadata}),
        )
        return grid, np.asarray(cells(dark)[inner].any(axis=-1))
