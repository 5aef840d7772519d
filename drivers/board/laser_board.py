"""Driver of the laser board: switches the laser, homes and turns the mirror."""

from __future__ import annotations

import logging

from drivers import timing
from drivers.board.board_records import BoardStatus
from drivers.board.board_session import BoardSession, raise_if_stuck_on
from drivers.board.protocol import BoardFault, BoardFlag, Request, describe_faults
from drivers.errors import (
    BoardNotOpen,
    BoardTimeout,
    BoardTransferFailed,
    BoardUnplugged,
    HomeNotFound,
    LaserDead,
    LaserRefused,
    MirrorTimeout,
)

logger = logging.getLogger(__name__)
EVERY_FAULT = 0xFFFF
# Longest wait for a report before the status is fetched instead [s].
REPORT_SLICE = 0.02
# [ms]
CLOCK_WRAP = 1 << 32
# Resolution of the board's clock [s], and the relative error by which it may be slow.
CLOCK_RESOLUTION, CLOCK_ERROR = 0.001, 0.01


class LaserBoard(BoardSession):
    """Driver of the laser board, a context manager, usable from any thread.

    The board's watchdog turns the laser off after 0.4 s without a command, also when the program dies. Call `status()`
    regularly to keep it on for longer.
    """

    # Last commanded motion: its number, whether it may still run, and its start on the board's and the host's clock.
    _motion = 0
    _moving = False
    _board_time = _host_time = 0.0

    def ensure_ready(self, timeout: float = 5.0) -> BoardStatus:
        """Make the board ready for a scan: reconnect if it is lost, clear faults, find home if unknown.

        Args:
            timeout: longest search for a board that is gone [s].

        Returns:
            The status afterwards, homed and without fault.

        Raises:
            LaserRefused: a fault whose cause persists.
            BoardError: it cannot be reached or homed.
        """
        try:
            status = self.status()
        except (BoardUnplugged, BoardNotOpen, BoardTimeout, BoardTransferFailed) as failure:
            logger.warning("reconnecting to the laser board: %s", failure)
            self.reconnect(timeout)
            status = self.status()
        if BoardFlag.SESSION not in status.flags:
            status = self._begin_session()
        if status.faults:
            logger.warning("clearing faults of the laser board: %s", describe_faults(status.faults))
            status = self.clear_faults()
        if status.faults:
            raise LaserRefused(f"the laser board cannot work: {describe_faults(status.faults)}")
        if not status.homed:
            self.home()
            status = self.status()
        return status

    def clear_faults(self) -> BoardStatus:
        """Clear every fault whose cause is gone and return the status, with those that remain."""
        return self._command(Request.CLEAR_FAULTS, EVERY_FAULT)

    def laser_on(self) -> BoardStatus:
        """Switch the laser on and check that it is on.

        Raises:
            LaserRefused: the board refuses; the message names the fault.
            LaserDead: the board senses no light.
        """
        status = self._command(Request.LASER, 1)
        if not status.laser_sensed:
            self._command(Request.LASER, 0)
            raise LaserDead("the laser was switched on but the board senses no light: check the diode")
        return status

    def laser_off(self) -> BoardStatus:
        """Switch the laser off and check that it is off.

        Raises:
            LaserStuckOn: it did not go off on command.
        """
        status = self._command(Request.LASER, 0)
        raise_if_stuck_on(status)
        return status

    def home(self) -> int:
        """Find the home switch; returns the number of steps that were lost since it was last found.

        Raises:
            HomeNotFound: the switch was not met.
            MirrorTimeout: it took too long.
        """
        self._begin_motion(self._command(Request.HOME))
        status = self.wait_until_still(self.config.home_timeout)
        if BoardFault.HOME_NOT_FOUND in status.faults or not status.homed:
            raise HomeNotFound("the mirror met no home switch in its whole travel: check switch and cable")
        return status.home_error

    def go_to_step(self, step: int, *, wait: bool = True) -> float:
        """Turn the mirror to `step` (counted from the home switch) and return its angle [rad].

        Raises:
            MirrorOutOfRange: outside the travel.
            MirrorNotHomed: home first.
            MirrorTimeout: it took too long.
        """
        self._begin_motion(self._command(Request.GO_TO, step))
        if wait:
            self.wait_until_still()
        return self.identity.angle_of(step)

    def begin_sweep(self, argument: int) -> BoardStatus:
        """Begin a sweep of the board; `drivers.sweep.board_sweep` makes the argument.

        Raises:
            MirrorNotHomed: home first.
            LaserRefused: a fault forbids the laser.
            BoardError: the board refuses.
        """
        status = self._command(Request.SWEEP, argument)
        self._begin_motion(status)
        return status

    def halt(self) -> BoardStatus:
        """Stop the mirror where it is."""
        return self._command(Request.HALT)

    def still_since(self, timeout: float | None = None) -> tuple[BoardStatus, float]:
        """Wait as `wait_until_still`; returns the status, and an instant before which the motion ended [s, host].

        Called late, it does not wait: a report that was not fetched yet tells when the motion ended. The clocks of
        board and host need not agree: the answer to the command carried the board's time and came at a known time.

        Args:
            timeout: longest wait [s]; None for the configured one.

        Raises:
            MirrorTimeout: it still moves.
        """
        patience = self.config.motion_timeout if timeout is None else timeout
        deadline = timing.monotonic() + patience
        status = None if self._moving else self.status()
        while status is None or status.moving or status.motion != self._motion:
            if timing.monotonic() > deadline:
                raise MirrorTimeout(f"the mirror did not come to rest within {patience:g} s: check motor and mechanics")
            status = self._read_report(REPORT_SLICE) or self.status()
        self._moving = False
        taken = round((status.device_time - self._board_time) / 1e-3) % CLOCK_WRAP * 1e-3
        return status, min(timing.monotonic(), self._host_time + taken * (1.0 + CLOCK_ERROR) + CLOCK_RESOLUTION)

    def _begin_motion(self, status: BoardStatus) -> None:
        self._motion, self._moving = status.motion, status.moving
        self._board_time, self._host_time = status.device_time, timing.monotonic()
