"""Normals of the ground at places of a grid."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from guara_perception.arrays import Float
from guara_perception.terrain.assessment.disc import KNOWN_SHARE, disc_kernel
from guara_perception.terrain.layers.layered_grid import LayeredGrid, asked, coordinates


def normal_at(terrain: LayeredGrid, x: npt.ArrayLike, y: npt.ArrayLike, *, allow_stale: bool = False) -> Float:
    """Unit normals (..., 3) of the plane fitted around the cell under each point; NaN where no slope is known."""
    terrain = asked(terrain, allow_stale)
    px, py = coordinates(x, y)
    return _normals(terrain, px.ravel(), py.ravel()).reshape(*px.shape, 3)


def _normals(terrain: LayeredGrid, x: Float, y: Float) -> Float:
    """Unit normals (n, 3) of the plane fitted to the disc around the cell under each point (n,).

    The disc and the least share of it that must be known are those of the slope layer; NaN where that is NaN.
    """
    geometry = terrain.geometry
    kernel = disc_kernel(terrain.record.required_limits.disc_radius / terrain.resolution)
    half = kernel.shape[0] // 2
    dy, dx = (a - half for a in np.nonzero(kernel))
    iy, ix = geometry.indices(x, y)
    inside = geometry.contains(iy, ix)
    jy, jx = iy[:, None] + dy, ix[:, None] + dx
    on = geometry.contains(jy, jx)
    height = np.where(on, terrain.elevation[np.where(on, jy, 0), np.where(on, jx, 0)].astype(np.float64), np.nan)
    own_height = np.where(inside, terrain.elevation[np.where(inside, iy, 0), np.where(inside, ix, 0)], np.nan)
    height -= own_height[:, None]
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
    slope_known = np.where(inside, np.isfinite(terrain.slope[np.where(inside, iy, 0), np.where(inside, ix, 0)]), False)
    enough = slope_known & (n >= KNOWN_SHARE * kernel.sum())
    normal = np.column_stack((-a / terrain.resolution, -b / terrain.resolution, np.ones(n.size)))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return np.where(enough[:, None], normal, np.nan)
