"""Thread of a scan by board sweeps: reads records, grabs frames, and hands over stripes with verified frames."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from drivers import timing
from drivers.arrays import Float
from drivers.board.laser_board import LaserBoard
from drivers.board.protocol import (
    BLOCKING,
    DARKS_SINCE,
    SWEEP_STRIPES,
    WAIT_UNITS,
    BoardFault,
    BoardFlag,
    Shot,
    describe_faults,
)
from drivers.board.sweep_records import StripeRecord
from drivers.errors import CameraNotTriggered, CameraTimeout, LaserRefused
from drivers.frame import Frame
from drivers.sweep.board_sweep import BoardSweep
from drivers.sweep.capture import StripeCapture
from drivers.sweep.firing_order import PlannedStripe
from drivers.sweep.options import OffFrames, SweepOptions
from drivers.sweep.stripe_worker import ScanTask, StripeWorker
from drivers.sweep.sweep_proof import WAIT_UNIT, ClockMatch, uneven_waits

logger = logging.getLogger(__name__)
# Longest wait for a frame, longest wait for a report, and interval of commands that reset the board's watchdog [s].
FRAME_SLICE, REPORT_SLICE, FEED_PERIOD = 0.005, 0.001, 0.1
# Time after the end of a sweep during which frames may still arrive [s].
LAST_FRAMES = 0.1
# Note on a scan with a board that cannot make dark flashes.
NO_DARKS = (
    "no dark flashes: the board speaks protocol 1.1, but they need 1.2: flash firmware/guara_board.uf2, so that "
    "foreign light and frames of another instant are detected"
)


@dataclass
class Sweep:
    """State of a running sweep. Stripes are numbered by their places in the board's step table, from `first`."""

    stripes: Sequence[PlannedStripe]
    motion: int
    first: int = 0
    dark_after: frozenset[int] = frozenset()
    records: list[StripeRecord] = field(default_factory=list)
    clocks: list[float] = field(default_factory=list)
    frames: list[Frame] = field(default_factory=list)
    done: set[int] = field(default_factory=set)
    ended_at: float | None = None


class SweepWorker(StripeWorker):
    """Scan thread for sweeps of the board.

    Of `grabber`, only the counts are used: `used` counts stripes with verified frames, `skipped` frames without a
    device time, and `dropped` all frames that are missing in the camera's counter, even if none was expected.

    Stripes without a verified frame are repeated in up to `SweepOptions.repeats` further sweeps and then count as lost.
    """

    _board: LaserBoard

    def __init__(self, task: ScanTask) -> None:
        """Prepare the thread; `start` runs it."""
        # A sweep does not wait for the caller, so the queue must be unbounded.
        super().__init__(task, groups=0)
        self._sweep_options = task.options.sweep or SweepOptions()
        self._match = ClockMatch(self._sweep_options.tolerance)
        self._counted = False
        self._period = 0.0
        self._off: Frame | None = None
        self._off_settled = task.options.off is not OffFrames.ONE
        self._fed = 0.0
        self._last_counter: int | None = None

    def _take(self) -> None:
        if not self._camera.triggered:
            raise CameraNotTriggered(
                f"{self._camera.name} runs freely: a sweep needs a camera that waits for the board's trigger and "
                "reports device times; scan without AcquireOptions.sweep"
            )
        sweeps = BoardSweep(self._board)
        self._counted = sweeps.counts_exposures
        if not self._counted:
            self.notes.append("exposures not counted: frames are verified by their times alone")
        if self._options.dark_after and not self.takes_darks:
            self.notes.append(NO_DARKS)
        self._camera.flush()
        self._period = max(self._sweep_options.period, self._camera.trigger_period)
        sweeps.prepare(self._sweep_options.flash, self._period, self._options.off)
        missing: Sequence[PlannedStripe] = self._firing_order
        for attempt in range(1 + self._sweep_options.repeats):
            if attempt:
                logger.warning("repeating stripes whose frames could not be verified: %d", len(missing))
                self.notes.append(f"stripes repeated: {len(missing)}")
                if self._off is not None:
                    sweeps.set_off_frames(OffFrames.NONE)
            missing = self._take_sweep(sweeps, missing, SWEEP_STRIPES if attempt else 0)
            if not missing:
                break
        if self._options.off is OffFrames.ONE and self._off is None:
            self.off_frames_lost += 1
        for stripe in missing:
            angle = self._board.identity.angle_of(self._board.step_at(stripe.mirror_angle))
            self.items.put((StripeCapture.of(stripe, angle, None, None),))

    def _take_sweep(self, sweeps: BoardSweep, stripes: Sequence[PlannedStripe], first: int) -> list[PlannedStripe]:
        """Run one sweep, hand over the verified stripes, and return the others."""
        steps = [self._board.step_at(stripe.mirror_angle) for stripe in stripes]
        dark_after = self._dark_places(stripes, first)
        begun = sweeps.begin(steps, self._waits(steps), first, dark_after)
        sweep = Sweep(stripes, begun.motion, first, dark_after)
        self._off_settled = self._off_settled or self._off is not None
        while not self._is_over(sweep):
            self._check()
            self._feed(sweep)
            self._read_records(sweeps, sweep)
            self._grab(sweep)
            self._hand_over(sweep)
        return [stripe for place, stripe in enumerate(stripes, first) if place not in sweep.done]

    @property
    def takes_darks(self) -> bool:
        """True if the board can make dark flashes."""
        return self._board.identity.protocol >= DARKS_SINCE

    def _dark_places(self, stripes: Sequence[PlannedStripe], first: int) -> frozenset[int]:
        """Places of the stripes that are followed by a dark flash; unless empty, they include the last place."""
        if not (self._options.dark_after and self.takes_darks):
            return frozenset()
        places = {place for place, stripe in enumerate(stripes, first) if stripe.index in self._options.dark_after}
        return frozenset({*places, first + len(stripes) - 1})

    def _waits(self, steps: Sequence[int]) -> list[int]:
        """Return the waits before the triggers, in units of 0.5 ms: uneven until the clocks are matched, then zero.

        The camera's period may be longer than a motion and would then absorb part of the wait; the wait is extended by
        that part.
        """
        if self._match.proved:
            return [0] * len(steps)
        motion_profile = self._board.motion_profile()
        needed = self._period * (2 if self._options.off is OffFrames.PER_STRIPE else 1)
        waits = uneven_waits(len(steps), self._sweep_options.tolerance)
        for place, wait in enumerate(waits):
            if wait:
                move = motion_profile.time(steps[place] - steps[max(place - 1, 0)])
                spare = needed - (move + motion_profile.settle + self._sweep_options.flash)
                waits[place] = min(wait + max(0, math.ceil(spare / WAIT_UNIT)), WAIT_UNITS)
        return waits

    def _is_over(self, sweep: Sweep) -> bool:
        if sweep.ended_at is None:
            return False
        return len(sweep.done) == len(sweep.stripes) or timing.monotonic() > sweep.ended_at + LAST_FRAMES

    def _feed(self, sweep: Sweep) -> None:
        now = timing.monotonic()
        if now - self._fed < FEED_PERIOD and not (sweep.records and sweep.records[-1].left == 0):
            return
        self._fed = now
        status = self._board.status()
        if BoardFlag.SWEEPING in status.flags:
            return
        if sweep.ended_at is None:
            sweep.ended_at = now
        blocking = status.faults & (BLOCKING | BoardFault.LASER_DEAD)
        if blocking:
            raise LaserRefused(f"the board ended the sweep: {describe_faults(blocking)}")

    def _read_records(self, sweeps: BoardSweep, sweep: Sweep) -> None:
        while (record := self._board.read_record(REPORT_SLICE)) is not None:
            if not isinstance(record, StripeRecord) or record.motion != sweep.motion & 0xFFFF:
                continue
            sweep.records.append(record)
            sweep.clocks.append(sweeps.clock_of(record))
            if record.shot is Shot.STRIPE and record.lit > 0:
                self.fired.append(sweep.stripes[record.place - sweep.first].index)

    def _grab(self, sweep: Sweep) -> None:
        try:
            frame = self._camera.grab(FRAME_SLICE)
        except CameraTimeout:
            return
        if self._last_counter is not None:
            if frame.counter <= self._last_counter:
                self.grabber.repeated += 1
                return
            self.grabber.dropped += frame.counter - self._last_counter - 1
        self._last_counter = frame.counter
        if frame.device_time is None:
            self.grabber.skipped += 1
            return
        self.grabber.last_stamp = frame.stamp
        sweep.frames.append(frame)

    def _hand_over(self, sweep: Sweep) -> None:
        """Hand over the stripes whose frames have been verified."""
        stamps = np.array([frame.device_time for frame in sweep.frames], dtype=float)
        self._match.learn(np.array(sweep.clocks), stamps)
        if not self._match.proved:
            return
        ready = []
        for number, record in enumerate(sweep.records):
            self._settle_off(sweep, number, stamps)
            if record.shot is Shot.OFF or record.place in sweep.done:
                continue
            on = self._proved(sweep, number, stamps)
            off, may_go = self._off_of(sweep, number, stamps)
            dark = self._dark_of(sweep, number, stamps)
            if on is None or not may_go or (dark is None and record.place in sweep.dark_after):
                continue
            sweep.done.add(record.place)
            self.grabber.used += 1
            ready.append(
                StripeCapture.of(
                    sweep.stripes[record.place - sweep.first], self._board.identity.angle_of(record.step), on, off, dark
                )
            )
        if ready:
            self.items.put(tuple(ready))

    def _settle_off(self, sweep: Sweep, number: int, stamps: Float) -> None:
        """Find the shared off frame; it is lost if the frame of a later trigger is verified first."""
        if self._off_settled or sweep.records[number].shot is not Shot.OFF:
            return
        self._off = self._proved(sweep, number, stamps)
        later = range(number + 1, len(sweep.records))
        self._off_settled = self._off is not None or any(self._proved(sweep, other, stamps) for other in later)

    def _off_of(self, sweep: Sweep, number: int, stamps: Float) -> tuple[Frame | None, bool]:
        """Return the off frame of a stripe, and True if the stripe may be handed over with it."""
        if self._options.off is not OffFrames.PER_STRIPE:
            return self._off, self._off_settled
        if number + 1 >= len(sweep.records):
            return None, False
        off = self._proved(sweep, number + 1, stamps)
        return off, off is not None

    def _dark_of(self, sweep: Sweep, number: int, stamps: Float) -> Frame | None:
        """Return the frame of the dark flash after a stripe; None if there is none or it is not verified yet."""
        after = number + (2 if self._options.off is OffFrames.PER_STRIPE else 1)
        if sweep.records[number].place not in sweep.dark_after or after >= len(sweep.records):
            return None
        return self._proved(sweep, after, stamps)

    def _proved(self, sweep: Sweep, number: int, stamps: Float) -> Frame | None:
        record = sweep.records[number]
        wrong_light = (record.lit > 0) != (record.shot is Shot.STRIPE)
        if wrong_light or record.faults & BLOCKING or (self._counted and record.exposures != 1):
            return None
        found = self._match.frame_of(sweep.clocks[number], stamps)
        return None if found is None else sweep.frames[found]

    def _end(self) -> None:
        self.items.put(None)
