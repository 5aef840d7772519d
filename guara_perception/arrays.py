"""Names for the NumPy array types of this package; shapes and units are documented where the types are used."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]
Float = npt.NDArray[np.float64]
Float32 = npt.NDArray[np.float32]
# Indices or counts.
Index = npt.NDArray[np.intp]
# Indices in the type that OpenCV uses.
Index32 = npt.NDArray[np.int32]
Mask = npt.NDArray[np.bool_]
Flags = npt.NDArray[np.uint16]
# Small whole numbers: statuses, materials, masks for OpenCV.
Codes = npt.NDArray[np.uint8]
# Greyscale image, (h, w).
Grey = npt.NDArray[np.uint8]
# Camera image, (h, w) or (h, w, 3), uint8 or uint16.
Image = npt.NDArray[Any]
# Lowest and highest value.
Interval = tuple[float, float]
