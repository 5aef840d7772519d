"""Finds where an unbroken run of returns ends: there a return may hold light of two surfaces, or be cut by a shadow."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Float = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

# A larger difference of height between neighbouring columns is a jump from one surface to another.
JUMP_M = 0.004
# So many columns beside a jump or a gap hold light of both sides, or light that the lens and the column mean spilt.
END_COLUMNS = 2
# A run as short as this and weaker throughout than this share of the stripe is what an edge left of a cut stripe.
SHORT_RUN_COLUMNS = 12
WEAK_OF_STRIPE = 0.5
# A run that fades towards its end is cut by a shadow edge: what is left of the stripe there lies in the wrong place.
FADED_OF_LEVEL = 0.6
LEVEL_COLUMNS = 12
# Speckle makes a single column bright in the middle of a shadow.
SOUND_COLUMNS = 2


def run_ends(height: Float, strength: Float) -> Mask:
    """Columns of returns that may not be used because a run of returns ends there.

    The picture's own borders end no run.

    Args:
        height: (w,) heights [m], NaN where there is no return.
        strength: (w,) heights of the returns above background [grey levels].

    Returns:
        (w,) bool: within END_COLUMNS of a gap or a jump, in the faded end of a run, or in a run
        that is short and weak.
    """
    breaks = run_breaks(height)
    ends = np.zeros(height.size, dtype=bool)
    for shift in range(1 - END_COLUMNS, END_COLUMNS + 1):
        column = breaks + shift
        ends[column[(column >= 0) & (column < height.size)]] = True
    ends |= _faded(np.where(np.isfinite(height), strength, np.nan), breaks)
    return np.asarray(ends & np.isfinite(height))


def run_breaks(height: Float) -> npt.NDArray[np.intp]:
    """Columns c such that c and c + 1 do not belong to one run: a gap or a jump lies between them."""
    with np.errstate(invalid="ignore"):
        # A comparison with NaN is False: a gap breaks a run like a jump does.
        return np.flatnonzero(~(np.abs(np.diff(height)) <= JUMP_M))


def _faded(strength: Float, breaks: npt.NDArray[np.intp]) -> Mask:
    """Columns at the ends of runs from which the strength rises inwards before it reaches the level of the run."""
    faded = np.zeros(strength.size, dtype=bool)
    returns = strength[np.isfinite(strength)]
    weak = WEAK_OF_STRIPE * float(np.median(returns)) if returns.size else 0.0
    first = np.append(0, breaks + 1)
    last = np.append(breaks, strength.size - 1)
    is_run = np.isfinite(strength[first])
    for begin, end in zip(first[is_run], last[is_run], strict=True):
        run = strength[begin : end + 1]
        if run.size < SHORT_RUN_COLUMNS and run.max() < weak and begin > 0 and end < strength.size - 1:
            faded[begin : end + 1] = True
            continue
        if begin > 0:
            faded[begin : begin + _fade_length(run)] = True
        if end < strength.size - 1:
            faded[end + 1 - _fade_length(run[::-1]) : end + 1] = True
    return faded


def _fade_length(run: Float) -> int:
    """Number of first columns before SOUND_COLUMNS in a row reach FADED_OF_LEVEL of the columns that follow them."""
    total = np.cumsum(np.append(0.0, run))
    place = np.arange(run.size)
    after = np.minimum(place + LEVEL_COLUMNS, run.size - 1)
    level = (total[after + 1] - total[place + 1]) / np.maximum(after - place, 1)
    holds = run >= FADED_OF_LEVEL * level
    sound = holds.copy()
    for ahead in range(1, SOUND_COLUMNS):
        sound[:-ahead] &= holds[ahead:]
    return int(np.argmax(sound)) if sound.any() else run.size
