"""Session with a laser board: handshake, commands with bounded retries, refusals as errors, reconnection, closing."""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Callable
from typing import Any, TypeVar

from drivers import timing
from drivers.board import guard
from drivers.board.board import Board
from drivers.board.board_config import BoardConfig
from drivers.board.board_records import BoardIdentity, BoardStatus
from drivers.board.protocol import (
    IDENTITY_SIZE,
    MOTION_SIZE,
    PROTOCOL_MAJOR,
    PROTOCOL_MINOR,
    STATUS_SIZE,
    STRIPE_SIZE,
    BoardFault,
    Request,
    Result,
    describe_faults,
)
from drivers.board.sweep_records import MotionProfile, StripeRecord
from drivers.board.usb_link import UsbLink
from drivers.errors import (
    BadReply,
    BoardError,
    BoardNotFound,
    BoardNotOpen,
    BoardStalled,
    BoardTimeout,
    BoardTransferFailed,
    BoardUnplugged,
    LaserRefused,
    LaserStuckOn,
    MirrorNotHomed,
    MirrorOutOfRange,
    MirrorTimeout,
    ProtocolMismatch,
)

_Record = TypeVar("_Record")
logger = logging.getLogger(__name__)
WORTH_REPEATING = (BoardTimeout, BoardStalled, BoardTransferFailed, BadReply)
# Fraction of the watchdog's time during which a failed command is repeated.
WATCHDOG_SHARE = 0.5
SWEEPS_SINCE = (1, 1)
HOST_VERSION = PROTOCOL_MAJOR << 8 | PROTOCOL_MINOR
# Interval between searches for the board while reconnecting [s].
SEARCH_PERIOD = 0.1


class BoardSession(Board):
    """Connection to the laser board; a context manager. Several threads may send commands.

    Attributes:
        config: configuration of the connection.
        sweep_table: SWEEP_STEP argument of each entry that this session has written to the board's step table, by the
            index of the entry.
        sweep_darks: indices of the entries for which this session has requested a dark flash after the stripe.
    """

    def __init__(self, config: BoardConfig | None = None, *, backend: Any = None) -> None:
        """Prepare the session; nothing is opened yet.

        Args:
            config: configuration of the connection; None = defaults.
            backend: pyusb backend, such as that of an emulated board; None = libusb.
        """
        self.config = config or BoardConfig()
        self._link = UsbLink(self.config, backend)
        self._identity: BoardIdentity | None = None
        self.sweep_table: dict[int, int] = {}
        self.sweep_darks: set[int] = set()
        self._lock = threading.RLock()

    @property
    def identity(self) -> BoardIdentity:
        """Identity of the board that was last opened.

        Raises:
            BoardNotOpen: no board has been opened yet.
        """
        if self._identity is None:
            raise BoardNotOpen("the laser board is not open: use `with LaserBoard() as board:`")
        return self._identity

    @property
    def serial(self) -> str:
        """Serial number of the board; empty before `open`."""
        return self._link.serial

    @property
    def is_open(self) -> bool:
        """True while the board is open."""
        return self._link.is_open

    def open(self) -> None:
        """Find the board, check the protocol and start a session with the laser off; does nothing if the board is open.

        Raises:
            BoardError: the board was not found or cannot be used; ProtocolMismatch if the protocol versions are
                incompatible.
        """
        if self._link.is_open:
            return
        self._link.open()
        guard.watch(self, self.config.handle_signals)
        try:
            identity = self._repeat(Request.IDENTIFY, 0, IDENTITY_SIZE, BoardIdentity.unpack)
            check_version(identity)
            self._identity = identity
            self._begin_session()
        except BaseException:
            guard.release(self)
            self._link.close()
            raise
        logger.info(
            "laser board %s speaks protocol %d.%d, %s",
            self._link.serial,
            *identity.protocol,
            "with sweeps" if identity.protocol >= SWEEPS_SINCE else "without sweeps",
        )

    def close(self) -> None:
        """Turn the laser off, end the session and release the device; does nothing if the board is closed.

        The device is released even if an exception is raised. If the board was unplugged, a warning is logged instead
        of an error being raised.

        Raises:
            LaserStuckOn: the laser did not go off on command.
            BoardError: the command failed.
        """
        if not self._link.is_open:
            return
        try:
            status = self.command(Request.GOODBYE)
            raise_if_stuck_on(status)
        except BoardUnplugged:
            logger.warning("the laser board is gone; without USB power its laser is off")
        finally:
            guard.release(self)
            self._link.close()

    def reconnect(self, timeout: float = 5.0) -> None:
        """Release the device and search for it for up to `timeout` [s]. Afterwards, the mirror may need homing.

        Raises:
            BoardNotFound: the board was not found.
            BoardError: the board was found but cannot be used.
        """
        try:
            self.close()
        except BoardError as failure:
            logger.warning("closing failed before reconnecting: %s", failure)
        deadline = timing.monotonic() + timeout
        while True:
            try:
                self.open()
                return
            except (BoardNotFound, BoardUnplugged):
                if timing.monotonic() >= deadline:
                    raise
            timing.sleep(SEARCH_PERIOD)

    def status(self) -> BoardStatus:
        """Read the status; this also resets the watchdog."""
        return self.command(Request.STATUS)

    def motion_profile(self) -> MotionProfile:
        """Read the motor's speeds, acceleration, settling time and overshoot.

        Raises:
            BoardStalled: the board uses protocol 1.0, which has no motion profile.
        """
        return self._repeat(Request.MOTION, 0, MOTION_SIZE, MotionProfile.unpack)

    def read_record(self, timeout: float) -> BoardStatus | StripeRecord | None:
        """Wait for the board's next report; return None if no report arrives in time, or if it cannot be read.

        Args:
            timeout: longest wait [s].

        Raises:
            BoardError: the board is not open or cannot be reached.
        """
        try:
            data = self._link.read_report(timeout)
            if data is None:
                return None
            return StripeRecord.unpack(data) if len(data) == STRIPE_SIZE else BoardStatus.unpack(data)
        except (BadReply, BoardStalled, BoardTransferFailed) as failure:
            logger.warning("report unusable: %s", failure)
            return None

    def _begin_session(self) -> BoardStatus:
        self.sweep_table.clear()
        self.sweep_darks.clear()
        return self.command(Request.HELLO, HOST_VERSION)

    def command(self, request: Request, argument: int = 0) -> BoardStatus:
        """Execute a command and return the board's status; a refusal is raised as an error (`raise_refusal`)."""
        with self._lock:
            status = self._repeat(request, argument, STATUS_SIZE, lambda data: _answer(request, data))
        raise_refusal(status, argument, self._identity)
        return status

    def _repeat(self, request: Request, argument: int, size: int, read: Callable[[bytes], _Record]) -> _Record:
        # With a faulty cable, the error must be raised before the watchdog turns the laser off.
        patience = math.inf if self._identity is None else WATCHDOG_SHARE * self._identity.watchdog
        deadline = timing.monotonic() + patience
        attempt = 1
        while True:
            try:
                return read(self._link.request(request, argument, size, deadline - timing.monotonic()))
            except WORTH_REPEATING as failure:
                if attempt >= self.config.attempts or timing.monotonic() >= deadline:
                    raise type(failure)(f"{failure} ({attempt} attempt{'s' * (attempt > 1)})") from failure
                logger.warning("attempt %d of %d: %s", attempt, self.config.attempts, failure)
            attempt += 1


def raise_if_stuck_on(status: BoardStatus) -> None:
    """Check that the laser went off after it was switched off.

    Raises:
        LaserStuckOn: the laser is still on, or the board had to cut its supply.
    """
    if status.laser_sensed:
        raise LaserStuckOn("the laser is still on after it was switched off: cut its power by hand")
    if BoardFault.LASER_STUCK_ON in status.faults:
        raise LaserStuckOn("the laser did not go off on command and the board cut its supply: repair the laser driver")


def _answer(request: Request, data: bytes) -> BoardStatus:
    status = BoardStatus.unpack(data)
    if status.request != request:
        raise BadReply(f"the reply to {request.name} belongs to request 0x{status.request:02x}: check the firmware")
    return status


def raise_refusal(status: BoardStatus, argument: int, identity: BoardIdentity | None) -> None:
    """Raise the error that belongs to the result of a command, unless the result is OK.

    Args:
        status: reply to the command.
        argument: argument of the command.
        identity: identity of the board, which contains the travel for the error message; None = unknown.

    Raises:
        BoardError: the board refused the command. A subclass names the cause, except for an argument other than a step
            that is out of range.
    """
    match status.result:
        case Result.OK:
            return
        case Result.LASER_REFUSED:
            raise LaserRefused(
                f"the board refuses to switch the laser on: {describe_faults(status.faults)}; "
                "ensure_ready() clears faults whose cause is gone"
            )
        case Result.NOT_HOMED:
            raise MirrorNotHomed("the mirror's home is unknown: call home() or ensure_ready() first")
        case Result.OUT_OF_RANGE if status.request not in (Request.GO_TO, Request.SWEEP_STEP):
            name = Request(status.request).name
            raise BoardError(f"the board refuses argument {argument} of {name} as out of range (drivers/PROTOCOL.md)")
        case Result.OUT_OF_RANGE:
            # The lower 16 bits of SWEEP_STEP are its step, signed.
            step = argument if status.request == Request.GO_TO else (argument + 0x8000) % 0x10000 - 0x8000
            travel = f"{identity.min_step} ... {identity.max_step}" if identity else "unknown"
            raise MirrorOutOfRange(f"step {step} is outside the board's travel of {travel}")
        case Result.BUSY:
            raise MirrorTimeout("the board is busy (still homing, moving or sweeping): call wait_until_still() first")
        case Result.NO_SESSION:
            raise BoardNotOpen("the board has forgotten this session (it was reset): reconnect()")
        case Result.VERSION:
            raise ProtocolMismatch(
                f"the board refuses protocol {PROTOCOL_MAJOR}.{PROTOCOL_MINOR}: update this software"
            )


def check_version(identity: BoardIdentity) -> None:
    """Check that a board's protocol is compatible with this driver.

    Raises:
        ProtocolMismatch: the board has another major version.
    """
    major, minor = identity.protocol
    if major == PROTOCOL_MAJOR:
        return
    too_old = major < PROTOCOL_MAJOR
    advice = "flash newer firmware to the board" if too_old else "update this software"
    firmware = f"{identity.firmware[0]}.{identity.firmware[1]}"
    raise ProtocolMismatch(
        f"the board speaks protocol {major}.{minor} (firmware {firmware}), "
        f"but this driver speaks {PROTOCOL_MAJOR}.{PROTOCOL_MINOR} and works only with {PROTOCOL_MAJOR}.x: {advice}"
    )
