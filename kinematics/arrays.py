"""Names for the types of arrays, for all of this package, and the way to make one read-only."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Float = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]


def read_only(array: npt.ArrayLike) -> Float:
    """A copy of an array, float64 and not writeable."""
    copy = np.array(array, dtype=np.float64)
    copy.setflags(write=False)
    return copy
