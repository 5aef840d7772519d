"""Abstract interface of laser boards: identity, status, laser, homing and mirror motion."""

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
# Default timeout of `wait_until_still`, and its polling interval [s].
MOTION_TIMEOUT, POLL_PERIOD = 5.0, 0.002
STILL_MOVING = "the mirror did not come to rest within {:g} s: check the motor and the mirror mechanism"


class Board(ABC):
    """Base class of laser boards; a context manager. To support another board, implement the eight abstract members.

    Whatever its host does, a board must guarantee the following, because people stand in front of the laser:

    - The laser is off after power-up, after opening, after closing, and when the host is gone.
    - The board turns the laser off by itself after `identity.watchdog` (at most 0.4 s) without a call of `status` or
      another method that reaches the board, and after the laser has been on for `identity.laser_limit` without a
      rest. Nothing on the host resets the watchdog in the background.
    - On a board with a light sensor (HAS_SENSOR), LASER_SENSED in `status` is the measured light, not the command.
    - After `home`, and until power is lost, `identity.angle_of(step)` is the angle of the mirror to within half a
      step. MOVING is reported until the mirror has settled.

    Unless stated otherwise, methods that communicate with the board also raise `BoardNotOpen` if it is not open, and
    another `BoardError` if it does not respond.

    `tests/drivers/board/test_any_board.py` tests these guarantees as far as possible without instruments.
    """

    def __enter__(self) -> Self:
        """Open the board; it is closed at the end of the block or of the program."""
        self.open()
        guard.watch(self)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the board with the laser off; after an exception in the block, a failure to close is only logged."""
        try:
            self.close()
        except BoardError as failure:
            if error is None:
                raise
            logger.error("closing the laser board failed after %r: %s", error, failure)
        finally:
            guard.release(self)

    @property
    @abstractmethod
    def identity(self) -> BoardIdentity:
        """Identity of the board: travel of the mirror, limits of the laser, versions.

        Raises:
            BoardNotOpen: the board has not been opened yet.
        """

    @abstractmethod
    def open(self) -> None:
        """Connect to the board, with the laser off; does nothing if the board is open.

        Raises:
            BoardError: the board cannot be reached or used.
        """

    @abstractmethod
    def close(self) -> None:
        """Turn the laser off and disconnect; does nothing if the board is closed.

        Raises:
            LaserStuckOn: the laser did not turn off on command.
        """

    @abstractmethod
    def status(self) -> BoardStatus:
        """Read the status; this also resets the watchdog.

        Raises:
            BoardNotOpen: the board is not open.
            BoardError: the board does not respond.
        """

    @abstractmethod
    def laser_on(self) -> BoardStatus:
        """Switch the laser on and check that it is on.

        Raises:
            LaserRefused: the board refuses to switch the laser on; the error message names the fault.
            LaserDead: the laser stays dark.
        """

    @abstractmethod
    def laser_off(self) -> BoardStatus:
        """Switch the laser off and check that it is off.

        Raises:
            LaserStuckOn: the laser did not turn off on command.
        """

    @abstractmethod
    def home(self) -> int:
        """Search for the home switch; return the error of the step count [steps], 0 if the mirror was not homed before.

        Raises:
            HomeNotFound: the switch was not found.
            MirrorTimeout: the search took too long, or the board is still homing or sweeping.
        """

    @abstractmethod
    def go_to_step(self, step: int, *, wait: bool = True) -> float:
        """Turn the mirror to `step`, counted from the home switch, and return the angle of that step [rad].

        Args:
            step: target step.
            wait: True = return only when the mirror has come to rest.

        Raises:
            MirrorOutOfRange: the step is outside the travel.
            MirrorNotHomed: the home position is unknown.
            MirrorTimeout: the motion took too long, or the board is still homing or sweeping.
        """

    def clear_faults(self) -> BoardStatus:
        """Clear every fault whose cause is gone, and return the status.

        The default implementation only reads the status; it suits boards that report no faults.
        """
        return self.status()

    def ensure_ready(self, timeout: float = 5.0) -> BoardStatus:
        """Make the board ready for a scan: clear faults, and home the mirror if necessary. Return the status.

        Args:
            timeout: longest time to search for a board whose connection was lost [s]; the default implementation does
                not search.

        Raises:
            LaserRefused: the cause of a fault persists.
            BoardError: the board cannot be reached or homed.
        """
        status = self.status()
        if status.faults:
            logger.warning("clearing faults of the laser board: %s", describe_faults(status.faults))
            status = self.clear_faults()
        if status.faults:
            raise LaserRefused(f"the laser board is not ready: {describe_faults(status.faults)}")
        if not status.homed:
            self.home()
            status = self.status()
        return status

    def wait_until_still(self, timeout: float | None = None) -> BoardStatus:
        """Wait until the last commanded motion has ended and the mirror has settled; return the status.

        Args:
            timeout: longest wait [s]; None = the board's default.

        Raises:
            MirrorTimeout: the mirror is still moving.
        """
        return self.still_since(timeout)[0]

    def still_since(self, timeout: float | None = None) -> tuple[BoardStatus, float]:
        """Wait as `wait_until_still` does; return the status, and a host time at which the mirror was at rest [s].

        Args:
            timeout: longest wait [s]; None = the board's default.

        Raises:
            MirrorTimeout: the mirror is still moving.
        """
        patience = MOTION_TIMEOUT if timeout is None else timeout
        deadline = timing.monotonic() + patience
        while (status := self.status()).moving:
            if timing.monotonic() > deadline:
                raise MirrorTimeout(STILL_MOVING.format(patience))
            timing.sleep(POLL_PERIOD)
        return status, timing.monotonic()

    def go_to_angle(self, angle: float, *, wait: bool = True) -> float:
        """Turn the mirror to the step nearest to `angle` [rad] and return the angle of that step [rad].

        Args:
            angle: mirror angle; zero when the laser plane points along -z of `base_link`, positive towards +x.
            wait: True = return only when the mirror has come to rest.

        Raises:
            MirrorOutOfRange: the angle is outside the travel by more than half a step, or not finite.
            MirrorNotHomed: the home position is unknown.
            MirrorTimeout: the motion took too long, or the board is still homing or sweeping.
        """
        return self.go_to_step(self.step_at(angle), wait=wait)

    def step_at(self, angle: float) -> int:
        """Return the step within the travel that is nearest to a mirror angle [rad].

        Raises:
            MirrorOutOfRange: the angle is outside the travel by more than half a step, or not finite.
        """
        identity = self.identity
        low, high = identity.angle_of(identity.min_step), identity.angle_of(identity.max_step)
        half_step = 0.5 * identity.step_angle
        if not (math.isfinite(angle) and low - half_step <= angle <= high + half_step):
            raise MirrorOutOfRange(
                f"mirror angle {math.degrees(angle):.3f} degrees is outside the board's travel of "
                f"{math.degrees(low):.3f} ... {math.degrees(high):.3f} degrees"
            )
        return min(max(identity.step_of(angle), identity.min_step), identity.max_step)
