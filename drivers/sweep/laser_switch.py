"""The laser as a scan uses it: switched by one thread, and put out for good by another at any time."""

from __future__ import annotations

import logging
import threading

from drivers import timing
from drivers.board.laser_board import LaserBoard
from drivers.errors import LaserRefused

logger = logging.getLogger(__name__)


class ScanStopped(Exception):  # noqa: N818 - not an error: the scan was asked to end
    """Unwinds the scan's thread after it was asked to end."""


class LaserSwitch:
    """Switches the laser until it is closed; after that it stays off, whatever the scan's thread still tries.

    Attributes:
        interruptions: how often the board itself had put the laser out (watchdog, time limit).
    """

    def __init__(self, board: LaserBoard) -> None:
        """Take over the laser of an open board."""
        self._board = board
        self._lock = threading.Lock()
        self._closed = False
        self._lit_since: float | None = None
        self.interruptions = 0

    @property
    def lit(self) -> bool:
        """Whether the laser was commanded on."""
        return self._lit_since is not None

    @property
    def may_stay_on(self) -> bool:
        """Whether the laser was commanded on, and is far from the board's time limit."""
        since = self._lit_since
        return since is not None and timing.monotonic() - since <= 0.5 * self._board.identity.laser_limit

    def on(self) -> None:
        """Switch on; a fault that can be cleared is cleared once.

        Raises:
            ScanStopped: the switch was closed.
            LaserRefused: the fault's cause is still there.
        """
        with self._lock:
            if self._closed:
                raise ScanStopped
            try:
                self._board.laser_on()
            except LaserRefused as refusal:
                logger.warning("%s; clearing and trying once more", refusal)
                self.interruptions += 1
                timing.sleep(self._board.identity.laser_rest)
                self._board.clear_faults()
                self._board.laser_on()
            if self._lit_since is None:
                self._lit_since = timing.monotonic()

    def off(self) -> None:
        """Switch off; does nothing when off."""
        with self._lock:
            self._lit_since = None
            self._board.laser_off()

    def keep_on(self, shines: bool) -> None:
        """Switch on if need be, and rest before the board's time limit is reached.

        Args:
            shines: whether the laser is on by the board's last status.
        """
        if self._lit_since is not None and not shines:
            logger.warning("the board put the laser out during the scan")
            self.off()
        if self.lit and not self.may_stay_on:
            self.off()
            timing.sleep(1.5 * self._board.identity.laser_rest)
        if not self.lit:
            self.on()

    def close(self) -> None:
        """Put the laser out for good."""
        with self._lock:
            self._closed = True
            self._lit_since = None
            self._board.laser_off()
