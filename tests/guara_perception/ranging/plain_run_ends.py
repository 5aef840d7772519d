"""Slow reference of the kernel's `run_ends` and `pair_relief`."""

from __future__ import annotations

import numpy as np

from guara_perception.arrays import Array, Float, Index, Mask

# A larger difference of height between neighbouring columns is a jump from one surface to another.
JUMP_M = 0.004
# Number of unusable columns next to a jump or a gap: they contain light of both sides, or light that the lens and the
# mean over columns spread there.
END_COLUMNS = 2
# A run of fewer than this many columns, all weaker than this share of the stripe's median, is the remnant of a stripe
# that an edge cuts.
SHORT_RUN_COLUMNS = 12
WEAK_OF_STRIPE = 0.5
# A run that fades towards its end is cut by the edge of a shadow; what remains of the stripe there gives a wrong
# position. A column is faded if it is weaker than this share of the mean of the next LEVEL_COLUMNS.
FADED_OF_LEVEL = 0.6
LEVEL_COLUMNS = 12
# This many columns in a row must be bright to end a fade: speckle makes single columns bright within a shadow.
SOUND_COLUMNS = 2
# The edge of a shadow along a stripe cuts it lengthwise: several columns are displaced by more than DISPLACED_M, and
# the first DIM_COLUMNS are weaker than DIM_OF_LEVEL of the strength further in.
DISPLACED_M = 0.00075
DIM_COLUMNS = 3
DIM_OF_LEVEL = 0.85
# A fade is searched in this many columns from the end of a run, in more only if it does not end there.
FADE_WINDOW = 24


def run_ends(height: Float, strength: Float) -> Mask:
    """Mask of the returns that are unusable because a run of returns ends there.

    The borders of the picture do not end a run.

    Args:
        height: (s, w) heights of stripes [m], NaN where there is no return.
        strength: (s, w) heights of the returns above background [grey levels].

    Returns:
        (s, w) bool: within END_COLUMNS of a gap or a jump, in the faded end of a run, in a run that is short and weak,
        or in an end of what is left that is dim and displaced.
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
    trusted = is_return & ~ends
    for way in (1, -1):
        ends[:, ::way] |= _displaced(height[:, ::way], strength[:, ::way], trusted[:, ::way])
    return ends


def _displaced(height: Float, strength: Float, trusted: Mask) -> Mask:
    """First columns of the runs of trusted returns that are dim, and higher or lower than the run is further in.

    A run all of whose first columns differ from those further in is a slope, and stays.
    """
    displaced = np.zeros(trusted.shape, dtype=bool)
    stripe, first = np.nonzero(trusted[:, 1:] & ~trusted[:, :-1])
    inside = first + 1 + 2 * LEVEL_COLUMNS <= trusted.shape[1]
    stripe, column = stripe[inside, None], first[inside, None] + 1 + np.arange(2 * LEVEL_COLUMNS)
    whole = trusted[stripe, column].all(axis=1)
    stripe, column = stripe[whole], column[whole]
    end, level = np.split(height[stripe, column], 2, axis=1)
    light = strength[stripe, column]
    dim = light[:, :DIM_COLUMNS].mean(axis=1) < DIM_OF_LEVEL * light[:, LEVEL_COLUMNS:].mean(axis=1)
    off = (np.abs(end - np.median(level, axis=1)[:, None]) > DISPLACED_M) & dim[:, None]
    taken = np.arange(LEVEL_COLUMNS) < off.argmin(axis=1)[:, None]
    displaced[np.broadcast_to(stripe, taken.shape)[taken], column[:, :LEVEL_COLUMNS][taken]] = True
    return displaced


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
        window: number of columns that are tested first; more only where these do not decide.

    Returns:
        Pairs of first index and number; runs that do not fade may be missing.
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


# The roughness is averaged over this many half distances of the stripes to either side.
AVERAGED = 4


def pair_relief(points: Array, variance: Array) -> Float:
    """Variance (w,) of the ground halfway between two stripes about the straight line between them [m^2].

    The ground is taken to be as rough across the stripes as along them: there, its heights are compared with the mean
    of those half the distance of the stripes to either side.

    Args:
        points: (3, 2, w) points of both stripes, NaN where there is none.
        variance: (2, w) variances of their heights [m^2], whose share is subtracted.
    """
    x, y, heights = points.astype(np.float64)
    relief = np.zeros(heights.shape[1])
    with np.errstate(invalid="ignore"):
        known = np.isfinite(heights)
        if not known.all(axis=0).any() or not (beside := known[:, 1:] & known[:, :-1]).any():
            return relief
        apart = float(np.median(np.hypot(*(c[1] - c[0] for c in (x, y)))[known.all(axis=0)]))
        column = float(np.median(np.abs(y[:, 1:] - y[:, :-1])[beside]))
    lag = max(round(0.5 * apart / max(column, 1e-6)), 1)
    inner = relief.size - 2 * lag
    if inner <= 0:
        return relief
    left, middle, right = (slice(start, start + inner) for start in (0, lag, 2 * lag))
    # No gap and no jump between the three: the same number of them before the first and the last.
    gaps = np.cumsum(~known, axis=1)
    whole = known[:, left] & known[:, middle] & (gaps[:, left] == gaps[:, right])
    square = (heights[:, middle] - 0.5 * (heights[:, left] + heights[:, right])) ** 2
    square -= variance[:, middle] + 0.25 * (variance[:, left] + variance[:, right])
    total = np.zeros((2, relief.size))
    total[:, middle] = np.where(whole, square, 0.0).sum(axis=0), whole.sum(axis=0)
    half = AVERAGED * lag
    sums = np.cumsum(np.pad(total, ((0, 0), (half + 1, half))), axis=1)
    square_sum, count = sums[:, 2 * half + 1 :] - sums[:, : -2 * half - 1]
    return np.maximum(square_sum / np.maximum(np.rint(count), 1), 0.0)
