"""One moment to look at: the grids of a stance pause, and what was measured and planned there."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from guara_perception.arrays import Float
from guara_perception.terrain.grid import TerrainGrid


def no_stripes() -> list[Float]:
    """Nothing measured is at hand."""
    return []


@dataclass(frozen=True, slots=True, eq=False)
class Moment:
    """One stance pause.

    Attributes:
        grids: by extent, "footprint" and "map"; at least one.
        stripes: gives the measured points (n, 3) of each stripe in base_footprint [m]; called when first shown.
        footholds: planned ones by leg, (3,) in base_footprint [m].
    """

    grids: Mapping[str, TerrainGrid]
    stripes: Callable[[], list[Float]] = no_stripes
    footholds: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)

    @property
    def any_grid(self) -> TerrainGrid:
        """The scan where it is there, else the map."""
        return next(iter(self.grids.values()))

    @property
    def step(self) -> int:
        """Number of the pause."""
        return self.any_grid.step

    @property
    def metadata(self) -> Mapping[str, Any]:
        """Of the grid."""
        return self.any_grid.metadata

    @property
    def joint_positions(self) -> Mapping[str, float] | None:
        """Joints at the pause, None where the grid does not say."""
        stance = self.metadata.get("stance") or {}
        return stance.get("joint_positions") or None

    @property
    def transform_base_to_footprint(self) -> Float:
        """(4, 4), the identity where the grid does not say."""
        return np.array(self.metadata.get("transform_base_to_footprint", np.eye(4)), dtype=np.float64)
