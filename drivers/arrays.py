"""Names for the types of arrays, for all of this package; shapes and units stand where they are used."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]
Float = npt.NDArray[np.float64]
Float32 = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]
# What a camera delivers, (h, w) or (h, w, 3).
Image = npt.NDArray[np.uint8] | npt.NDArray[np.uint16]
