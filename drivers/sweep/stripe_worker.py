"""`StripeWorker`: what the threads of a scan have in common, whether host or board turns the mirror."""

from __future__ import annotations

import logging
import queue
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable

from drivers import timing
from drivers.board.laser_board import LaserBoard
from drivers.cameras.camera import Camera
from drivers.sweep.firing_order import PlannedStripe
from drivers.sweep.laser_switch import LaserSwitch, ScanStopped
from drivers.sweep.options import AcquireOptions
from drivers.sweep.raw_stripe import RawStripe

logger = logging.getLogger(__name__)


class StripeWorker(threading.Thread, ABC):
    """Takes one scan. `items` carries stripes in groups, see `AcquireOptions.together`, and at the end None.

    Attributes:
        items: the queue to the caller.
        switch: switch of the laser.
        fired: indices for which the laser was on.
        failure: the error that ended the scan, or None.
        stopped_early: whether `should_stop` ended it.
        off_frames_lost: off frames that did not come; their stripes are compared with the one before.
        notes: further remarks for the report.
        begun: when the scan began [s].
    """

    def __init__(
        self,
        name: str,
        board: LaserBoard,
        camera: Camera,
        firing_order: tuple[PlannedStripe, ...],
        options: AcquireOptions,
        should_stop: Callable[[], bool] | None,
        groups: int,
    ) -> None:
        """Prepare; `start` begins.

        Args:
            name: name of the thread.
            board, camera, firing_order, options, should_stop: as in `drivers.acquire`.
            groups: number of groups that may wait for the caller; 0 for any number.
        """
        super().__init__(name=name, daemon=True)
        self._board, self._camera, self._firing_order, self._options = board, camera, firing_order, options
        self._should_stop = should_stop
        self._cancelled = threading.Event()
        self.switch = LaserSwitch(board)
        self.items: queue.Queue[tuple[RawStripe, ...] | None] = queue.Queue(groups)
        self.fired: list[int] = []
        self.failure: Exception | None = None
        self.stopped_early = False
        self.off_frames_lost = 0
        self.notes: list[str] = []
        self.begun = timing.monotonic()

    def cancel(self) -> None:
        """Put the laser out now and end the thread soon; what has not been handed over is forgotten."""
        self._cancelled.set()
        self.switch.close()

    def run(self) -> None:
        """Take the scan; the laser is out when this ends, however it ends."""
        self.begun = timing.monotonic()
        try:
            self._take()
        except ScanStopped:
            logger.info("scan stopped after %d of %d stripes", len(self.fired), len(self._firing_order))
        except Exception as error:
            self.failure = error
        finally:
            self._darken()
            self._end()

    @abstractmethod
    def _take(self) -> None:
        """Take the scan, ask `_check` often."""

    @abstractmethod
    def _end(self) -> None:
        """Hand over what is left, and None."""

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
