"""Code of a sweep: dark flashes at places of its firing order that nobody else can know."""

from __future__ import annotations

import secrets
from collections.abc import Sequence

# Stripes of one part of a sweep. Standard sweeps have three parts, coarse ones one: with the last flash, at most 6 %
# more frames.
STRIPES_OF_PART = 23
# A sweep of fewer stripes has the last flash alone.
FEWEST_STRIPES = 8


def draw_code(indices: Sequence[int]) -> frozenset[int]:
    """Draw the stripes after which the camera takes a frame with the laser dark.

    One lies at random in each part of the sweep, the other is always the last: frames that belong to another instant
    meet a dark flash behind them, wherever their shift begins.

    Args:
        indices: indices of the stripes in firing order.
    """
    count = len(indices) - 1
    if count < 0:
        return frozenset()
    parts = max(1, count // STRIPES_OF_PART) if len(indices) >= FEWEST_STRIPES else 0
    edges = [part * count // parts for part in range(parts + 1)] if parts else []
    places = [first + secrets.randbelow(end - first) for first, end in zip(edges, edges[1:], strict=False)]
    return frozenset(indices[place] for place in (*places, count))
