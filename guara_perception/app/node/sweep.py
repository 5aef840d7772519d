"""Laser sweep at a pause: a fixed pattern, or a coarse pattern and further stripes if it finds obstacles."""

from __future__ import annotations

import dataclasses
import itertools
import logging
import math
import secrets
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from guara_perception.app.node.live_scan import LiveScan, live_scan
from guara_perception.app.node.pause_stream import PauseStream
from guara_perception.app.node.rangefinder import FiringOrder, Rangefinder, firing_order
from guara_perception.app.node.recorder import ScanRecording
from guara_perception.calibration.calibration import Calibration
from guara_perception.progress import Progress
from guara_perception.scanning.scan_processor import ScanProcessor
from guara_perception.settings import MODES, Settings
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.scan.policy import ScanPolicy, refined
from transport import clock

if TYPE_CHECKING:
    from drivers import StripeCapture

logger = logging.getLogger(__name__)
ADAPTIVE = "adaptive"
SWEEPS = (*MODES, ADAPTIVE)
# [s] Margin for other load on the machine, added to the measured time from the last frame to the published grid.
MARGIN_S = 0.1
# Largest number of sweeps for one scan if each is refused, for instance because of light from another laser.
MOST_SWEEPS = 4
# [s] Shortest sweep duration assumed in `retry_delay`; interval at which the wait for a repetition checks for a stop.
LEAST_WAIT_S, WAIT_SLICE_S = 0.2, 0.02


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepJob:
    """Inputs of a sweep that depend on its pause.

    Attributes:
        processor: function that creates the ScanProcessor of a mode.
        should_stop: function that returns True to end the sweep.
        publish: function that publishes a coarse grid, which is refined afterwards.
        ends_at: function that returns the instant on `transport.clock` at which the gait moves on [s], or None if that
            instant is not known.
        tail: expected time from the last frame until the grid is published [s].
        progress: called with (stripes done, total number of stripes), or None.
        recording: recording to which every stripe is added, or None.
        on_stripe: called with every stripe, or None.
        stream: function that returns the joint stream that gives the body's pose, or None if the body must stand still.
        placed: function that waits for the joint samples that locate the stripes; called after the last stripe of each
            pattern with the processor and the `LiveScan`.
    """

    processor: Callable[[str], ScanProcessor]
    should_stop: Callable[[], bool]
    publish: Callable[[Swept], None]
    ends_at: Callable[[], float | None] = lambda: None
    tail: float = 0.0
    progress: Progress | None = None
    recording: ScanRecording | None = None
    on_stripe: Callable[[StripeCapture], None] | None = None
    stream: Callable[[], PauseStream | None] = lambda: None
    placed: Callable[[ScanProcessor, LiveScan], None] = lambda processor, scan: None


@dataclass(frozen=True, slots=True)
class Swept:
    """Result of a sweep.

    Attributes:
        terrain: grid of the sweep.
        scan: times and faults of the devices.
        processor: processor that made the grid.
        coarse: processor of the coarse stripes alone; None if no intermediate stripes were fired.
        is_cut: True if `until` removed stripes.
    """

    terrain: TerrainGrid
    scan: LiveScan
    processor: ScanProcessor
    coarse: ScanProcessor | None = None
    is_cut: bool = False

    def until(self, instant: float) -> Swept | None:
        """Copy without the stripes that have frames later than `instant`; None if no cell of the copy is known."""
        kept = [index for index, came in self.scan.instants.items() if came <= instant]
        coarse = None if self.coarse is None else self.coarse.restricted(kept)
        processor = self.processor.restricted(kept)
        terrain = processor.finish()
        if coarse is not None:
            terrain = refined(coarse.finish(), terrain)
        if not terrain.record.known:
            return None
        problem = (
            f"{len(self.scan.instants) - len(kept)} of {len(self.scan.instants)} stripes are left out: they were "
            "taken after the last joint reading that confirms the scan"
        )
        instants = {index: self.scan.instants[index] for index in kept}
        problems, last = (*self.scan.problems, problem), max(instants.values())
        scan = dataclasses.replace(self.scan, last_frame=last, problems=problems, instants=instants)
        return Swept(terrain, scan, processor, coarse, is_cut=True)

    def wide(self, terrain: TerrainGrid) -> TerrainGrid:
        """Grid of all scanned ground for the map, including the ground beside the footprint.

        Args:
            terrain: published grid of the footprint. The wide grid gets its stamp, and its record except for
                `lost_cells`.
        """
        record = terrain.scan_record
        wide = self.processor.finish("wide", record=record)
        if self.coarse is not None:
            wide = refined(self.coarse.finish("wide", record=record), wide)
        record = dataclasses.replace(record, lost_cells=wide.scan_record.lost_cells)
        return dataclasses.replace(wide, stamp=terrain.stamp, record=record)


def retry_delay(took: float) -> float:
    """Random wait before a sweep is repeated [s], so that two robots are unlikely to sweep at the same time again.

    Args:
        took: duration of the unusable sweep [s].
    """
    return max(took, LEAST_WAIT_S) * (0.3 + 2.4 * secrets.randbelow(1 << 20) / (1 << 20))


class Sweeper:
    """Laser sweeps at the pauses of a robot. The `policy` keeps state from one pause to the next."""

    def __init__(self, calibration: Calibration, rangefinder: Rangefinder, settings: Settings, policy: ScanPolicy):
        """Store the parts. The mirror angles are those of `calibration`, which must belong to `rangefinder`."""
        self._calibration, self._rangefinder = calibration, rangefinder
        self._settings, self._policy = settings, policy

    def sweep(self, mode: str, job: SweepJob) -> Swept:
        """Sweep in a mode of SWEEPS.

        A refused sweep (light from another laser, or frames that show another flash) is repeated while time is left, up
        to MOST_SWEEPS sweeps in total.
        """
        for attempt in itertools.count(1):
            start = clock.now()
            swept = self._sweep(mode, job)
            if not swept.processor.refused or attempt == MOST_SWEEPS:
                break
            took = clock.now() - start
            wait = retry_delay(took)
            ends_at = job.ends_at()
            if ends_at is not None and clock.now() + wait + took + job.tail + MARGIN_S > ends_at:
                break
            logger.warning("scan refused, sweeping again in %.1f s: %s", wait, swept.processor.refused)
            if not self._wait(wait, job.should_stop):
                break
            if job.recording is not None:
                job.recording.restart()
        return swept

    @staticmethod
    def _wait(seconds: float, should_stop: Callable[[], bool]) -> bool:
        """Wait for `seconds`; return False as soon as the scan has to stop."""
        until = clock.now() + seconds
        while clock.now() < until:
            if should_stop():
                return False
            time.sleep(WAIT_SLICE_S)
        return True

    def _sweep(self, mode: str, job: SweepJob) -> Swept:
        if mode == ADAPTIVE:
            return self._adaptive(job)
        processor = job.processor(mode)
        scan = self._run(processor, firing_order(self._calibration, self._settings.pattern(mode)), job)
        return Swept(processor.finish(), scan, processor)

    def _adaptive(self, job: SweepJob) -> Swept:
        start = clock.now()
        processor = first_processor = job.processor("coarse")
        order = firing_order(self._calibration, self._policy.first_stripes)
        first = self._run(processor, order, job)
        coarse = processor.finish()
        if first.stopped_early or first.failed or processor.refused:
            return Swept(coarse, first, processor)
        now = clock.now()
        ends_at, finishing = job.ends_at(), now - first.last_frame
        left = None if ends_at is None else max(ends_at - now - max(job.tail, finishing) - MARGIN_S, 0.0)
        stripe_time = max(first.last_frame - start, 1e-3) / len(order)
        decision = self._policy.decide(coarse, processor.pairs, time_left=left, stripe_time=stripe_time)
        between = firing_order(self._calibration, decision.stripes)
        if not between:
            return Swept(coarse, first, processor)
        job.publish(Swept(coarse, first, processor))
        logger.info("firing intermediate stripes: %s", "; ".join(decision.reasons) or "an earlier scan found obstacles")
        if job.recording is not None:
            job.recording.extend("standard" if decision.is_whole else None)
        processor = processor.extended()
        second = self._run(processor, between, job)
        both = dataclasses.replace(
            second,
            start=first.start,
            problems=tuple(dict.fromkeys((*first.problems, *second.problems))),
            instants={**first.instants, **second.instants},
        )
        fine = processor.finish()
        if processor.refused:
            coarse = first_processor.finish()
        return Swept(refined(coarse, fine), both, processor, first_processor)

    def _run(self, processor: ScanProcessor, order: FiringOrder, job: SweepJob) -> LiveScan:
        done = len(processor.profiles)
        stream, flash = job.stream(), None
        if stream is not None:
            self._rangefinder.keep_time()
            flash = partial(self._flash, stream, clock.now() - time.monotonic())

        def on_stripe(capture: StripeCapture, instant: float) -> None:
            if job.progress is not None:
                job.progress(len(processor.profiles), done + len(order))
            if job.recording is not None:
                known = None if stream is None else stream.record(processor.flash(capture.index))
                job.recording.add(capture, known, instant=instant)
            if job.on_stripe is not None:
                job.on_stripe(capture)

        scan = live_scan(
            self._rangefinder,
            processor,
            order,
            should_stop=job.should_stop,
            on_stripe=on_stripe,
            flash=flash,
        )
        job.placed(processor, scan)
        return scan

    def _flash(self, stream: PauseStream, offset: float, stamp: float) -> tuple[float, float]:
        """Time of a frame's flash after the BEGIN message of the pause, and its sigma [s]; NaN and 0 if unknown.

        Args:
            stream: joint stream of the pause.
            offset: `transport.clock` minus the machine's monotonic clock [s].
            stamp: stamp of the frame [s].
        """
        found = self._rangefinder.flash(stamp)
        return (math.nan, 0.0) if found is None else stream.instant(found[0] + offset, found[1])
