"""The cells along a path: which lie within its clearance, how far aside, and how high their ground may be."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from guara_perception.arrays import Float, Index, Mask
from guara_perception.terrain.layers.geometry import GridGeometry
from guara_perception.terrain.questions.swing_ground import SwingGround

# More than any index of a cell within the longest path.
FARTHEST = 2**32


@dataclass(frozen=True, slots=True)
class Corridor:
    """Cells within the clearance of each sample, (samples, cells of the window); `used` says which of them count."""

    iy: Index
    ix: Index
    aside: Float
    used: Mask

    def unique(self) -> tuple[Index, Index]:
        """Every cell of the corridor once."""
        # One number per cell: sorting pairs is ten times slower.
        both = np.unique(self.iy[self.used] * FARTHEST + self.ix[self.used] + FARTHEST // 2)
        iy = both // FARTHEST
        return iy, both - iy * FARTHEST - FARTHEST // 2


def corridor_of(geometry: GridGeometry, samples: Float, clearance: float) -> Corridor:
    """The cells within `clearance` of samples (n, 3) or (n, 2) of a path, seen from above; also those off the grid."""
    resolution = geometry.resolution
    iy, ix = geometry.indices(samples[:, 0], samples[:, 1])
    # The geometry clips far indices; positions give the distance, so that nothing far off counts as near.
    reach = int(np.ceil(clearance / resolution)) + 1
    dy, dx = (a.ravel() for a in np.mgrid[-reach : reach + 1, -reach : reach + 1])
    jy, jx = iy[:, None] + dy, ix[:, None] + dx
    x = geometry.origin[0] + (jx + 0.5) * resolution
    y = geometry.origin[1] + (jy + 0.5) * resolution
    aside = np.hypot(
        np.maximum(np.abs(x - samples[:, :1]) - resolution / 2, 0),
        np.maximum(np.abs(y - samples[:, 1:2]) - resolution / 2, 0),
    )
    own = (dy == 0) & (dx == 0)
    aside[:, own] = 0.0
    # Half a sample's spacing more, so that what lies between two samples counts too.
    return Corridor(jy, jx, aside, (aside <= clearance + resolution / 4) | own)


def confidences(ground: SwingGround, cells: Corridor) -> Float:
    """How uncertain the ground of each cell of the corridor is: the confidence in sigmas [m]; 0 where none counts."""
    at = np.where(cells.used, cells.iy, 0), np.where(cells.used, cells.ix, 0)
    margin = ground.confidence * np.sqrt(ground.variance[at].astype(np.float64))
    return np.where(cells.used, margin, 0.0)


def distances(ground: SwingGround, samples: Float, cells: Corridor, confidence: Float) -> Float:
    """Distance of each sample from the ground of each cell [m], negative in it; infinite for cells that do not count.

    Ground is taken at its highest sample plus the confidence in sigmas.
    """
    at = np.where(cells.used, cells.iy, 0), np.where(cells.used, cells.ix, 0)
    over = samples[:, 2:3] - (ground.top[at].astype(np.float64) + confidence)
    distance = np.where(over >= 0, np.hypot(cells.aside, over), np.where(cells.aside > 0, cells.aside, over))
    return np.where(cells.used, distance, np.inf)


def sampled(path: Float, spacing: float) -> Float:
    """Points on the path at most `spacing` apart in the plane, its corners among them."""
    parts = [path[:1]]
    for start, stop in zip(path[:-1], path[1:], strict=True):
        count = max(int(np.ceil(np.linalg.norm(stop - start) / spacing)), 1)
        parts.append(start + (np.arange(1, count + 1) / count)[:, None] * (stop - start))
    return np.concatenate(parts)
