"""Decides which peak of each column is the stripe, and where that cannot be decided."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from guara_perception.stripes.path import follow
from guara_perception.stripes.peaks import Peaks, candidates

Float32 = npt.NDArray[np.float32]
Index = npt.NDArray[np.intp]
Mask = npt.NDArray[np.bool_]

# A second peak this strong is looked into.
RIVAL_OF_PEAK = 0.35
# So many columns without a rival lead in and out of every run of columns with one.
CONTEXT_COLUMNS = 6
# A run of so few columns with two peaks is where the stripe jumps.
EDGE_COLUMNS = 4
# A choice that costs less than this more to make otherwise is no choice.
LEAST_MARGIN = 1.5
# Peaks of one column nearer than so many sigmas of the stripe are one peak.
APART_SIGMAS = 3.0
APART_PX = 5


@dataclass(frozen=True, slots=True)
class Choice:
    """The stripe's peak per column.

    Attributes:
        top: (columns,) row.
        height: (columns,) float32 value there.
        is_ambiguous: (columns,) bool, whether another peak would have been as good.
    """

    top: Index
    height: Float32
    is_ambiguous: Mask


def choose_peaks(smooth: npt.NDArray[Any], peaks: Peaks, threshold: float, sigma: float) -> Choice:
    """Keep the highest peak where it is alone; elsewhere follow the stripe from column to column.

    Args:
        smooth: (rows, columns) smoothed light.
        peaks: the highest peak of each column.
        threshold: least height of a peak.
        sigma: width of the stripe [px].
    """
    top, height = peaks.top.copy(), peaks.height.copy()
    ambiguous = np.zeros(top.size, dtype=bool)
    rival = (peaks.second > RIVAL_OF_PEAK * height) & (peaks.second > threshold) & (height > threshold)
    if not rival.any():
        return Choice(top, height, ambiguous)
    distance = max(int(np.ceil(APART_SIGMAS * sigma)), APART_PX)
    for begin, end in _runs(rival):
        if end - begin <= EDGE_COLUMNS:
            # Where the stripe jumps, the mean of three columns holds light of both sides: no choice is right.
            ambiguous[begin:end] = rival[begin:end]
            continue
        columns = np.arange(max(begin - CONTEXT_COLUMNS, 0), min(end + CONTEXT_COLUMNS, top.size))
        rows, heights = candidates(smooth, columns, threshold, distance)
        heights[heights < RIVAL_OF_PEAK * heights.max(axis=0)] = 0
        chosen, margin = follow(rows, heights)
        every = np.arange(columns.size)
        use = chosen >= 0
        top[columns[use]] = rows[chosen[use], every[use]]
        height[columns[use]] = heights[chosen[use], every[use]]
        several = (heights > 0).sum(axis=0) > 1
        ambiguous[columns] |= several & (~use | (margin < LEAST_MARGIN))
    return Choice(top, height, ambiguous)


def _runs(mask: Mask) -> list[tuple[int, int]]:
    """First and end of the runs of True, runs closer than the context taken together."""
    places = np.flatnonzero(mask)
    breaks = np.flatnonzero(np.diff(places) > 2 * CONTEXT_COLUMNS)
    first = places[np.append(0, breaks + 1)]
    last = places[np.append(breaks, places.size - 1)]
    return [(int(a), int(b) + 1) for a, b in zip(first, last, strict=True)]
