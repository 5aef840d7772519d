"""Returns at the ends of runs, as the kernel judges them when it settles the points of a stripe."""

from __future__ import annotations

import ctypes

import numpy as np

from guara_perception.arrays import Float, Mask
from guara_perception.stripes.kernel.library import address, addresses, kernel


def run_ends(height: Float, strength: Float) -> Mask:
    """Mask of the returns that are unusable because a run of returns ends there.

    The borders of the image do not end a run.

    Args:
        height: (s, w) heights of the ground along stripes [m], NaN where there is no return.
        strength: (s, w) heights of the returns above background [grey levels].

    Returns:
        (s, w) bool: returns close to a gap or a jump, in the faded end of a run, in a short and weak run, or in a dim
        and displaced end of the remaining run.
    """
    height, strength = (np.ascontiguousarray(values, np.float64) for values in (height, strength))
    ends, work = np.empty(height.shape, np.bool_), np.empty(4 * (height.shape[1] + 1))
    function, p = kernel().run_ends, ctypes.c_void_p
    function.argtypes, function.restype = [p, p, ctypes.c_int64, p, p], None
    for row in zip(height, strength, ends, strict=True):
        heights, strengths, is_end = addresses(*row)
        function(heights, strengths, height.shape[1], address(work), is_end)
    return ends
