"""Points of a grid: the known cells, an xarray data set, and heights under given points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from guara_perception.arrays import Float, Mask
from guara_perception.exceptions import InvalidInput
from guara_perception.extras import optional_library
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK
from guara_perception.terrain.layers.layered_grid import LayeredGrid, asked, look_up
from kinematics.arrays import read_only
from kinematics.transforms import transform_points

FRAMES = ("base_footprint", "base_link")


def known_cells(terrain: LayeredGrid) -> Mask:
    """Cells (ny, nx) whose height is known."""
    return (terrain.layers["hazard"] & UNKNOWN_MASK) == 0


def points(terrain: LayeredGrid) -> Float:
    """Centres of the known cells with their heights, (n, 3) in base_footprint [m]; unknown cells give none.

    A cell that is known may still be a hazard: `hazard_at(x, y)` says so.
    """
    x, y = np.meshgrid(*terrain.geometry.centres())
    known = known_cells(terrain)
    return np.column_stack((x[known], y[known], terrain.layers["elevation"][known].astype(np.float64)))


def to_xarray(terrain: LayeredGrid) -> Any:
    """The layers as an `xarray.Dataset` with coordinates x and y [m].

    Raises:
        MissingExtra: xarray is not installed.
    """
    xarray = optional_library("xarray", "notebook", "to_xarray")
    x, y = terrain.geometry.centres()
    return xarray.Dataset(
        {name: (("y", "x"), values) for name, values in terrain.layers.items()},
        coords={"x": ("x", x, {"units": "m"}), "y": ("y", y, {"units": "m"})},
        attrs={
            "frame": terrain.frame,
            "stamp": terrain.stamp,
            "step": terrain.step,
            "extent": terrain.extent,
            "resolution": terrain.resolution,
        },
    )


@dataclass(frozen=True, slots=True, eq=False)
class HeightScan:
    """Heights of the ground under points, and which of them are known.

    Attributes:
        heights: (n,) heights of the ground in base_footprint [m]; NaN where unknown.
        known: (n,) whether each height is known.
        sigma: (n,) standard deviation of the heights [m]; NaN where unknown.
        points: (n, 3) the given points, in base_footprint [m].
    """

    heights: Float
    known: Mask
    sigma: Float
    points: Float

    def __post_init__(self) -> None:
        for name in self.__slots__:
            object.__setattr__(self, name, read_only(getattr(self, name)))

    def __len__(self) -> int:
        return int(self.heights.size)

    @property
    def below(self) -> Float:
        """(n,) how far the ground lies below each point [m]; NaN where unknown."""
        return np.asarray(self.points[:, 2] - self.heights)


def height_scan(
    terrain: LayeredGrid, points: npt.ArrayLike, frame: str = "base_footprint", *, allow_stale: bool = False
) -> HeightScan:
    """Heights of the ground under points, as locomotion policies take them, with a mask of what is known.

    Unknown heights are NaN and are never filled: the policy decides what to use instead.

    Args:
        points: (n, 2) or (n, 3) in `frame` [m]; points without z lie in its plane z = 0.
        frame: "base_footprint", or "base_link" by the pose of the pause.

    Raises:
        InvalidInput: points of another shape, an unknown frame, or base_link without the pose in the metadata.
    """
    terrain = asked(terrain, allow_stale)
    if frame not in FRAMES:
        raise InvalidInput(f"frame is {frame!r}, allowed: {', '.join(FRAMES)}")
    try:
        given = np.array(points, dtype=np.float64)
    except (ValueError, TypeError):
        raise InvalidInput("points are no array of numbers, (n, 2) or (n, 3) is needed") from None
    if given.ndim != 2 or given.shape[1] not in (2, 3):
        raise InvalidInput(f"points have shape {given.shape}, (n, 2) or (n, 3) is needed")
    placed = np.zeros((len(given), 3))
    placed[:, : given.shape[1]] = given
    if frame == "base_link":
        terrain.record.check("transform_base_to_footprint")
        matrix = terrain.record.transform_base_to_footprint
        if matrix is None:
            raise InvalidInput("the grid's metadata holds no transform_base_to_footprint: ask in base_footprint")
        placed = transform_points(matrix, placed)
    x, y = placed[:, 0], placed[:, 1]
    heights = np.asarray(terrain.height_at(x, y), dtype=np.float64)
    variance = np.asarray(look_up(terrain, "variance", x, y, np.float32(np.nan)), dtype=np.float64)
    return HeightScan(heights, np.isfinite(heights), np.sqrt(variance), placed)
