"""Layers of a terrain grid in their order: name, type, unit and meaning."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True, slots=True)
class Layer:
    """One layer of a grid."""

    name: str
    dtype: npt.DTypeLike
    unit: str
    meaning: str


# Assumed standard deviation of a ceiling, due to the heights of a scan and the pose of the body. A height with a larger
# local standard deviation gives no ceiling. `benchmarks.usable_ground` compares ceilings with the truth.
CEILING_SIGMA_M = 0.003

LAYERS = (
    Layer("elevation", np.float32, "m", "height above z = 0 of the grid's frame; NaN where unknown"),
    Layer("variance", np.float32, "m^2", "variance of the elevation in the grid's frame"),
    Layer("variance_local", np.float32, "m^2", "part of the variance that neighbouring cells do not share"),
    Layer("elevation_min", np.float32, "m", "lowest sample in the cell"),
    Layer("elevation_max", np.float32, "m", "highest sample in the cell"),
    Layer("slope", np.float32, "rad", "angle of the plane fitted to the disc around the cell"),
    Layer("step_height", np.float32, "m", "largest rise or fall within the disc, as a positive number"),
    Layer("roughness", np.float32, "m", "standard deviation of the disc about its plane"),
    Layer(
        "clearance",
        np.float32,
        "m",
        "signed distance to the nearest cell with a flag other than EDGE, or to the border; negative inside",
    ),
    Layer("traversability", np.float32, "1", "0 never ... 1 ideal; 0 where unknown"),
    Layer("hazard", np.uint16, "flags", "reasons why a foot must not stand there, see gp.Hazard; 0 = none"),
    Layer("age", np.uint8, "pauses", "stance pauses since last seen; 255 where unknown"),
    Layer("looks", np.uint8, "scans", "scans that saw the cell"),
    Layer("ceiling", np.float32, "m", "upper bound of an unknown height; NaN if none"),
)
LAYER_NAMES = tuple(layer.name for layer in LAYERS)
