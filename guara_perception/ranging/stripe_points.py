"""Points of stripes in `base_footprint`, with unreliable returns, such as those at the ends of runs, set apart."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from guara_perception.arrays import Array, Codes, Float, Index, Mask
from guara_perception.ranging.locate import Locator
from guara_perception.stripes.band import StripeProfile, StripeStatus
from kinematics.arrays import read_only

MIXED_EDGE, OUT_OF_BAND = np.uint8(StripeStatus.MIXED_EDGE), np.uint8(StripeStatus.OUT_OF_BAND)
# Height difference between neighbouring columns above which they belong to different surfaces.
JUMP_M = 0.004
# Number of unusable columns on each side of a jump or a gap: they mix light from both sides, or contain light spread by
# the lens and by the mean over columns.
END_COLUMNS = 2
# A run of fewer than SHORT_RUN_COLUMNS columns, all weaker than this fraction of the stripe's median strength, is the
# remnant of a stripe cut by an edge.
SHORT_RUN_COLUMNS = 12
WEAK_OF_STRIPE = 0.5
# A run that fades towards its end is cut by the edge of a shadow, and the rest of the stripe there is displaced. A
# column is faded if it is weaker than this fraction of the mean of the next LEVEL_COLUMNS columns.
FADED_OF_LEVEL = 0.6
LEVEL_COLUMNS = 12
# Number of consecutive bright columns that end a fade; speckle makes single columns bright within a shadow.
SOUND_COLUMNS = 2
# The edge of a shadow along a stripe cuts it lengthwise: several columns are displaced by more than DISPLACED_M, and
# the first DIM_COLUMNS are weaker than DIM_OF_LEVEL of the strength further in.
DISPLACED_M = 0.00075
DIM_COLUMNS = 3
DIM_OF_LEVEL = 0.85
# Number of columns from the end of a run in which a fade is sought first; more are examined if it does not end there.
FADE_WINDOW = 24


def _stored(values: npt.ArrayLike, kind: npt.DTypeLike) -> Array:
    """Read-only array of a type; not copied if the values are such an array already."""
    array = np.asarray(values, dtype=kind)
    if array is not values and array.base is None:
        # A new array, to which there is no other reference.
        array.setflags(write=False)
    return read_only(array)


@dataclass(frozen=True, slots=True)
class ColumnPoints:
    """Points of some image columns of a stripe, at most one per column.

    Attributes:
        columns: (m,) int32, ascending.
        points: (m, 3) float32 in base_footprint [m].
    """

    columns: Array
    points: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "columns", _stored(self.columns, np.int32))
        object.__setattr__(self, "points", _stored(self.points, np.float32))


@dataclass(frozen=True, slots=True)
class StripePoints:
    """Points of one stripe, one entry per image column; float32, because a scan keeps all its stripes.

    Attributes:
        points: (w, 3) in base_footprint [m], NaN where there is no trusted return within the height limits.
        variance: (w,) variance of the height [m^2], due to the stripe position and, with a track, to the pose of the
            camera; NaN where there is no point.
        strength: (w,) height of the return above background [grey levels]; meaningful only where there is a point.
        status: (w,) uint8 StripeStatus.
        out_of_range: points below or above the height limits.
        doubtful: points of unusable returns within the height limits.
    """

    points: Array
    variance: Array
    strength: Array
    status: Codes
    out_of_range: ColumnPoints
    doubtful: ColumnPoints

    def __post_init__(self) -> None:
        for name in ("points", "variance", "strength"):
            object.__setattr__(self, name, _stored(getattr(self, name), np.float32))
        object.__setattr__(self, "status", read_only(self.status))


# Shared by stripes, most of which have no points set apart.
NO_POINTS = ColumnPoints(np.empty(0, np.int32), np.empty((0, 3), np.float32))


def stripe_points(
    profiles: Sequence[StripeProfile],
    locator: Locator,
    planes_in_camera: Float,
    height_limits: tuple[float, float],
    on_robot: Callable[[Float], Mask] | None = None,
    added_variance: Callable[[Float], Float] | None = None,
) -> list[StripePoints]:
    """Convert profiles to points and set unreliable returns apart.

    Stripes do not influence each other; several in one call take less time.

    Args:
        profiles: profiles of s >= 1 stripes over all columns of the image.
        locator: converts image rows to points.
        planes_in_camera: (s, 4) calibrated laser planes.
        height_limits: lowest and highest height that counts as terrain [m].
        on_robot: mask of the points (n, 3) in base_footprint that lie on the robot itself; None = no such test.
        added_variance: variances (s, w) of the heights of points (3, s, w), added to those due to the stripe position;
            None = nothing is added.
    """
    position, sigma = _rows(profiles, "position_px"), _rows(profiles, "sigma_px")
    points, sigma = locator.measure(planes_in_camera, position, sigma)
    if on_robot is not None:
        _drop(points, on_robot)
    height = points[2]
    mixed = run_ends(height, _rows(profiles, "peak"))
    with np.errstate(invalid="ignore"):
        outside = (height < height_limits[0]) | (height > height_limits[1])
    unusable = mixed | outside
    variance = sigma * sigma
    if added_variance is not None:
        variance += added_variance(points)
    variance[unusable | np.isnan(height)] = np.nan
    status = np.array([profile.status for profile in profiles])
    status[mixed], status[outside] = MIXED_EDGE, OUT_OF_BAND
    out_of_range = _by_stripe(points, np.flatnonzero(outside & ~mixed))
    doubtful = _doubtful(profiles, locator, planes_in_camera, height_limits, on_robot, points, mixed)
    kept = points.astype(np.float32)
    np.copyto(kept, np.nan, where=unusable)
    single = variance.astype(np.float32)
    for array in (kept, single, status):
        # There are no other references to these arrays, so StripePoints need not copy their parts.
        array.setflags(write=False)
    return [
        StripePoints(kept[:, k].T, single[k], profile.peak, status[k], out_of_range[k], doubtful[k])
        for k, profile in enumerate(profiles)
    ]


def _rows(profiles: Sequence[StripeProfile], name: str) -> Float:
    """Array (s, w) of an attribute of all profiles."""
    return np.array([getattr(profile, name) for profile in profiles], dtype=np.float64)


def _drop(points: Float, on_robot: Callable[[Float], Mask]) -> None:
    """Set points (3, ..., n) on the robot to NaN."""
    own = on_robot(points.reshape(3, -1).T)
    if own.any():
        # Indexed in the original array, because the reshaped one may be a copy.
        points[:, own.reshape(points.shape[1:])] = np.nan


def _doubtful(
    profiles: Sequence[StripeProfile],
    locator: Locator,
    planes_in_camera: Float,
    height_limits: tuple[float, float],
    on_robot: Callable[[Float], Mask] | None,
    points: Float,
    mixed: Mask,
) -> list[ColumnPoints]:
    """Unusable returns within the height limits: marked doubtful by the extraction, or at the ends of runs."""
    rows = _rows(profiles, "doubtful_px")
    indices = np.flatnonzero(mixed | np.isfinite(rows))
    if not indices.size:
        return [NO_POINTS] * len(profiles)
    found = points.reshape(3, -1).take(indices, axis=1)
    doubted = np.flatnonzero(~mixed.take(indices))
    if doubted.size:
        stripes, columns = np.divmod(indices[doubted, None], rows.shape[1])
        located = locator.points(planes_in_camera[stripes[:, 0]], rows[stripes, columns], columns)
        if on_robot is not None:
            _drop(located, on_robot)
        found[:, doubted] = located[:, :, 0]
    with np.errstate(invalid="ignore"):
        usable = (found[2] >= height_limits[0]) & (found[2] <= height_limits[1])
    return _by_stripe(points, indices[usable], found[:, usable])


def _by_stripe(points: Float, indices: Index, found: Float | None = None) -> list[ColumnPoints]:
    """Points by stripe, taken from `points` (3, s, w) at ascending flat indices (n,), or given as `found` (3, n)."""
    _, count, width = points.shape
    if not indices.size:
        return [NO_POINTS] * count
    if found is None:
        found = points.reshape(3, -1).take(indices, axis=1)
    bounds = np.searchsorted(indices, width * np.arange(count + 1)).tolist()
    return [
        ColumnPoints(indices[first:end] - k * width, found[:, first:end].T) if end > first else NO_POINTS
        for k, (first, end) in enumerate(itertools.pairwise(bounds))
    ]


def run_ends(height: Float, strength: Float) -> Mask:
    """Mask of the returns that are unusable because a run of returns ends there.

    The borders of the image do not end a run.

    Args:
        height: (s, w) heights of the ground along stripes [m], NaN where there is no return.
        strength: (s, w) heights of the returns above background [grey levels].

    Returns:
        (s, w) bool: returns within END_COLUMNS of a gap or a jump, in the faded end of a run, in a short and weak run,
        or in a dim and displaced end of the remaining run.
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
    """First columns of runs of trusted returns if they are dim, and displaced relative to the columns further in.

    If all of the first LEVEL_COLUMNS are displaced, the ground slopes and the returns are kept.
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
    """Mask (s, w - 1): True at c if a gap or a jump between columns c and c + 1 separates two runs."""
    with np.errstate(invalid="ignore"):
        # A comparison with NaN is False, so a gap breaks a run like a jump.
        return np.asarray(~(np.abs(height[:, 1:] - height[:, :-1]) <= JUMP_M))


def _faded(strength: Float, is_return: Mask, breaks: Mask) -> Mask:
    """Mask of the faded columns at the ends of runs, and of all columns of short and weak runs."""
    width = strength.shape[1]
    # All stripes in one row; the last column of a stripe always ends a run.
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
    # The right ends are the left ends of the reversed rows, which are appended, so that one call finds both.
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
    """Median strength (n,) of all returns of the stripe that contains each index."""
    stripes, which = np.unique(indices // strength.shape[1], return_inverse=True)
    return np.array([np.median(strength[stripe][is_return[stripe]]) for stripe in stripes.tolist()])[which]


def _fade_lengths(strength: Float, first: Index, last: Index, window: int = FADE_WINDOW) -> list[tuple[int, int]]:
    """Lengths of the faded beginnings of runs, which end at SOUND_COLUMNS consecutive columns that are not faded.

    Args:
        strength: (s, w) strength of the returns.
        first, last: (n,) indices of the first and last column of each run, into the flat array.
        window: number of columns that are tested first; more are tested only in runs that are faded so far.

    Returns:
        Pairs of first index and length, without the runs that do not fade.
    """
    if not first.size:
        return []
    # Summed row by row, so that rounding does not depend on other stripes.
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
