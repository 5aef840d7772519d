"""Combination of a coarse scan with some of the stripes between into one grid."""

from __future__ import annotations

import dataclasses

import numpy as np

from guara_perception.arrays import Float
from guara_perception.exceptions import InvalidInput
from guara_perception.terrain.assessment.assess import assess_layers
from guara_perception.terrain.assessment.raster import Raster
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK, Hazard
from guara_perception.terrain.map.fuse_scan import scan_flags


def refined(coarse: TerrainGrid, standard: TerrainGrid) -> TerrainGrid:
    """Combine a coarse scan with a standard scan of which only some stripes were fired.

    Cells that the standard scan observed are taken from it, unknown ones included; cells of stripes that were never
    fired are taken from the coarse scan. A stripe that was fired and lost leaves its cells unknown.

    Args:
        coarse: grid of the coarse stripes.
        standard: grid of `ScanProcessor.extended()` after the stripes between were added.

    Raises:
        InvalidInput: the grids are not of one scan.
    """
    if coarse.geometry != standard.geometry or coarse.step != standard.step:
        raise InvalidInput("the coarse and the standard grid are not of one scan: geometry or step differ")
    flags = scan_flags(standard) & UNKNOWN_MASK
    takes_coarse = flags == np.uint16(Hazard.UNSCANNED)
    if not takes_coarse.any():
        return standard
    flags = np.where(takes_coarse, coarse.hazard & UNKNOWN_MASK, flags).astype(np.uint16)

    def either(name: str) -> Float:
        return np.where(takes_coarse, coarse.layers[name], standard.layers[name]).astype(np.float64)

    raster = Raster(*(either(name) for name in ("elevation", "variance", "elevation_min", "elevation_max")))
    layers = assess_layers(raster, flags, coarse.resolution, standard.record.required_limits)
    known = float(np.isfinite(layers["elevation"]).mean())
    return dataclasses.replace(standard, layers=layers, record=dataclasses.replace(standard.record, known=known))
