"""Ground that the gait declares safe, and its fusion into the cells of the map."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from guara_perception.arrays import Float
from guara_perception.exceptions import InvalidInput
from guara_perception.terrain.layers.geometry import inside_polygon
from guara_perception.terrain.map.fuse_heights import (
    LOOKED_AT,
    Heights,
    MapPause,
    fuse_heights,
)
from guara_perception.terrain.map.odom_cells import SHRUNK_M, OdomCells
from kinematics.arrays import read_only

# Largest number of corners; with 30,000 corners the search for the cells inside would delay a scan by a minute.
MOST_CORNERS = 1000


@dataclass(frozen=True, slots=True, eq=False)
class KnownGround:
    """Level patch of ground that the gait declares safe, for instance under and in front of its first stance.

    Attributes:
        outline: (n, 2) corners in base_footprint of the pause at which the patch is declared [m], at least 3; the first
            one is not repeated.
        height: height of the patch in the same frame [m].
        sigma: standard deviation of the height [m].

    Raises:
        InvalidInput: the outline is not (n, 2), there are fewer than 3 or more than `MOST_CORNERS` corners, a value is
            not finite, or sigma is negative.
    """

    outline: Float
    height: float
    sigma: float

    def __post_init__(self) -> None:
        outline = np.array(self.outline, dtype=np.float64)
        if outline.ndim != 2 or outline.shape[1:] != (2,) or len(outline) < 3 or not np.isfinite(outline).all():
            raise InvalidInput(
                f"outline of known ground has shape {outline.shape}; it must have 3 or more corners (x, y), all finite"
            )
        if len(outline) > MOST_CORNERS:
            raise InvalidInput(f"outline of known ground has {len(outline)} corners; allowed: up to {MOST_CORNERS:,}")
        if not np.isfinite(self.height) or not np.isfinite(self.sigma) or self.sigma < 0:
            raise InvalidInput(
                f"known ground has height {self.height} and sigma {self.sigma}; both must be finite and sigma 0 or more"
            )
        object.__setattr__(self, "outline", read_only(outline))


def fuse_known_ground(cells: OdomCells, ground: KnownGround, now: MapPause, step: int) -> dict[str, Any]:
    """Fill unobserved cells in a declared patch; return the patch's entry for the map's record.

    A cell is in the patch if its centre is inside the outline and no edge of the outline crosses the cell.
    """
    transform, half = now.transform_footprint_to_odom, cells.resolution / 2 - SHRUNK_M
    outline = ground.outline @ transform[:2, :2].T + transform[:2, 3]
    (x0, y0), (x1, y1) = outline.min(axis=0), outline.max(axis=0)
    cy, cx = cells.cells_between((x0, y0), (x1, y1))
    slot, memory = cells.slots(cy, cx), cells.memory
    # Known and observed cells are excluded before the search for cells inside, which saves time.
    open_cells = (slot >= 0) & np.isnan(memory["height"][slot]) & ((memory["cause"][slot] & LOOKED_AT) == 0)
    slot = slot[open_cells]
    x, y = ((np.asarray(c, np.float64)[open_cells] + 0.5) * cells.resolution for c in (cx, cy))
    covered = inside_polygon(outline, x, y)
    for (x0, y0), (x1, y1) in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        # A cell that an edge crosses lies partly outside, even if its centre and corners are inside (a narrow notch).
        dx, dy, ex, ey = (x1 - x0) / 2, (y1 - y0) / 2, (x0 + x1) / 2 - x, (y0 + y1) / 2 - y
        near = (np.abs(ex) <= half + abs(dx)) & (np.abs(ey) <= half + abs(dy))
        covered &= ~(near & (np.abs(ex * dy - ey * dx) <= half * (abs(dx) + abs(dy))))
    local = (np.column_stack((x, y))[covered] - transform[:2, 3]) @ transform[:2, :2]
    height = local @ transform[2, :2] + transform[2, 2] * ground.height + transform[2, 3]
    variance = np.full(len(local), ground.sigma**2)
    heights = Heights(slot[covered], height, variance, variance, np.hypot(local[:, 0], local[:, 1]))
    fuse_heights(cells, heights, now, is_scan=False)
    patch = {"outline": ground.outline.tolist(), "height": ground.height, "sigma": ground.sigma}
    return {"step": step, **patch, "cells": len(local)}
