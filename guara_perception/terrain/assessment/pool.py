"""Coarser cells: heights and flags pooled over blocks of fine cells."""

from __future__ import annotations

import numpy as np

from guara_perception.arrays import Array, Flags
from guara_perception.terrain.assessment.raster import Raster


def pool(raster: Raster, factor: int) -> Raster:
    """Pool `factor` x `factor` cells; one unknown fine cell makes the coarse one unknown."""
    if factor == 1:
        return raster
    return Raster(
        elevation=blocks(raster.elevation, factor).mean(axis=-1),
        variance=blocks(raster.variance, factor).mean(axis=-1),
        low=blocks(raster.low, factor).min(axis=-1),
        high=blocks(raster.high, factor).max(axis=-1),
    )


def pool_flags(flags: Flags, factor: int) -> Flags:
    """Flags of coarser cells: union of the flags of their `factor` x `factor` fine cells."""
    return np.asarray(np.bitwise_or.reduce(blocks(flags, factor), axis=-1), dtype=np.uint16)


def blocks(layer: Array, factor: int) -> Array:
    """Values (ny, nx, factor^2) of the `factor` x `factor` fine cells of each coarser cell."""
    ny, nx = (n // factor for n in layer.shape)
    return layer.reshape(ny, factor, nx, factor).swapaxes(1, 2).reshape(ny, nx, -1)
