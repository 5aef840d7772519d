"""Driver of the laser board: switches the laser, and homes and turns the mirror."""

from __future__ import annotations

import logging

from drivers import timing
from drivers.board.board import STILL_MOVING
from drivers.board.board_records import BoardStatus
from drivers.board.board_session import BoardSession, raise_if_stuck_on
from drivers.board.protocol import BoardFault, BoardFlag, Request
from drivers.errors import (
    BoardNotOpen,
    BoardTimeout,
    BoardTransferFailed,
    BoardUnplugged,
    HomeNotFound,
    LaserDead,
    MirrorTimeout,
)

logger = logging.getLogger(__name__)
EVERY_FAULT = 0xFFFF
# Longest wait for a report before the status is read instead [s].
REPORT_SLICE = 0.02
# Period after which the board's clock wraps [ms].
CLOCK_WRAP = 1 << 32
# Resolution [s] and largest relative error of the board's clock.
CLOCK_RESOLUTION, CLOCK_ERROR = 0.001, 0.01


class LaserBoard(BoardSession):
    """Driver of the laser board; a context manager.

    Several threads may send commands, but only one may move the mirror.

    The board's watchdog turns the laser off after at most 0.4 s without a command, even if the program dies. Call
    `status()` regularly to keep the laser on for longer, up to `identity.laser_limit`.
    """

    # Last commanded motion: its number, whether it may still be running, and its start on the board's and the host's
    # clock.
    _motion = 0
    _moving = False
    _board_time = _host_time = 0.0

    def ensure_ready(self, timeout: float = 5.0) -> BoardStatus:
        """Make the board ready for a scan: reconnect if necessary, clear faults, and home the mirror if necessary.

        Args:
            timeout: longest search for a board that was lost [s].

        Returns:
            The status of the board, with the mirror homed.

        Raises:
            LaserRefused: the cause of a fault persists.
            BoardError: the board cannot be reached or homed.
        """
        try:
            status = self.status()
        except (BoardUnplugged, BoardNotOpen, BoardTimeout, BoardTransferFailed) as failure:
            logger.warning("reconnecting to the laser board: %s", failure)
            self.reconnect(timeout)
            status = self.status()
        if BoardFlag.SESSION not in status.flags:
            self._begin_session()
        return super().ensure_ready(timeout)

    def clear_faults(self) -> BoardStatus:
        """Clear every fault whose cause is gone, and return the status with the faults that remain."""
        return self.command(Request.CLEAR_FAULTS, EVERY_FAULT)

    def laser_on(self) -> BoardStatus:
        """Switch the laser on and check that it is on.

        Raises:
            LaserRefused: the board refuses to switch the laser on; the error message names the fault.
            LaserDead: the board senses no light; the laser has been commanded off again.
        """
        status = self.command(Request.LASER, 1)
        if not status.laser_sensed:
            self.command(Request.LASER, 0)
            raise LaserDead("the laser was switched on but the board senses no light: check the diode")
        return status

    def laser_off(self) -> BoardStatus:
        """Switch the laser off and check that it is off.

        Raises:
            LaserStuckOn: the laser did not go off on command.
        """
        status = self.command(Request.LASER, 0)
        raise_if_stuck_on(status)
        return status

    def home(self) -> int:
        """Search for the home switch; return the error of the step count [steps], 0 if the mirror was not homed before.

        Raises:
            HomeNotFound: the switch was not found.
            MirrorTimeout: the search took too long, or the board is still homing or sweeping.
        """
        self._begin_motion(self.command(Request.HOME))
        status = self.wait_until_still(self.config.home_timeout)
        if BoardFault.HOME_NOT_FOUND in status.faults or not status.homed:
            raise HomeNotFound(
                "the home switch was not found over the whole travel of the mirror: check the switch and its cable"
            )
        return status.home_error

    def go_to_step(self, step: int, *, wait: bool = True) -> float:
        """Turn the mirror to `step`, counted from the home switch, and return the angle of that step [rad].

        Raises:
            MirrorOutOfRange: the step is outside the travel.
            MirrorNotHomed: the home position is unknown.
            MirrorTimeout: the motion took too long, or the board is still homing or sweeping.
        """
        self._begin_motion(self.command(Request.GO_TO, step))
        if wait:
            self.wait_until_still()
        return self.identity.angle_of(step)

    def begin_sweep(self, argument: int) -> BoardStatus:
        """Start a sweep that the board executes; `drivers.sweep.board_sweep` encodes the argument.

        Raises:
            MirrorNotHomed: the home position is unknown.
            LaserRefused: a fault prevents the laser from being switched on.
            BoardError: the board rejects the command for another reason.
        """
        status = self.command(Request.SWEEP, argument)
        self._begin_motion(status)
        return status

    def halt(self) -> BoardStatus:
        """Decelerate the mirror to a stop."""
        return self.command(Request.HALT)

    def still_since(self, timeout: float | None = None) -> tuple[BoardStatus, float]:
        """Wait as `wait_until_still` does; return the status, and a host time at which the mirror was at rest [s].

        If the motion has already ended, this returns immediately: the board queued a report at its end, with the time.
        The clocks of board and host need not be synchronised: the reply to the motion command contained the board's
        time and arrived at a known host time.

        Args:
            timeout: longest wait [s]; None = that of the configuration.

        Raises:
            MirrorTimeout: the mirror is still moving.
        """
        patience = self.config.motion_timeout if timeout is None else timeout
        deadline = timing.monotonic() + patience
        status = None if self._moving else self.status()
        while status is None or status.moving or status.motion != self._motion:
            if timing.monotonic() > deadline:
                raise MirrorTimeout(STILL_MOVING.format(patience))
            record = self.read_record(REPORT_SLICE)
            status = record if isinstance(record, BoardStatus) else self.status()
        self._moving = False
        taken = round((status.device_time - self._board_time) / 1e-3) % CLOCK_WRAP * 1e-3
        return status, min(timing.monotonic(), self._host_time + taken * (1.0 + CLOCK_ERROR) + CLOCK_RESOLUTION)

    def _begin_motion(self, status: BoardStatus) -> None:
        self._motion, self._moving = status.motion, status.moving
        self._board_time, self._host_time = status.device_time, timing.monotonic()
