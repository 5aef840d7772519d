"""Names of the array types used in this package."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]
Float = npt.NDArray[np.float64]
Float32 = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]
# Camera image, (h, w) or (h, w, 3).
Image = npt.NDArray[np.uint8] | npt.NDArray[np.uint16]
