"""Flash code of a sweep: dark flashes at unpredictable places in the firing order, and after the last stripe."""

from __future__ import annotations

import secrets
from collections.abc import Sequence
from itertools import pairwise

# Number of stripes per random dark flash: a sweep of 70 stripes has three such flashes, one of 35 stripes has one.
# Together with the last flash, they add 6 % to the frames of these sweeps.
STRIPES_OF_PART = 23
# Least number of stripes of a sweep with random dark flashes; a shorter sweep has only the last flash.
FEWEST_STRIPES = 8


def draw_code(indices: Sequence[int]) -> frozenset[int]:
    """Draw the stripes after which a frame with the laser off (dark flash) is taken; return their indices.

    These are one random stripe in each part of the sweep, and the last stripe. Wherever a shift between frames
    and stripes begins, a later dark flash reveals it.

    Args:
        indices: indices of the stripes in firing order.
    """
    count = len(indices) - 1
    if count < 0:
        return frozenset()
    parts = max(1, count // STRIPES_OF_PART) if len(indices) >= FEWEST_STRIPES else 0
    edges = [part * count // parts for part in range(parts + 1)] if parts else []
    places = [first + secrets.randbelow(end - first) for first, end in pairwise(edges)]
    return frozenset(indices[place] for place in (*places, count))
