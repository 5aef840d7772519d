"""By how much the numbers of a grid were rounded on its way here, out of its metadata."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from guara_perception.exceptions import InvalidInput
from guara_perception.terrain.layers.layered_grid import LayeredGrid


@dataclass(frozen=True, slots=True)
class Rounding:
    """How far the layers that are not rounded to one safe side may be from what was computed.

    Attributes:
        elevation: largest error of an elevation [m].
        variance: the computed variance is at least that of the grid divided by 1 + this.
    """

    elevation: float = 0.0
    variance: float = 0.0


NONE = Rounding()


def rounding_of(terrain: LayeredGrid) -> Rounding:
    """The rounding of a grid; zeros where it is as computed.

    Raises:
        InvalidInput: the metadata holds a rounding that is not valid.
    """
    said = terrain.metadata.get("rounding")
    if said is None:
        return NONE
    try:
        given = dict(said) if isinstance(said, Mapping) else {}
        rounding = Rounding(float(given["elevation"]), float(given["variance"]))
    except (KeyError, TypeError, ValueError):
        rounding = Rounding(math.nan)
    if not (0 <= rounding.elevation < math.inf and 0 <= rounding.variance < math.inf):
        raise InvalidInput(
            f"the grid's metadata says rounding = {said!r}; it must give elevation [m] and variance, 0 or more"
        )
    return rounding
