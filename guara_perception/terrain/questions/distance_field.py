"""Signed distance field of the ground, for planners that keep a leg or the body clear of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from guara_perception.arrays import Float, Float32
from guara_perception.exceptions import InvalidInput, optional_library
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK, Hazard
from guara_perception.terrain.layers.layered_grid import LayeredGrid, asked
from kinematics.arrays import FrozenArrays

# Largest number of voxels; computing this many takes about three seconds and 600 MB.
MOST_VOXELS = 10_000_000


@dataclass(frozen=True, slots=True, eq=False)
class DistanceField(FrozenArrays):
    """Signed distance from the ground in voxels over a grid; unknown and STALE ground is solid at every height.

    Attributes:
        values: (nz, ny, nx) lower bounds of the signed distance of each voxel's centre from the nearest solid surface
            [m], negative inside solids.
        origin: lowest corner (x, y, z) in base_footprint [m].
        resolution: edge of a voxel [m].
    """

    values: Float32
    origin: tuple[float, float, float]
    resolution: float

    def at(self, points: npt.ArrayLike) -> Float:
        """Lower bounds (n,) of the distances of points (n, 3) [m]; -inf beside or below the field, NaN above it.

        Between voxel centres, the bound is that of the nearest centre minus the distance to this centre.

        Raises:
            InvalidInput: the points have the wrong shape or are not finite.
        """
        array = np.asarray(points, dtype=np.float64)
        if array.ndim != 2 or array.shape[1] != 3 or not np.isfinite(array).all():
            raise InvalidInput(f"points have shape {array.shape}; finite points (n, 3) are needed")
        position = (array - self.origin) / self.resolution
        index = np.floor(position).astype(np.int64)
        size = np.array(self.values.shape[::-1])
        inside = ((index >= 0) & (index < size)).all(axis=1)
        ix, iy, iz = np.clip(index, 0, size - 1).T
        away = np.linalg.norm(position - (index + 0.5), axis=1) * self.resolution
        distance = self.values[iz, iy, ix].astype(np.float64) - away
        above = (index[:, 2] >= size[2]) & ((index >= 0) & (index < size))[:, :2].all(axis=1)
        return np.where(inside, distance, np.where(above, np.nan, -np.inf))


def distance_field(terrain: LayeredGrid, low: float, high: float, *, allow_stale: bool = False) -> DistanceField:
    """Compute the signed distance field between heights `low` and `high` [m], in voxels as large as the cells.

    The ground is assumed at its highest samples plus `confidence` standard deviations. Unknown and STALE cells are
    solid at every height, and so is everything beside the grid or below `low`. Distances are lower bounds. The result
    is not cached.

    Raises:
        InvalidInput: the heights are not finite, `low` is not below `high`, there are more than MOST_VOXELS voxels, or
            the metadata of the grid lacks limits.
        MissingExtra: SciPy is not installed.
    """
    terrain = asked(terrain, allow_stale)
    # Imported here, because few programs need it and it takes as long to load as everything else that a grid needs.
    distance_transform_edt = optional_library("scipy.ndimage", None, "distance_field").distance_transform_edt
    if not (np.isfinite([low, high]).all() and low < high):
        raise InvalidInput(f"low is {low} m and high is {high} m; both must be finite and high above low")
    spacing = terrain.resolution
    layers = int(np.ceil((high - low) / spacing - 1e-9))
    if layers * terrain.hazard.size > MOST_VOXELS:
        raise InvalidInput(
            f"{layers} x {terrain.hazard.size} voxels, allowed: {MOST_VOXELS}; reduce the height range, or use a "
            "coarser grid"
        )
    unreliable = (terrain.hazard & (UNKNOWN_MASK | np.uint16(Hazard.STALE))) != 0
    margin = terrain.record.required_limits.confidence * np.sqrt(terrain.variance.astype(np.float64))
    top = np.where(unreliable, np.inf, terrain.elevation_max.astype(np.float64) + margin)
    # A voxel that contains any ground is solid, like everything beside and below the grid.
    bottoms = low + spacing * np.arange(layers)
    solid = np.ones((layers + 1, terrain.shape[0] + 2, terrain.shape[1] + 2), dtype=bool)
    solid[1:, 1:-1, 1:-1] = bottoms[:, None, None] < top
    outside, inside = (distance_transform_edt(mask) if mask.any() else np.zeros(mask.shape) for mask in (~solid, solid))
    # The surface of a solid voxel is up to half a diagonal nearer than its centre.
    values = np.where(solid, -np.maximum(inside - 0.5, 0.0), np.maximum(outside - 0.5 * np.sqrt(3.0), 0.0)) * spacing
    return DistanceField(values[1:, 1:-1, 1:-1].astype(np.float32), (*terrain.origin, float(low)), spacing)
