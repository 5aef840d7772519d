"""Assignment of a triggered camera's frames to triggers, verified by the intervals of both clocks."""

from __future__ import annotations

import math

import numpy as np

from drivers.arrays import Float
from drivers.board.protocol import WAIT_UNIT_US

# Positions in a sweep at which the board waits before the trigger. Each wait reveals a shift of the frames relative to
# the triggers: the first ones with few frames, the last ones if a camera has missed a third of a sweep. Their distances
# are uneven: with equal distances, a shift by one distance would match all but the outermost.
WAITING_PLACES = (1, 3, 4, 8, 10, 15, 21, 27, 34)
WAIT_UNIT = WAIT_UNIT_US * 1e-6
# Least number of frames that the true shift must explain beyond any other shift.
MARGIN = 3
# Fraction of the triggers so far whose frames must have arrived.
LEAST_SHARE = 0.5
# Largest relative drift of two quartz clocks.
CLOCK_ERROR = 2e-4


def uneven_waits(count: int, tolerance: float) -> list[int]:
    """Waits before the triggers of a sweep, in units of 0.5 ms, that make any shift by whole triggers detectable.

    Each wait is twice the tolerance within which frames of one offset agree, so an interval with a wait never matches
    one without. With nine waits any wrong shift mismatches ten or more frames, so any two triggers may be missed,
    doubled or late.

    Args:
        count: number of stripes.
        tolerance: allowed difference between intervals of the two clocks [s].
    """
    # The subtraction prevents a rounding error from adding a unit.
    wait = math.ceil(2 * tolerance / WAIT_UNIT - 1e-6)
    return [wait if place in WAITING_PLACES else 0 for place in range(count)]


class ClockMatch:
    """Offset between the board's clock and the camera's, and with it the frame of each trigger.

    With even intervals between triggers a missed first trigger would go unnoticed. Uneven intervals reveal the shift,
    and the offset counts as proved only if no other shift explains nearly as many frames.
    """

    def __init__(self, tolerance: float) -> None:
        """Start with an unknown offset.

        Args:
            tolerance: allowed difference between intervals of the two clocks [s].
        """
        self._half = 0.5 * tolerance
        self._offset: float | None = None
        self._proved_at = 0.0

    @property
    def proved(self) -> bool:
        """True once the offset is known."""
        return self._offset is not None

    def learn(self, triggers: Float, stamps: Float) -> None:
        """Estimate the offset if it is still unknown.

        Args:
            triggers: (n,) times of this sweep's triggers so far by the board's clock, increasing [s].
            stamps: (m,) times of the frames so far by the camera's clock, increasing [s].
        """
        if self.proved or triggers.size == 0 or stamps.size == 0:
            return
        differences = np.sort(np.subtract.outer(stamps, triggers).ravel())
        explained = np.searchsorted(differences, differences + 2 * self._half, side="right") - np.arange(
            differences.size
        )
        best = int(np.argmax(explained))
        offset = float(np.median(differences[best : best + explained[best]]))
        others = explained[np.abs(differences + self._half - offset) > 2 * self._half]
        runner_up = int(others.max()) if others.size else 0
        if explained[best] >= max(runner_up + MARGIN, LEAST_SHARE * triggers.size):
            self._offset, self._proved_at = offset, float(triggers[-1])

    def frame_of(self, trigger: float, stamps: Float) -> int | None:
        """Number of the frame that was exposed at a trigger; None if it cannot be verified.

        Args:
            trigger: time of the trigger by the board's clock [s].
            stamps: (m,) times of all frames by the camera's clock [s].
        """
        if self._offset is None or stamps.size == 0:
            return None
        allowed = self._half + CLOCK_ERROR * abs(trigger - self._proved_at)
        distance = np.abs(stamps - trigger - self._offset)
        near = np.flatnonzero(distance <= allowed)
        if near.size != 1:
            return None
        found = int(near[0])
        # The offset drifts, so the latest one is used.
        self._offset, self._proved_at = float(stamps[found] - trigger), trigger
        return found
