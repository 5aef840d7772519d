"""Finds where an unbroken run of returns ends: there a return may hold light of two surfaces, or be cut by a shadow."""

from __future__ import annotations

import numpy as np

from guara_perception.arrays import Float, Index, Mask

# A larger difference of height between neighbouring columns is a jump from one surface to another.
JUMP_M = 0.004
# Columns beside a jump or a gap: they hold light of both sides, or light spread by the lens and by the mean of columns.
END_COLUMNS = 2
# A run of at most this many columns, in all of which the light is weaker than this share of the stripe's median, is
# what an edge leaves of a stripe that it cuts.
SHORT_RUN_COLUMNS = 12
WEAK_OF_STRIPE = 0.5
# A run that fades towards its end is cut by a shadow's edge; the rest of the stripe there gives a wrong position. The
# run has faded where a column is weaker than this share of the mean of the next LEVEL_COLUMNS.
FADED_OF_LEVEL = 0.6
LEVEL_COLUMNS = 12
# This many columns in a row must be bright to end a fade: speckle makes single columns bright within a shadow.
SOUND_COLUMNS = 2
# A fade is sought in this many columns from the end of a run, in more only where it does not end in these.
FADE_WINDOW = 24


def run_ends(height: Float, strength: Float) -> Mask:
    """Columns of returns that may not be used because a run of returns ends there.

    The picture's own borders end no run.

    Args:
        height: (s, w) heights of stripes [m], NaN where there is no return.
        strength: (s, w) heights of the returns above background [grey levels].

    Returns:
        (s, w) bool: within END_COLUMNS of a gap or a jump, in the faded end of a run, or in a run
        that is short and weak.
    """
    breaks = run_breaks(height)
    if not breaks.any():
        return np.zeros(height.shape, dtype=bool)
    is_return = np.isfinite(height)
    count, width = height.shape
    beside = np.zeros((count, width + 2 * END_COLUMNS), dtype=bool)
    for shift in range(1, 2 * END_COLUMNS + 1):
        beside[:, shift : shift + width - 1] |= breaks
    ends = _faded(np.where(is_return, strength, 0.0), is_return, breaks)
    ends |= beside[:, END_COLUMNS : END_COLUMNS + width]
    ends &= is_return
    return ends


def run_breaks(height: Float) -> Mask:
    """(s, w - 1) bool: a gap or a jump lies between columns c and c + 1, so they do not belong to one run."""
    with np.errstate(invalid="ignore"):
        # A comparison with NaN is False, so a gap breaks a run as a jump does.
        return np.asarray(~(np.abs(height[:, 1:] - height[:, :-1]) <= JUMP_M))


def _faded(strength: Float, is_return: Mask, breaks: Mask) -> Mask:
    """Columns at the ends of runs from which the strength rises inwards before it reaches the level of the run."""
    width = strength.shape[1]
    # All stripes in one row; a stripe's last column is the last of its run.
    is_last = np.ones(strength.shape, dtype=bool)
    is_last[:, :-1] = breaks
    last = np.flatnonzero(is_last)
    first = np.append(0, last[:-1] + 1)
    is_run = is_return.ravel()[first]
    strongest = np.maximum.reduceat(strength.ravel(), first)[is_run]
    first, last = first[is_run], last[is_run]
    begins, ends = first % width > 0, last % width < width - 1
    faded = np.zeros(strength.size, dtype=bool)
    is_short = (last - first < SHORT_RUN_COLUMNS - 1) & begins & ends
    if is_short.any():
        is_short[is_short] = strongest[is_short] < WEAK_OF_STRIPE * _medians(strength, is_return, first[is_short])
        for begin, end in zip(first[is_short].tolist(), last[is_short].tolist(), strict=True):
            faded[begin : end + 1] = True
    left, right = ~is_short & begins, ~is_short & ends
    # The right ends are the left ends of the reversed row, which is appended to the row: one call finds both.
    joined = np.concatenate((strength, strength[::-1, ::-1]))
    reversed_last = joined.size - 1
    starts = np.concatenate((first[left], reversed_last - last[right]))
    for begin, length in _fade_lengths(joined, starts, np.concatenate((last[left], reversed_last - first[right]))):
        if begin >= strength.size:
            faded[reversed_last + 1 - begin - length : reversed_last + 1 - begin] = True
        else:
            faded[begin : begin + length] = True
    return faded.reshape(strength.shape)


def _medians(strength: Float, is_return: Mask, indices: Index) -> Float:
    """Median strength (n,) of the returns of the stripes in which these indices lie."""
    stripes, which = np.unique(indices // strength.shape[1], return_inverse=True)
    return np.array([np.median(strength[stripe][is_return[stripe]]) for stripe in stripes.tolist()])[which]


def _fade_lengths(strength: Float, first: Index, last: Index, window: int = FADE_WINDOW) -> list[tuple[int, int]]:
    """Number of first columns of each run before SOUND_COLUMNS in a row reach FADED_OF_LEVEL of those that follow them.

    Args:
        strength: (s, w).
        first, last: (n,) indices of the first and last column of each run, into the flat array.
        window: number of columns that are looked at, from the first; more only where these do not decide.

    Returns:
        Pairs of first index and number; runs that do not fade may be left out.
    """
    if not first.size:
        return []
    # Summed row by row, so that rounding does not depend on the other stripes.
    total = np.zeros((len(strength), strength.shape[1] + 1))
    np.cumsum(strength, axis=1, out=total[:, 1:])
    behind = (first // strength.shape[1] + 1)[:, None]
    size = last - first + 1
    looked_at = min(window, int(size.max()))
    end = last[:, None]
    index = np.minimum(first[:, None] + np.arange(looked_at + SOUND_COLUMNS - 1), end)
    after = np.minimum(index + LEVEL_COLUMNS, end)
    level = (total.take(after + behind) - total.take(index + behind)) / np.maximum(after - index, 1)
    holds = strength.take(index) >= FADED_OF_LEVEL * level
    sound = holds[:, :looked_at]
    for ahead in range(1, SOUND_COLUMNS):
        sound = sound & holds[:, ahead : ahead + looked_at]
    is_found = sound.any(axis=1)
    length = np.where(is_found, sound.argmax(axis=1), size)
    is_open = ~is_found & (size > looked_at)
    known = ~is_open & (length > 0)
    found = list(zip(first[known].tolist(), length[known].tolist(), strict=True))
    if is_open.any():
        found += _fade_lengths(strength, first[is_open], last[is_open], 8 * window)
    return found
