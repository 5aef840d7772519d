"""`Gridded`: layers on cells, and the look-ups that read a single cell of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, overload

import numpy as np
import numpy.typing as npt

from guara_perception.arrays import Array, Flags, Float, Float32, Mask
from guara_perception.exceptions import InvalidInput
from guara_perception.terrain.layers.geometry import GridGeometry
from guara_perception.terrain.layers.hazard import Hazard


class Gridded:
    """Base of classes that hold layers; at least `elevation`, `hazard` and `traversability`."""

    __slots__ = ()

    if TYPE_CHECKING:

        @property
        def geometry(self) -> GridGeometry:
            """Origin, resolution and shape."""

    @property
    def resolution(self) -> float:
        """Edge of a cell [m]."""
        return self.geometry.resolution

    @property
    def origin(self) -> tuple[float, float]:
        """Corner of cell (0, 0) [m]."""
        return self.geometry.origin

    @property
    def shape(self) -> tuple[int, int]:
        """(ny, nx)."""
        return self.geometry.shape

    @overload
    def height_at(self, x: float, y: float) -> float: ...

    @overload
    def height_at(self, x: npt.ArrayLike, y: npt.ArrayLike) -> Float32: ...

    def height_at(self, x: npt.ArrayLike, y: npt.ArrayLike) -> Any:
        """Elevation of the cell under each point [m]; NaN where unknown or outside. Scalars give a float."""
        height = look_up(self, "elevation", x, y, np.float32(np.nan))
        return height if height.ndim else float(height[()])

    @overload
    def hazard_at(self, x: float, y: float) -> Hazard: ...

    @overload
    def hazard_at(self, x: npt.ArrayLike, y: npt.ArrayLike) -> Flags: ...

    def hazard_at(self, x: npt.ArrayLike, y: npt.ArrayLike) -> Any:
        """Hazard flags of the cell under each point; UNSCANNED outside. Scalars give a Hazard, arrays uint16."""
        flags = look_up(self, "hazard", x, y, np.uint16(Hazard.UNSCANNED))
        return flags if flags.ndim else Hazard(int(flags[()]))

    @overload
    def is_traversable(self, x: float, y: float) -> bool: ...

    @overload
    def is_traversable(self, x: npt.ArrayLike, y: npt.ArrayLike) -> Mask: ...

    def is_traversable(self, x: npt.ArrayLike, y: npt.ArrayLike) -> Any:
        """Whether a sole may be centred on the cell under each point. Scalars give a bool; False outside."""
        score = look_up(self, "traversability", x, y, np.float32(0))
        return score > 0 if score.ndim else bool(score > 0)


def coordinates(x: npt.ArrayLike, y: npt.ArrayLike) -> tuple[Float, Float]:
    """Coordinates that a user gave as numbers or arrays, as arrays of one shape [m].

    Raises:
        InvalidInput: not numbers, or arrays of different shapes.
    """
    try:
        px, py = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
    except (ValueError, TypeError):
        raise InvalidInput("x and y must be numbers or arrays of one shape [m]") from None
    return px, py


def look_up(grid: Gridded, layer: str, x: npt.ArrayLike, y: npt.ArrayLike, outside: np.generic) -> Array:
    """Values of a layer in the cells of points, in the points' shape.

    Args:
        grid: grid that holds the layer.
        layer: name of the layer.
        x, y: points in base_footprint [m].
        outside: value for points off the grid, of the layer's type.

    Raises:
        InvalidInput: see `coordinates`.
    """
    px, py = coordinates(x, y)
    iy, ix = grid.geometry.indices(px, py)
    inside = grid.geometry.contains(iy, ix)
    values = np.full(px.shape, outside)
    values[inside] = getattr(grid, layer)[iy[inside], ix[inside]]
    return values
