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
    weight = known.astype(np.float64)
    n = weight.sum(axis=1)
    z = np.where(known, height, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        mx, my, mz = (weight @ dx) / n, (weight @ dy) / n, z.sum(axis=1) / n
        ax, ay = (dx - mx[:, None]) * weight, (dy - my[:, None]) * weight
        az = (z - mz[:, None]) * weight
        cxx, cyy, cxy = (ax * ax).sum(1), (ay * ay).sum(1), (ax * ay).sum(1)
        cxz, cyz = (ax * az).sum(1), (ay * az).sum(1)
        determinant = cxx * cyy - cxy**2
        a, b = (cyy * cxz - cxy * cyz) / determinant, (cxx * cyz - cxy * cxz) / determinant
    enough = np.isfinite(look_up(terrain, "slope", x, y, np.float32(np.nan))) & (n >= KNOWN_SHARE * kernel.sum())
    normal = np.column_stack((-a / terrain.resolution, -b / terrain.resolution, np.ones(n.size)))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return np.where(enough[:, None], normal, np.nan).reshape(*px.shape, 3)
