"""Proves which frame of a triggered camera belongs to which trigger of the board, from the two clocks' differences."""

from __future__ import annotations

import numpy as np

from drivers.arrays import Float

# Waits before the triggers of a sweep, in 0.5 ms, by place; 0 behind them. The gaps they make are all different at the
# sweep's beginning, so that few frames show any shift by whole triggers; single ones later show it again.
WAITS = (0, 6, 0, 9, 3, 0, 12, 5, 0, 8) + (0,) * 9 + (5,) + (0,) * 13 + (7,) + (0,) * 17 + (6,)
# Number of frames that the true shift of the frames against the triggers must explain more than any other.
MARGIN = 3
# Share of the triggers so far whose frames must have come.
LEAST_SHARE = 0.5
# By how much two quartz clocks may differ.
DRIFT = 2e-4


class ClockMatch:
    """The offset between the board's clock and the camera's, once it is proved; then the frame of a trigger.

    Triggers at even intervals would look the same to a camera that missed the first: uneven gaps show
    such a shift, and the offset counts as proved only when no other shift explains nearly as many frames.
    """

    def __init__(self, tolerance: float) -> None:
        """Know nothing.

        Args:
            tolerance: by how much differences of the two clocks may disagree [s].
        """
        self._half = 0.5 * tolerance
        self._offset: float | None = None
        self._proved_at = 0.0

    @property
    def proved(self) -> bool:
        """Whether the offset is known."""
        return self._offset is not None

    def learn(self, triggers: Float, stamps: Float) -> None:
        """Look for the offset, if it is not known yet.

        Args:
            triggers: of this sweep so far, (n,) on the board's clock [s], rising.
            stamps: of the frames so far, (m,) on the camera's clock [s], rising.
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
        """Return the number of the frame that was exposed at a trigger, None when none can be proved to be it.

        Args:
            trigger: on the board's clock [s].
            stamps: of all frames, (m,) on the camera's clock [s].
        """
        if self._offset is None or stamps.size == 0:
            return None
        allowed = self._half + DRIFT * abs(trigger - self._proved_at)
        distance = np.abs(stamps - trigger - self._offset)
        near = np.flatnonzero(distance <= allowed)
        if near.size != 1:
            return None
        found = int(near[0])
        # The clocks drift apart slowly; what was proved last is the nearest.
        self._offset, self._proved_at = float(stamps[found] - trigger), trigger
        return found
