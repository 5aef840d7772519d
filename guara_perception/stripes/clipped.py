"""How much of a stripe's core is clipped, column by column."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from guara_perception.stripes.judge import is_clipped
from guara_perception.stripes.signal import channel_of
from guara_perception.stripes.windows import rows_from

Index = npt.NDArray[np.intp]

# The core is looked at so many sigmas of the stripe to each side of its top.
REACH_SIGMAS = 3.0


def clipped_rows(
    on: npt.NDArray[Any], top: Index, sigma: float, channel: int, *, all_channels: bool
) -> tuple[Index, Index]:
    """How many rows around the top are clipped: in one channel, and beyond repair.

    Args:
        on: (rows, columns[, channels]) laser on.
        top: (columns,) rows of the stripe.
        sigma: width of the stripe [px].
        channel: that the laser lights most.
        all_channels: whether light of all channels was used: then the core is lost only where all are clipped.
    """
    first, count = top - int(REACH_SIGMAS * sigma), 2 * int(REACH_SIGMAS * sigma) + 1
    clipped = is_clipped(rows_from(channel_of(on, channel), first, count, np.arange(top.size)))
    strongest = clipped.sum(axis=0)
    if not all_channels:
        return strongest, strongest
    # Where the strongest channel is not clipped, not all of them are: only the rest needs a look.
    step, column = np.nonzero(clipped)
    row = np.minimum(np.maximum(first[column] + step, 0), len(on) - 1)
    lost = is_clipped(on[row, column]).all(axis=1)
    return strongest, np.bincount(column[lost], minlength=top.size)
