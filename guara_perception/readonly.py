"""Makes arrays read-only."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt


def readonly(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return a read-only array that nobody can write through another name: a view of a copy where needed."""
    if not array.flags.writeable:
        return array
    copy = array if array.flags.owndata else np.array(array)
    copy.setflags(write=False)
    return copy
