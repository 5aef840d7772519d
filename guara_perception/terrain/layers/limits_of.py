"""The limits by which a grid was judged, out of its metadata."""

from __future__ import annotations

from guara_perception.exceptions import InvalidInput
from guara_perception.settings import TraversabilityLimits
from guara_perception.terrain.layers.layered_grid import LayeredGrid


def limits_of(terrain: LayeredGrid) -> TraversabilityLimits:
    """The limits of a grid.

    Raises:
        InvalidInput: its metadata holds none, or not all of them.
    """
    limits = terrain.metadata.get("limits")
    try:
        return TraversabilityLimits(**limits)  # type: ignore[arg-type]
    except TypeError:
        raise InvalidInput(
            f"the grid's metadata says limits = {limits!r}; a grid made by process_scan, TerrainMap or assess_terrain "
            f"holds {', '.join(TraversabilityLimits.__slots__)} there, and is needed for this question"
        ) from None
