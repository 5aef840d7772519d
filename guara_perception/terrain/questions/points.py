"""Other forms of a grid: points, an xarray data set, heights under given points, coarser cells."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from guara_perception.arrays import Float, Mask
from guara_perception.exceptions import InvalidInput, optional_library
from guara_perception.terrain.assessment.raster import blocks, pool_flags
from guara_perception.terrain.layers.geometry import GridGeometry
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK, Hazard, with_neighbours
from guara_perception.terrain.layers.layered_grid import LayeredGrid, asked, look_up, numbers
from kinematics.arrays import FrozenArrays
from kinematics.transforms import transform_points

FRAMES = ("base_footprint", "base_link")
# Layers of which a coarse cell takes the largest value of its fine cells, and layers of which it takes the least.
LARGEST = ("variance", "variance_local", "elevation_max", "slope", "step_height", "roughness", "age")
LEAST = ("elevation_min", "clearance", "traversability", "looks")
Grid = TypeVar("Grid", bound=LayeredGrid)


def known_cells(terrain: LayeredGrid) -> Mask:
    """Mask (ny, nx) of the cells with a known height."""
    return (terrain.layers["hazard"] & UNKNOWN_MASK) == 0


def points(terrain: LayeredGrid) -> Float:
    """Centres of the known cells with their heights, (n, 3) in base_footprint [m].

    A known cell may be a hazard: see `hazard_at(x, y)`.
    """
    x, y = np.meshgrid(*terrain.geometry.centres())
    known = known_cells(terrain)
    return np.column_stack((x[known], y[known], terrain.layers["elevation"][known].astype(np.float64)))


def to_xarray(terrain: LayeredGrid) -> Any:
    """Return the layers as an `xarray.Dataset` with coordinates x and y [m].

    Raises:
        MissingExtra: xarray is not installed.
    """
    xarray = optional_library("xarray", "notebook", "to_xarray")
    x, y = terrain.geometry.centres()
    return xarray.Dataset(
        {name: (("y", "x"), values) for name, values in terrain.layers.items()},
        coords={"x": ("x", x, {"units": "m"}), "y": ("y", y, {"units": "m"})},
        attrs={name: getattr(terrain, name) for name in ("frame", "stamp", "step", "extent", "resolution")},
    )


@dataclass(frozen=True, slots=True, eq=False)
class HeightScan(FrozenArrays):
    """Heights of the ground under points, with a mask of the known heights.

    Attributes:
        heights: (n,) heights of the ground in base_footprint [m]; NaN where unknown.
        known: (n,) mask of the known heights.
        sigma: (n,) standard deviation of the heights [m]; NaN where unknown.
        points: (n, 3) the given points, in base_footprint [m].
    """

    heights: Float
    known: Mask
    sigma: Float
    points: Float

    def __len__(self) -> int:
        return int(self.heights.size)

    @property
    def below(self) -> Float:
        """Height (n,) of each point above the ground [m]; NaN where unknown."""
        return np.asarray(self.points[:, 2] - self.heights)


def height_scan(
    terrain: LayeredGrid, points: npt.ArrayLike, frame: str = "base_footprint", *, allow_stale: bool = False
) -> HeightScan:
    """Sample heights of the ground under points, as input of locomotion policies.

    Unknown heights are NaN and never filled in; the policy decides what to use instead.

    Args:
        points: (n, 2) or (n, 3) in `frame` [m]; points without z are in the plane z = 0 of the frame.
        frame: "base_footprint", or "base_link" at its pose in the scan.

    Raises:
        InvalidInput: the points are not numbers or have the wrong shape, the frame is unknown, or the frame is
            base_link and its pose is missing from the metadata or unreadable.
    """
    terrain = asked(terrain, allow_stale)
    if frame not in FRAMES:
        raise InvalidInput(f"frame is {frame!r}, allowed: {', '.join(FRAMES)}")
    given = numbers(points, "points")
    if given.ndim != 2 or given.shape[1] not in (2, 3):
        raise InvalidInput(f"points have shape {given.shape}; (n, 2) or (n, 3) is needed")
    placed = np.zeros((len(given), 3))
    placed[:, : given.shape[1]] = given
    if frame == "base_link":
        terrain.record.check("transform_base_to_footprint")
        matrix = terrain.record.transform_base_to_footprint
        if matrix is None:
            raise InvalidInput("the grid's metadata lacks transform_base_to_footprint: give points in base_footprint")
        placed = transform_points(matrix, placed)
    x, y = placed[:, 0], placed[:, 1]
    heights = np.asarray(terrain.height_at(x, y), dtype=np.float64)
    variance = np.asarray(look_up(terrain, "variance", x, y, np.float32(np.nan)), dtype=np.float64)
    return HeightScan(heights, np.isfinite(heights), np.sqrt(variance), placed)


def coarser(terrain: Grid, factor: int) -> Grid:
    """Grid with cells `factor` times as long, each with the mean height and the worst other values of its fine cells.

    One unknown fine cell makes the coarse cell unknown, and cells beside unknown cells become EDGE. Flags are combined.
    A coarse cell has the mean elevation, the lowest and highest samples of its fine cells, their largest slope, step,
    roughness, variance and age, and their smallest clearance and number of looks. Its score is the smallest of theirs,
    or 0 if the coarse cell has a flag. Range images are dropped.

    Raises:
        InvalidInput: the factor is not a positive integer that divides both sides of the grid; the message lists the
            factors that do.
    """
    ny, nx = terrain.shape
    is_whole = isinstance(factor, int | np.integer) and not isinstance(factor, bool)
    if not is_whole or factor < 1 or ny % factor or nx % factor:
        allowed = [n for n in range(1, min(ny, nx) + 1) if ny % n == 0 and nx % n == 0]
        raise InvalidInput(
            f"factor is {factor!r}; it must divide the {nx} x {ny} cells: {', '.join(map(str, allowed))}"
        )
    hazard = np.array(pool_flags(terrain.hazard, factor))
    unknown = (hazard & UNKNOWN_MASK) != 0
    # A safe coarse cell must be surrounded by known cells, like a safe fine cell.
    hazard[with_neighbours(unknown) & ~unknown] |= np.uint16(Hazard.EDGE)
    fine = {name: blocks(layer, factor) for name, layer in terrain.layers.items()}
    # NaN propagates, because a slope, step or roughness that is unknown in a fine cell may be large.
    layers = {name: fine[name].max(axis=-1) for name in LARGEST} | {name: fine[name].min(axis=-1) for name in LEAST}
    layers |= {"elevation": fine["elevation"].astype(np.float64).mean(axis=-1).astype(np.float32), "hazard": hazard}
    for name in (*LARGEST[:-1], "elevation", "elevation_min"):
        layers[name] = np.where(unknown, np.float32(np.nan), layers[name])
    # NaN unless all fine cells have a ceiling.
    layers["ceiling"] = fine["ceiling"].max(axis=-1)
    layers["traversability"] = np.where(hazard == 0, layers["traversability"], np.float32(0))
    geometry = GridGeometry(terrain.origin, terrain.resolution * factor, (ny // factor, nx // factor))
    return dataclasses.replace(terrain, layers=layers, geometry=geometry, pictures={})
