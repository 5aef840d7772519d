"""A grid as other tools take it: points, and an xarray data set."""

from __future__ import annotations

from typing import Any

import numpy as np

from guara_perception.arrays import Float, Mask
from guara_perception.extras import optional_library
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK
from guara_perception.terrain.layers.layered_grid import LayeredGrid


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
