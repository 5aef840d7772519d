"""Ground that the gait declares: a polygon whose height is known without a scan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from guara_perception.arrays import Float
from guara_perception.exceptions import InvalidInput
from guara_perception.terrain.layers.geometry import inside_polygon
from guara_perception.terrain.map.fuse_heights import Heights
from guara_perception.terrain.map.look import LOOKED_AT
from guara_perception.terrain.map.odom_cells import SHRUNK_M, OdomCells
from kinematics.arrays import read_only


@dataclass(frozen=True, slots=True, eq=False)
class KnownGround:
    """A level patch of ground that the gait declares safe, for instance under and before its first stance.

    Attributes:
        outline: (n, 2) corners in base_footprint of the pause at which it is declared [m], at least 3, not closed.
        height: height of the patch in the same frame [m].
        sigma: standard deviation of the height [m].

    Raises:
        InvalidInput: fewer than three corners, a value that is not finite, a negative sigma.
    """

    outline: Float
    height: float
    sigma: float

    def __post_init__(self) -> None:
        outline = np.array(self.outline, dtype=np.float64)
        if outline.ndim != 2 or outline.shape[1:] != (2,) or len(outline) < 3 or not np.isfinite(outline).all():
            raise InvalidInput(f"outline of known ground has shape {outline.shape}, it must be 3 or more finite (x, y)")
        if not np.isfinite(self.height) or not np.isfinite(self.sigma) or self.sigma < 0:
            raise InvalidInput(
                f"known ground has height {self.height} and sigma {self.sigma}, both must be finite and sigma 0 or more"
            )
        object.__setattr__(self, "outline", read_only(outline))


def declared_heights(
    cells: OdomCells, ground: KnownGround, transform_footprint_to_odom: Float
) -> tuple[Heights, Float]:
    """Heights for the cells wholly inside a declared patch that no scan has seen, nor looked at without a return.

    Args:
        cells: the memory of the map.
        ground: the patch, in base_footprint.
        transform_footprint_to_odom: (4, 4).

    Returns:
        The heights, and the distance of their cells from the robot [m].
    """
    transform, half = transform_footprint_to_odom, cells.resolution / 2 - SHRUNK_M
    outline = ground.outline @ transform[:2, :2].T + transform[:2, 3]
    (x0, y0), (x1, y1) = outline.min(axis=0), outline.max(axis=0)
    cy, cx = cells.cells_between((x0, y0), (x1, y1))
    slot = cells.slots(cy, cx)
    x, y = (np.asarray((c + 0.5) * cells.resolution, np.float64) for c in (cx, cy))
    covered = (slot >= 0) & inside_polygon(outline, x, y)
    for sx, sy in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
        covered &= inside_polygon(outline, x + sx * half, y + sy * half)
    memory = cells.memory
    covered &= np.isnan(memory["height"][slot]) & ((memory["cause"][slot] & LOOKED_AT) == 0)
    local = (np.column_stack((x, y))[covered] - transform[:2, 3]) @ transform[:2, :2]
    nothing = np.zeros(len(local))
    heights = Heights(
        slot=slot[covered],
        height=local @ transform[2, :2] + transform[2, 2] * ground.height + transform[2, 3],
        variance=np.full(len(local), ground.sigma**2),
        below=nothing,
        above=nothing,
        steepness=nothing,
    )
    return heights, np.hypot(local[:, 0], local[:, 1])
