"""Thread of a scan in which the host commands mirror and laser for each stripe and grabs the frames."""

from __future__ import annotations

import dataclasses
import queue
from collections.abc import Callable

from drivers import timing
from drivers.errors import CameraTimeout
from drivers.frame import Frame
from drivers.sweep.capture import StripeCapture
from drivers.sweep.firing_order import PlannedStripe
from drivers.sweep.options import OffFrames
from drivers.sweep.stripe_worker import ScanStopped, ScanTask, StripeWorker

# Interval of checks for cancellation while the queue is full [s].
QUEUE_SLICE = 0.05


class ScanWorker(StripeWorker):
    """Thread that scans stripe by stripe with a free-running camera; the queue to the caller is bounded."""

    def __init__(self, task: ScanTask) -> None:
        """Prepare the thread; `start` begins the scan."""
        super().__init__(task, groups=-(-task.options.queue_size // task.options.together))
        self._lost_in_row = 0
        self._group: list[StripeCapture] = []
        self._steps: list[int] = []

    def _take(self) -> None:
        self.grabber.restart()
        # Computed in advance: a call right after a sleep, as between frames, is many times slower.
        self._steps = [self._board.step_at(stripe.mirror_angle) for stripe in self._firing_order]
        try:
            if self._options.off is OffFrames.PER_STRIPE:
                self._take_pairs()
            else:
                self._take_sweep()
        except ScanStopped:
            self._take_last_dark()
            raise

    def _take_last_dark(self) -> None:
        """If the scan was stopped early, end it with a laser-off frame (dark flash) that verifies the last stripes."""
        if not (self.stopped_early and self._options.dark_after and self._group) or self._group[-1].dark is not None:
            return
        self._should_stop = None
        self.switch.off()
        dark = self.grabber.after(timing.monotonic())
        if dark is not None:
            self._group[-1] = dataclasses.replace(self._group[-1], dark=dark.image, dark_stamp=dark.stamp)

    def _end(self) -> None:
        if self._group:
            self._put(tuple(self._group))
        self._put(None)

    def _take_pairs(self) -> None:
        reached = self._board.go_to_step(self._steps[0], wait=False)
        for number, stripe in enumerate(self._firing_order):
            self._board.wait_until_still()
            self._check()
            self.switch.on()
            self.fired.append(stripe.index)
            on = self._frame()
            self.switch.off()
            dark = timing.monotonic()
            here, reached = reached, self._move_on(number, reached)
            # The off frame does not depend on the mirror, which moves on in the meantime.
            off = self._off_frame(dark)
            self._collect(number, self._capture(stripe, here, on, off))

    def _take_sweep(self) -> None:
        self.switch.off()
        reached = self._board.go_to_step(self._steps[0], wait=False)
        off = self._off_frame(timing.monotonic()) if self._options.off is OffFrames.ONE else None
        for number, stripe in enumerate(self._firing_order):
            # With the laser on, a free-running camera exposes the next frame while the mirror settles, which saves one
            # wait; the board's status then shows whether the mirror was at rest before the exposure. With a replay (lag
            # 0) or an unknown lag, wait for the mirror first.
            self._check()
            ahead = bool(self._camera.lag) and self.switch.may_stay_on
            if not ahead:
                self.switch.keep_on(self._board.wait_until_still().laser_commanded)
            self.fired.append(stripe.index)
            on = self._frame(self._lit_and_still if ahead else None)
            here, reached = reached, self._move_on(number, reached)
            if number + 1 == len(self._firing_order) or stripe.index in self._options.dark_after:
                self.switch.off()
            self._collect(number, self._capture(stripe, here, on, off))

    def _move_on(self, number: int, reached: float) -> float:
        if number + 1 < len(self._firing_order):
            return self._board.go_to_step(self._steps[number + 1], wait=False)
        return reached

    def _capture(self, stripe: PlannedStripe, reached: float, on: Frame | None, off: Frame | None) -> StripeCapture:
        """Make the capture of a stripe; if a dark flash is due, take its frame first, with the laser already off."""
        if stripe.index not in self._options.dark_after:
            return StripeCapture.of(stripe, reached, on, off)
        # If the first frame is lost, the next one serves the purpose as well.
        dark = self.grabber.after(timing.monotonic()) or self.grabber.after(timing.monotonic())
        return StripeCapture.of(stripe, reached, None if dark is None else on, off, dark)

    def _off_frame(self, dark_since: float) -> Frame | None:
        frame = self.grabber.after(dark_since)
        self.off_frames_lost += frame is None
        return frame

    def _lit_and_still(self) -> float:
        """Wait until the mirror is at rest; return a time after which it was at rest and the laser was on [s]."""
        status, since = self._board.still_since()
        if status.laser_commanded:
            return since
        self.switch.keep_on(False)
        return timing.monotonic()

    def _frame(self, proved: Callable[[], float] | None = None) -> Frame | None:
        frame = self.grabber.after(timing.monotonic(), proved)
        self._lost_in_row = 0 if frame is not None else self._lost_in_row + 1
        if self._lost_in_row >= self._options.max_lost:
            raise CameraTimeout(
                f"{self._camera.name} delivered no frame for {self._lost_in_row} stripes in a row "
                f"({self._options.frame_timeout:g} s each): check its cable and exposure"
            )
        return frame

    def _collect(self, number: int, stripe: StripeCapture) -> None:
        """Add a stripe to the group, and hand the group over when it is full; groups shrink near the end of the scan.

        In a scan with dark flashes, the newest stripe is held back, because a scan that is stopped early ends with a
        dark flash for its last stripe.
        """
        self._group.append(stripe)
        left = len(self._firing_order) - 1 - number
        ready = len(self._group) - bool(self._options.dark_after and left)
        if ready < max(min(self._options.together, 2 * left - 2), 1):
            return
        must_wait = self.items.full()
        if must_wait:
            self.switch.off()
        if self._put(tuple(self._group[:ready])):
            del self._group[:ready]
            if must_wait:
                self.grabber.restart()

    def _put(self, item: tuple[StripeCapture, ...] | None) -> bool:
        """Put an item into the queue when there is room; return False if the scan is cancelled first."""
        while not self._cancelled.is_set():
            try:
                self.items.put(item, timeout=QUEUE_SLICE)
                return True
            except queue.Full:
                continue
        return False
