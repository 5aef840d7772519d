"""Assignment of a triggered camera's frames to triggers, proved by the intervals of both clocks."""

from __future__ import annotations

import math

import numpy as np

from drivers.arrays import Float
from drivers.board.protocol import WAIT_UNIT_US

# Places of a sweep before whose triggers the board waits. A shift by one trigger shows once at each, a larger
# shift more often: the first ones reveal it from few frames, the last ones when a camera has missed a third of a sweep.
# Their distances are uneven: with equal distances, a shift by one distance would match all but the outermost.
WAITING_PLACES = (1, 3, 4, 8, 10, 15, 21, 27, 34)
WAIT_UNIT = WAIT_UNIT_US * 1e-6
# Number of frames that the true shift of the frames against the triggers must explain more than any other.
MARGIN = 3
# Share of the triggers so far whose frames must have come.
LEAST_SHARE = 0.5
# Relative difference that two quartz clocks may have.
CLOCK_ERROR = 2e-4


def uneven_waits(count: int, tolerance: float) -> list[int]:
    """Waits before the triggers of a sweep [0.5 ms], by place, that make every shift by whole triggers detectable.

    Each is twice the tolerance, within which frames of one offset agree. Two gaps that differ by twice the tolerance
    therefore never fit one and the same shift. With nine waits every wrong shift misses ten frames or more, and any two
    triggers may be missed, doubled or late.

    Args:
        count: number of stripes.
        tolerance: by how much differences of the two clocks may disagree [s].
    """
    # Whole units must stay whole, though the tolerance may have no exact binary value.
    wait = math.ceil(2 * tolerance / WAIT_UNIT - 1e-6)
    return [wait if place in WAITING_PLACES else 0 for place in range(count)]


class ClockMatch:
    """The offset between the board's clock and the camera's, once it is proved; then the frame of a trigger.

    With even intervals between triggers a missed first trigger would go unnoticed. Uneven ones reveal the shift, and
    the offset counts as proved only if no other shift explains nearly as many frames.
    """

    def __init__(self, tolerance: float) -> None:
        """Begin with the offset unknown.

        Args:
            tolerance: by how much differences of the two clocks may disagree [s].
        """
        self._half = 0.5 * tolerance
        self._offset: float | None = None
        self._proved_at = 0.0

    @property
    def proved(self) -> bool:
        """True once the offset is known."""
        return self._offset is not None

    def learn(self, triggers: Float, stamps: Float) -> None:
        """Search for the offset if it is still unknown.

        Args:
            triggers: (n,) times of this sweep's triggers so far on the board's clock [s], rising.
            stamps: stamps of the frames so far, (m,) on the camera's clock [s], rising.
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
        """Number of the frame that was exposed at a trigger, None when it cannot be proved.

        Args:
            trigger: time of the trigger on the board's clock [s].
            stamps: stamps of all frames, (m,) on the camera's clock [s].
        """
        if self._offset is None or stamps.size == 0:
            return None
        allowed = self._half + CLOCK_ERROR * abs(trigger - self._proved_at)
        distance = np.abs(stamps - trigger - self._offset)
        near = np.flatnonzero(distance <= allowed)
        if near.size != 1:
            return None
        found = int(near[0])
        # The offset drifts: the one proved last is the best.
        self._offset, self._proved_at = float(stamps[found] - trigger), trigger
        return found
