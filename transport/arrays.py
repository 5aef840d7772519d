"""Names of the array types used in this package."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]
Float = npt.NDArray[np.float64]
# Occupancy: 0 ... 100, or -1 for unknown.
Percent = npt.NDArray[np.int8]
Bytes = npt.NDArray[np.uint8]
