"""Common base of the threads of a scan, for mirrors moved by the host or by the board."""

from __future__ import annotations

import logging
import queue
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

from drivers import timing
from drivers.board.board import Board
from drivers.cameras.camera import Camera
from drivers.errors import AcquisitionError, LaserRefused
from drivers.sweep.capture import StripeCapture
from drivers.sweep.firing_order import PlannedStripe
from drivers.sweep.options import AcquireOptions

logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class ScanTask:
    """Arguments of `drivers.acquire` for the thread of a scan."""

    board: Board
    camera: Camera
    firing_order: tuple[PlannedStripe, ...]
    options: AcquireOptions
    should_stop: Callable[[], bool] | None = None


class ScanStopped(Exception):  # noqa: N818 - a request to stop is not an error
    """Raised in the scan's thread when the scan should stop."""


class LaserSwitch:
    """Switch of the laser; after `close` it ignores further commands of the scan's thread and keeps the laser off.

    Attributes:
        interruptions: number of times that the board refused to switch the laser on because of a fault.
    """

    def __init__(self, board: Board) -> None:
        """Control the laser of an open board."""
        self._board = board
        self._lock = threading.RLock()
        self._closed = False
        self._lit_since: float | None = None
        self.interruptions = 0

    @property
    def lit(self) -> bool:
        """True if the laser was commanded on."""
        return self._lit_since is not None

    @property
    def may_stay_on(self) -> bool:
        """True if the laser was commanded on, at most half the board's time limit ago."""
        since = self._lit_since
        return since is not None and timing.monotonic() - since <= 0.5 * self._board.identity.laser_limit

    def on(self) -> None:
        """Switch on; after a refusal, clear faults and try once more.

        Raises:
            ScanStopped: the switch is closed.
            LaserRefused: the cause of the fault persists.
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
        """Switch off, even if the laser was not switched on."""
        with self._lock:
            self._lit_since = None
            self._board.laser_off()

    def keep_on(self, shines: bool) -> None:
        """Switch on if necessary, and rest before the board's time limit is reached.

        Args:
            shines: True if the laser is on according to the board's last status.
        """
        if self._lit_since is not None and not shines:
            logger.warning("the board turned the laser off during the scan")
            self.off()
        if self.lit and not self.may_stay_on:
            self.off()
            timing.sleep(1.5 * self._board.identity.laser_rest)
        if not self.lit:
            self.on()

    def close(self) -> None:
        """Turn the laser off permanently."""
        with self._lock:
            self._closed = True
            self.off()


class StripeWorker(threading.Thread, ABC):
    """Thread of one scan.

    Attributes:
        items: queue to the caller: groups of stripes (see `AcquireOptions.together`), and None at the end.
        switch: switch of the laser.
        fired: indices for which the laser was on.
        failure: the error that ended the scan, or None.
        stopped_early: True if `should_stop` ended the scan.
        off_frames_lost: number of lost off frames; their stripes are compared with the previous ones.
        notes: further remarks for the report.
        begun: start time of the scan [s].
    """

    def __init__(self, task: ScanTask, groups: int) -> None:
        """Prepare the thread.

        Args:
            task: the scan.
            groups: number of groups that may wait for the caller; 0 = unlimited.
        """
        super().__init__(name="scan", daemon=True)
        self._board, self._camera, self._options = task.board, task.camera, task.options
        self._firing_order, self._should_stop = task.firing_order, task.should_stop
        self._cancelled = threading.Event()
        self.switch = LaserSwitch(task.board)
        self.items: queue.Queue[tuple[StripeCapture, ...] | None] = queue.Queue(groups)
        self.fired: list[int] = []
        self.failure: Exception | None = None
        self.stopped_early = False
        self.off_frames_lost = 0
        self.notes: list[str] = []
        self.begun = timing.monotonic()

    def cancel(self) -> None:
        """Turn the laser off now and let the thread end; stripes that were not handed over are dropped."""
        self._cancelled.set()
        self.switch.close()

    def run(self) -> None:
        """Run the scan; the laser is off afterwards, even after an exception."""
        self.begun = timing.monotonic()
        try:
            self._take()
        except ScanStopped:
            logger.info("scan stopped after %d of %d stripes", len(self.fired), len(self._firing_order))
        except Exception as error:
            self.failure = error
        except BaseException as error:  # must not look like the end of a good scan
            self.failure = AcquisitionError(f"thread {self.name!r} failed: {error!r}")
        finally:
            self._darken()
            self._end()

    @abstractmethod
    def _take(self) -> None:
        """Perform the scan, with frequent calls of `_check`."""

    @abstractmethod
    def _end(self) -> None:
        """Hand over the remaining stripes, and None."""

    def _check(self) -> None:
        if self._cancelled.is_set():
            raise ScanStopped
        if self._should_stop is not None and self._should_stop():
            self.stopped_early = True
            raise ScanStopped

    def _darken(self) -> None:
        try:
            self.switch.off()
        except Exception as error:
            if self.failure is None:
                self.failure = error
            else:
                logger.error("while ending after %r: %s", self.failure, error)
