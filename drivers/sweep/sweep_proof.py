"""Assignment of a triggered camera's frames to the triggers, verified by the time intervals on both clocks."""

from __future__ import annotations

import math

import numpy as np

from drivers.arrays import Float
from drivers.board.protocol import WAIT_UNIT_US

# Positions in a sweep at which the board waits before the trigger. Each wait reveals a shift of the frames relative to
# the triggers. The first waits reveal it after a few frames, and the last ones also if the camera has missed the first
# 30 % of a standard sweep. The waits are unevenly spaced: with equal spacing, a shift by that spacing would match all
# but the outermost waits.
WAITING_PLACES = (1, 3, 4, 8, 10, 15, 21, 27, 34)
WAIT_UNIT = WAIT_UNIT_US * 1e-6
# Least number of frames that the true shift must explain in addition to those that any other shift explains.
MARGIN = 3
# Least fraction of the triggers so far whose frames the true shift must explain.
LEAST_SHARE = 0.5
# Largest relative drift between two quartz clocks.
CLOCK_ERROR = 2e-4


def uneven_waits(count: int, tolerance: float) -> list[int]:
    """Return the waits before the triggers of a sweep [0.5 ms], which reveal a shift of the frames by whole triggers.

    Each wait is at least twice the tolerance, so that an interval with a wait never matches one without. With nine
    waits, any wrong shift mismatches ten or more frames. Therefore, the match tolerates any two missed, doubled or
    late triggers.

    Args:
        count: number of stripes.
        tolerance: allowed difference between corresponding intervals on the two clocks [s].
    """
    # The subtraction prevents a rounding error from adding a unit.
    wait = math.ceil(2 * tolerance / WAIT_UNIT - 1e-6)
    return [wait if place in WAITING_PLACES else 0 for place in range(count)]


class ClockMatch:
    """Estimate of the offset between the board's and the camera's clock, which gives the frame of each trigger.

    With equal intervals between triggers, a missed first trigger would not be detected. Uneven intervals reveal such a
    shift. The offset counts as proved only if no other shift explains nearly as many frames.
    """

    def __init__(self, tolerance: float) -> None:
        """Start with an unknown offset.

        Args:
            tolerance: allowed difference between corresponding intervals on the two clocks [s].
        """
        self._half = 0.5 * tolerance
        self._offset: float | None = None
        self._proved_at = 0.0

    @property
    def proved(self) -> bool:
        """True once the offset has been verified."""
        return self._offset is not None

    def learn(self, triggers: Float, stamps: Float) -> None:
        """Estimate the offset, unless it is already known.

        Args:
            triggers: (n,) times of the sweep's triggers so far on the board's clock, increasing [s].
            stamps: (m,) times of the frames so far on the camera's clock, increasing [s].
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
        """Return the index of the frame that was exposed at a trigger; None if this cannot be verified.

        Args:
            trigger: time of the trigger on the board's clock [s].
            stamps: (m,) times of all frames on the camera's clock [s].
        """
        if self._offset is None or stamps.size == 0:
            return None
        allowed = self._half + CLOCK_ERROR * abs(trigger - self._proved_at)
        distance = np.abs(stamps - trigger - self._offset)
        near = np.flatnonzero(distance <= allowed)
        if near.size != 1:
            return None
        found = int(near[0])
        # The offset drifts, so the offset of the latest frame is used from now on.
        self._offset, self._proved_at = float(stamps[found] - trigger), trigger
        return found
