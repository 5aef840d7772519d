"""Common base class of scan threads, for mirrors moved by the host or by the board."""

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
from drivers.sweep.frame_grabber import FrameGrabber
from drivers.sweep.options import AcquireOptions

logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class ScanTask:
    """Arguments of `drivers.acquire`, as needed by the scan thread."""

    board: Board
    camera: Camera
    firing_order: tuple[PlannedStripe, ...]
    options: AcquireOptions
    should_stop: Callable[[], bool] | None = None


class ScanStopped(Exception):  # noqa: N818 - a request to stop is not an error
    """Raised on the scan thread when the scan should stop."""


class LaserSwitch:
    """Laser switch of a scan. After `close`, the laser stays off and `on` raises `ScanStopped`.

    Attributes:
        interruptions: number of times that the board refused to switch the laser on because of a fault.
    """

    def __init__(self, board: Board) -> None:
        """Control the laser of `board`, which must be open."""
        self._board = board
        self._lock = threading.RLock()
        self._closed = False
        self._lit_since: float | None = None
        self.interruptions = 0

    @property
    def lit(self) -> bool:
        """True while the laser is commanded on."""
        return self._lit_since is not None

    @property
    def may_stay_on(self) -> bool:
        """True if the laser has been commanded on for at most half of the board's time limit."""
        since = self._lit_since
        return since is not None and timing.monotonic() - since <= 0.5 * self._board.identity.laser_limit

    def on(self) -> None:
        """Switch the laser on; if the board refuses, rest, clear faults and try once more.

        Raises:
            ScanStopped: the switch is closed.
            LaserRefused: the cause of the fault persists.
            LaserDead: the laser stays dark.
        """
        with self._lock:
            if self._closed:
                raise ScanStopped
            try:
                self._board.laser_on()
            except LaserRefused as refusal:
                logger.warning("%s; clearing the faults and trying once more", refusal)
                self.interruptions += 1
                timing.sleep(self._board.identity.laser_rest)
                self._board.clear_faults()
                self._board.laser_on()
            if self._lit_since is None:
                self._lit_since = timing.monotonic()

    def off(self) -> None:
        """Switch the laser off, even if it was not switched on."""
        with self._lock:
            self._lit_since = None
            self._board.laser_off()

    def keep_on(self, shines: bool) -> None:
        """Switch the laser on if necessary; rest before the board's time limit is reached.

        Args:
            shines: True if the laser is on according to the last status of the board.
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
        """Turn the laser off for the rest of the scan."""
        with self._lock:
            self._closed = True
            self.off()


class StripeWorker(threading.Thread, ABC):
    """Thread of a scan.

    Attributes:
        items: queue to the caller; it contains groups of stripes (see `AcquireOptions.together`), and None at the end.
        switch: laser switch.
        grabber: source of the frames, with counts of skipped and lost ones.
        fired: indices of the stripes for which the laser was on.
        failure: error that ended the scan, or None.
        stopped_early: True if `should_stop` ended the scan.
        off_frames_lost: number of lost off frames; their stripes are compared with the previous stripe instead.
        notes: further remarks for the report.
        begun: time at which the scan started [s].
    """

    def __init__(self, task: ScanTask, groups: int) -> None:
        """Prepare the thread.

        Args:
            task: scan to run.
            groups: number of groups that the queue can hold; 0 = unlimited.
        """
        super().__init__(name="scan", daemon=True)
        self._board, self._camera, self._options = task.board, task.camera, task.options
        self._firing_order, self._should_stop = task.firing_order, task.should_stop
        self._cancelled = threading.Event()
        self.switch = LaserSwitch(task.board)
        self.grabber = FrameGrabber(task.camera, task.board, task.options, self._check)
        self.items: queue.Queue[tuple[StripeCapture, ...] | None] = queue.Queue(groups)
        self.fired: list[int] = []
        self.failure: Exception | None = None
        self.stopped_early = False
        self.off_frames_lost = 0
        self.notes: list[str] = []
        self.begun = timing.monotonic()

    def cancel(self) -> None:
        """Turn the laser off now and make the thread end; stripes that were not handed over are dropped."""
        self._cancelled.set()
        self.switch.close()

    def run(self) -> None:
        """Run the scan; the laser is turned off at its end, even after an exception."""
        self.begun = timing.monotonic()
        try:
            self._take()
        except ScanStopped:
            logger.info("scan stopped after %d of %d stripes", len(self.fired), len(self._firing_order))
        except Exception as error:
            self.failure = error
        except BaseException as error:  # an aborted thread must not look like the end of a good scan
            self.failure = AcquisitionError(f"thread {self.name!r} failed: {error!r}")
        finally:
            self._darken()
            self._end()

    @abstractmethod
    def _take(self) -> None:
        """Perform the scan; call `_check` frequently."""

    @abstractmethod
    def _end(self) -> None:
        """Hand over the remaining stripes, then None."""

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
                logger.error("could not turn the laser off after %r: %s", self.failure, error)
