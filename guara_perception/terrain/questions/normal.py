"""Normals of the ground."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from guara_perception.arrays import Float
from guara_perception.terrain.layers.geometry import KNOWN_SHARE, disc_kernel
from guara_perception.terrain.layers.layered_grid import LayeredGrid, asked, coordinates, look_up


def normal_at(terrain: LayeredGrid, x: npt.ArrayLike, y: npt.ArrayLike, *, allow_stale: bool = False) -> Float:
    """Unit normals (..., 3) of the planes fitted around the cell under each point; NaN where the slope is unknown.

    Raises:
        InvalidInput: x and y are not numbers, their shapes cannot be broadcast together, or the metadata of the grid
            lacks limits.
    """
    terrain = asked(terrain, allow_stale)
    px, py = coordinates(x, y)
    x, y = px.ravel(), py.ravel()
    geometry = terrain.geometry
    # Same disc and same least known fraction as for the slope layer.
    kernel = disc_kernel(terrain.record.required_limits.disc_radius / terrain.resolution)
    dy, dx = (a - kernel.shape[0] // 2 for a in np.nonzero(kernel))
    iy, ix = geometry.indices(x, y)
    jy, jx = iy[:, None] + dy, ix[:, None] + dx
    on = geometry.contains(jy, jx)
    height = np.where(on, terrain.elevation[np.where(on, jy, 0), np.where(on, jx, 0)].astype(np.float64), np.nan)
    height -= look_up(terrain, "elevation", x, y, np.float32(np.nan))[:, None]
    known = np.isfinite(height)
    is_fitted = np.isfinite(look_up(terrain, "slope", x, y, np.float32(np.nan)))
    is_fitted &= known.sum(axis=1) >= KNOWN_SHARE * kernel.sum()
    # Normal equations of z = a x + b y + c, with x and y in cells.
    terms, weight = np.stack((dx, dy, np.ones_like(dx))).astype(np.float64), known[is_fitted].astype(np.float64)
    products = np.einsum("nk,ik,jk->nij", weight, terms, terms)
    sums = np.where(known, height, 0.0)[is_fitted] @ terms.T
    normal = np.full((x.size, 3), np.nan)
    normal[is_fitted] = np.linalg.solve(products, sums[..., None])[..., 0] / (-terrain.resolution)
    normal[is_fitted, 2] = 1.0
    return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True)).reshape(*px.shape, 3)
