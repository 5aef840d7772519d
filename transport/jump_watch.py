"""Jumps of the node's wall clock: stamps before and after a jump cannot be compared; the status reports it."""

from __future__ import annotations

import logging

from transport import clock
from transport.messages.status_message import StatusItem
from transport.messages.terrain_message import Health

logger = logging.getLogger(__name__)
# [s] How long a jump of the clock stands in the status.
REPORTED_FOR = 60.0


class JumpWatch:
    """Looks for a jump whenever it is asked."""

    def __init__(self, robot: str) -> None:
        """Begin now; `robot` is the instance name."""
        self._robot = robot
        self._detector = clock.JumpDetector()
        self._jump: tuple[float, float] | None = None

    def items(self) -> list[StatusItem]:
        """Empty when the clock has not jumped lately."""
        jump, now = self._detector.jump(), clock.now()
        if jump:
            self._jump = (jump, now)
            logger.warning("the clock has jumped by %+.1f s; the ages of grids do not depend on it", jump)
        if self._jump is None or now - self._jump[1] > REPORTED_FOR:
            return []
        by, at = self._jump
        message = f"the clock jumped by {by:+.1f} s, {now - at:.0f} s ago; the ages of grids do not depend on it"
        return [StatusItem(name="clock", level=Health.WARN, message=message, hardware_id=self._robot)]
