"""The limits by which a grid was judged, and how far its values are rounded, from its metadata."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from guara_perception.exceptions import InvalidInput
from guara_perception.settings import TraversabilityLimits
from guara_perception.terrain.layers.hazard import Hazard
from guara_perception.terrain.layers.layered_grid import LayeredGrid


def limits_of(terrain: LayeredGrid) -> TraversabilityLimits:
    """The limits of a grid; those that this version does not know are left out (see `other_limits`).

    Raises:
        InvalidInput: its metadata holds none, or not all of them.
    """
    limits = terrain.metadata.get("limits")
    try:
        return TraversabilityLimits(**known(limits, TraversabilityLimits))  # type: ignore[arg-type]
    except TypeError:
        raise InvalidInput(
            f"the grid's metadata says limits = {limits!r}; a grid made by process_scan, TerrainMap or assess_terrain "
            f"holds {', '.join(TraversabilityLimits.__slots__)} there, and is needed for this question"
        ) from None


def known(limits: Mapping[str, Any], kind: type) -> dict[str, Any]:
    """Those of the limits that a class of limits has; a grid of a newer version may hold more."""
    return {name: limits[name] for name in kind.__slots__ if name in limits}  # type: ignore[attr-defined]


def other_limits(terrain: LayeredGrid) -> dict[str, tuple[Hazard, float]]:
    """Limits of a newer version by which the grid was judged too: name -> the flag that it sets, and its value.

    A new limit has no flag of its own, since all bits for known ground are taken: it sets the nearest one and says
    which in the metadata, `limit_flags` {limit: flag}. What it flagged is a hazard here like any other.
    """
    limits, flags = terrain.metadata.get("limits") or {}, terrain.metadata.get("limit_flags") or {}
    return {
        name: (Hazard[flag], float(limits.get(name, float("nan"))))
        for name, flag in flags.items()
        if name not in TraversabilityLimits.__slots__ and flag in Hazard.__members__
    }


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
