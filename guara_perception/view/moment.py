"""One moment to look at: the grids of a stance pause, and what was measured and planned there."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from guara_perception.arrays import Float, Image
from guara_perception.terrain.grid import TerrainGrid


def no_stripes() -> list[Float]:
    """No measured points are available."""
    return []


def no_picture() -> Image | None:
    """The camera's picture is not available."""
    return None


def pose_of(terrain: TerrainGrid) -> Float:
    """transform_footprint_to_odom (4, 4) of a grid, the identity where it does not say."""
    return np.array(terrain.metadata.get("transform_footprint_to_odom", np.eye(4)), dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class Moment:
    """One stance pause.

    Attributes:
        grids: grids by extent, "footprint" and "map"; at least one, all of one pause.
        stripes: gives the measured points (n, 3) of each stripe in base_footprint [m]; called when first shown.
        footholds: planned footholds by leg, (3,) in base_footprint [m].
        picture: gives what the camera saw of one stripe, (h, w) or (h, w, 3) BGR; called when first shown.
    """

    grids: Mapping[str, TerrainGrid]
    stripes: Callable[[], list[Float]] = no_stripes
    footholds: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    picture: Callable[[], Image | None] = no_picture

    @property
    def any_grid(self) -> TerrainGrid:
        """The scan where it is there, else the map."""
        return next(iter(self.grids.values()))

    @property
    def step(self) -> int:
        """Number of the pause."""
        return self.any_grid.step

    @property
    def walk(self) -> str:
        """Identity of the walk: only within one walk can positions in odom be compared."""
        return str(self.metadata.get("epoch", ""))

    @property
    def metadata(self) -> Mapping[str, Any]:
        """Metadata of the grid."""
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

    @property
    def transform_footprint_to_odom(self) -> Float:
        """(4, 4) as the map says; the identity where it does not."""
        return pose_of(self.grids.get("map", self.any_grid))
