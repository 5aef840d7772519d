"""The layers of a terrain grid: name, type, unit and meaning, in the order in which they are listed everywhere."""

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


LAYERS = (
    Layer("elevation", np.float32, "m", "height above base_footprint's z = 0, NaN where unknown"),
    Layer("variance", np.float32, "m^2", "variance of the elevation"),
    Layer("elevation_min", np.float32, "m", "lowest accepted sample in the cell"),
    Layer("elevation_max", np.float32, "m", "highest accepted sample in the cell"),
    Layer("slope", np.float32, "rad", "angle of the plane fitted to the disc around the cell"),
    Layer("step_height", np.float32, "m", "largest rise or fall within the disc, as a positive number"),
    Layer("roughness", np.float32, "m", "standard deviation of the disc about its plane"),
    Layer("clearance", np.float32, "m", "signed distance to the nearest hazard or the border"),
    Layer("traversability", np.float32, "1", "0 never ... 1 ideal; 0 where unknown"),
    Layer("hazard", np.uint16, "bits", "flags of gp.Hazard"),
    Layer("age", np.uint8, "pauses", "stance pauses since last seen"),
    Layer("looks", np.uint8, "scans", "scans that saw the cell"),
)
LAYER_NAMES = tuple(layer.name for layer in LAYERS)
