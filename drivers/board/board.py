"""Interface of a laser board in a scan: open, identity, status, laser, home, a step of the mirror, close."""

from __future__ import annotations

import logging
import math
from abc import ABC, abstractmethod
from types import TracebackType
from typing import Self

from drivers import timing
from drivers.board import guard
from drivers.board.board_records import BoardIdentity, BoardStatus
from drivers.board.protocol import describe_faults
from drivers.errors import BoardError, LaserRefused, MirrorOutOfRange, MirrorTimeout

logger = logging.getLogger(__name__)
# Longest wait for the mirror to come to rest [s], and interval between two polls [s].
MOTION_TIMEOUT, POLL_PERIOD = 5.0, 0.002


class Board(ABC):
    """Base class of all laser boards, a context manager. To wire another board, write the eight abstract members.

    Guarantees of a board, whatever its host does, because people stand in front of it:

    - The laser is off at power-up, after opening, after closing, and when the host is gone.
    - It turns the laser off by itself after `identity.watchdog` without a call of `status` or of another method that
      reaches it, 0.4 s at most, and after `identity.laser_limit` of light without a rest. Nothing on the host feeds
      its watchdog in the background.
    - `status` reports the light that a sensor sees (flag LASER_SENSED), not the command, where it has one (HAS_SENSOR).
    - `identity.angle_of(step)` is the angle of the mirror to half a step once `home` has run, until the power is lost;
      MOVING is reported until the mirror has settled.

    `tests/drivers/board/test_any_board.py` tests all of this that can be tested without instruments.
    """

    def __enter__(self) -> Self:
        """Open the board, and close it when the program ends, however it ends."""
        self.open()
        guard.watch(self)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Turn the laser off and close; a failure to do so never hides an earlier error."""
        try:
            self.close()
        except BoardError as failure:
            if error is None:
                raise
            logger.error("while closing after %r: %s", error, failure)
        finally:
            guard.release(self)

    @property
    @abstractmethod
    def identity(self) -> BoardIdentity:
        """Travel of the mirror and limits of the laser.

        Raises:
            BoardNotOpen: before `open`.
        """

    @abstractmethod
    def open(self) -> None:
        """Connect, with the laser off; does nothing when open.

        Raises:
            BoardError: it cannot be reached.
        """

    @abstractmethod
    def close(self) -> None:
        """Turn the laser off and disconnect; does nothing when closed.

        Raises:
            LaserStuckOn: the laser still shines.
        """

    @abstractmethod
    def status(self) -> BoardStatus:
        """Ask for the status; this also feeds the watchdog.

        Raises:
            BoardNotOpen: open it first.
            BoardError: the board does not answer.
        """

    @abstractmethod
    def laser_on(self) -> BoardStatus:
        """Switch the laser on and check that it shines.

        Raises:
            LaserRefused: the board refuses; the message names the fault.
            LaserDead: it does not shine.
        """

    @abstractmethod
    def laser_off(self) -> BoardStatus:
        """Switch the laser off and check that it is dark.

        Raises:
            LaserStuckOn: it did not go off on command.
        """

    @abstractmethod
    def home(self) -> int:
        """Find the home switch and wait; return the steps that were lost since it was last found (0: none).

        Raises:
            HomeNotFound: the switch was not met.
            MirrorTimeout: it took too long.
        """

    @abstractmethod
    def go_to_step(self, step: int, *, wait: bool = True) -> float:
        """Turn the mirror to `step` (counted from the home switch) and return its angle [rad].

        Args:
            step: step to go to.
            wait: return only when the mirror has come to rest.

        Raises:
            MirrorOutOfRange: outside the travel.
            MirrorNotHomed: home first.
            MirrorTimeout: it took too long.
        """

    def clear_faults(self) -> BoardStatus:
        """Clear every fault whose cause is gone and return the status; this default, for a board that keeps none."""
        return self.status()

    def ensure_ready(self, timeout: float = 5.0) -> BoardStatus:
        """Make the board ready for a scan: clear faults, find home if unknown; return the status.

        Args:
            timeout: longest search for a board that is gone [s]; this default searches once.

        Raises:
            LaserRefused: a fault whose cause is still there.
            BoardError: it cannot be reached or homed.
        """
        status = self.status()
        if status.faults:
            status = self.clear_faults()
        if status.faults:
            raise LaserRefused(f"the laser board cannot work: {describe_faults(status.faults)}")
        if not status.homed:
            self.home()
            status = self.status()
        return status

    def wait_until_still(self, timeout: float | None = None) -> BoardStatus:
        """Wait until the motion last commanded has ended and settled.

        Args:
            timeout: longest wait [s]; None for the board's own.

        Raises:
            MirrorTimeout: it still moves.
        """
        return self.still_since(timeout)[0]

    def still_since(self, timeout: float | None = None) -> tuple[BoardStatus, float]:
        """Wait as `wait_until_still`; return the status, and an instant before which the motion ended [s, host].

        Args:
            timeout: longest wait [s]; None for the board's own.

        Raises:
            MirrorTimeout: it still moves.
        """
        patience = MOTION_TIMEOUT if timeout is None else timeout
        deadline = timing.monotonic() + patience
        while (status := self.status()).moving:
            if timing.monotonic() > deadline:
                raise MirrorTimeout(f"the mirror did not come to rest within {patience:g} s: check motor and mechanics")
            timing.sleep(POLL_PERIOD)
        return status, timing.monotonic()

    def go_to_angle(self, angle: float, *, wait: bool = True) -> float:
        """Turn the mirror to `angle` [rad] and return the angle of the nearest step, to which it turns.

        Args:
            angle: mirror angle; zero when the laser plane falls along -z of the body, positive towards +x.
            wait: return only when the mirror has come to rest.

        Raises:
            MirrorOutOfRange: outside the travel, or not finite.
            MirrorNotHomed: home first.
            MirrorTimeout: it took too long.
        """
        return self.go_to_step(self.step_at(angle), wait=wait)

    def step_at(self, angle: float) -> int:
        """The step nearest to a mirror angle [rad].

        Raises:
            MirrorOutOfRange: outside the travel, or not finite.
        """
        identity = self.identity
        low, high = identity.angle_of(identity.min_step), identity.angle_of(identity.max_step)
        half_step = 0.5 * identity.step_angle
        if not (math.isfinite(angle) and low - half_step <= angle <= high + half_step):
            raise MirrorOutOfRange(
                f"mirror angle {math.degrees(angle):.3f} degrees, the board's travel is "
                f"{math.degrees(low):.3f} ... {math.degrees(high):.3f} degrees"
            )
        return min(max(identity.step_of(angle), identity.min_step), identity.max_step)
