"""Relief that two neighbouring stripes can hide between them, from the ground's own roughness along both."""

from __future__ import annotations

import numpy as np

from guara_perception.arrays import Array, Float

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
