"""Where a stripe's core is clipped, and where so much of it that nothing is left to judge by."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from guara_perception.stripes.judge import is_clipped
from guara_perception.stripes.windows import rows_from

Index = npt.NDArray[np.intp]
Mask = npt.NDArray[np.bool_]

# The core is looked at so many sigmas of the stripe to each side of its top.
REACH_SIGMAS = 3.0
# A clipped core wider than so many sigmas leaves no shoulders to judge by.
MAX_CLIPPED_SIGMAS = 5.0


def clipped_columns(
    on: npt.NDArray[Any], top: Index, sigma: float, channel: int, *, is_fused: bool
) -> tuple[Mask, Mask]:
    """Columns whose core is clipped in one channel, and those whose core is lost.

    Args:
        on: (rows, columns[, channels]) laser on.
        top: (columns,) rows of the stripe.
        sigma: width of the stripe [px].
        channel: that the laser lights most.
        is_fused: whether light of all channels was used: then the core is lost only where all are clipped.
    """
    reach = int(REACH_SIGMAS * sigma)
    first, count = top - reach, 2 * reach + 1
    columns = np.arange(top.size)
    clipped = is_clipped(rows_from(on, first, count, columns, channel)).sum(axis=0)
    is_lost = clipped > MAX_CLIPPED_SIGMAS * sigma
    if is_fused and is_lost.any():
        wide = np.flatnonzero(is_lost)
        every = [is_clipped(rows_from(on, first[wide], count, wide, i)) for i in range(on.shape[2])]
        is_lost[wide] = np.logical_and.reduce(every).sum(axis=0) > MAX_CLIPPED_SIGMAS * sigma
    return clipped > 0, is_lost
