"""Live scan: sweep the laser over the stripes and pass each stripe to a ScanProcessor as it arrives."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from drivers import DriverError, LightCheck, StripeCapture, timing
from guara_perception.app.node.rangefinder import FiringOrder, Rangefinder
from guara_perception.scanning.scan_processor import ScanProcessor
from guara_perception.stripes.band import FramePair
from transport import clock

# Number of remaining stripes at which computation of the grid begins. Scanning them takes longer than the computation,
# even on a computer three times slower than a desktop.
STRIPES_AFTER = 3


@dataclass(frozen=True, slots=True)
class LiveScan:
    """Times and faults of the devices during a live scan.

    Attributes:
        start: instant before the first frame [ns since the Unix epoch].
        end: instant at which the host received the last frame [ns since the Unix epoch].
        last_frame: the same instant on `transport.clock` [s].
        problems: problems of devices and light; empty for a good scan.
        stopped_early: True if the scan was stopped before its last stripe.
        failed: True if a device failed; the processor has the stripes scanned before.
        instants: instant on `transport.clock` at which the host received the last frame of each stripe [s], by index;
            the end of the scan for a fired stripe without a frame.
    """

    start: int
    end: int
    last_frame: float
    problems: tuple[str, ...]
    stopped_early: bool
    failed: bool
    instants: Mapping[int, float] = field(default_factory=dict)


def live_scan(
    rangefinder: Rangefinder,
    processor: ScanProcessor,
    firing_order: FiringOrder,
    *,
    should_stop: Callable[[], bool],
    on_stripe: Callable[[StripeCapture, float], None] | None = None,
    flash: Callable[[float], tuple[float, float]] | None = None,
) -> LiveScan:
    """Take a scan. If a device fails, the scan ends early and the stripes up to then are kept.

    A fired stripe whose frame was lost or shows another stripe is marked as bad: its ground counts as scanned without a
    return. The ground of a stripe that was not fired stays unscanned.

    The camera's locked settings are read back before the first stripe, and the light is checked on the first stripes.
    Changed settings and unsuitable light are added to the problems.

    Args:
        rangefinder: open devices.
        processor: processor of the stripes, created for the stance of this pause.
        firing_order: (index, mirror angle [rad]) of each stripe in firing order.
        should_stop: function that returns True to end the scan, for instance because the pause has ended.
        on_stripe: called after each stripe with the capture and the instant at which its frames had arrived
            [s on `transport.clock`], for recording and progress.
        flash: function that returns `FramePair.instant` and its sigma for the stamp of a frame; None = no instants.
    """
    start = time.time_ns()
    problems = list(rangefinder.setting_changes())
    light = LightCheck()
    failed = False
    worked_ahead = False
    instants: dict[int, float] = {}

    def take(group: Sequence[StripeCapture]) -> None:
        pairs = []
        for capture in group:
            light.look(capture, processor.band(capture.index))
            if capture.on is None or not capture.verdict.in_step:
                processor.mark_bad(capture.index, f"frame {capture.verdict.value}")
                if capture.dark is not None:
                    processor.add_dark(capture.index, capture.dark, off=capture.off)
            else:
                instant = (math.nan, 0.0) if flash is None else flash(capture.on_stamp)
                pairs.append(FramePair(capture.index, capture.on, capture.off, capture.dark, *instant))
        if pairs:
            processor.add_all(pairs)
        if on_stripe is not None:
            for capture in group:
                on_stripe(capture, instants[capture.index])

    stripes = rangefinder.sweep(firing_order, processor.band, should_stop)
    processor.expect_dark(stripes.dark_after)
    try:
        with stripes:
            for group in stripes.groups():
                instants.update({capture.index: _instant(capture, rangefinder) for capture in group})
                take(group)
                # Otherwise the frames of this group would stay in memory until the next group is complete.
                del group
                if 0 < len(firing_order) - len(instants) <= STRIPES_AFTER and not worked_ahead:
                    # Compute while the mirror turns to the last stripes: after the scan, the gait would have to wait.
                    worked_ahead = True
                    processor.work_ahead()
    except DriverError as error:
        failed = True
        problems.append(str(error))
    now = clock.now()
    last_frame = max(instants.values(), default=now)
    end = time.time_ns() - round((now - last_frame) * 1e9)
    problems.extend(light.problems)
    report = stripes.report
    for index in report.fired:
        if index not in instants:
            instants[index] = now
            processor.mark_bad(index, "fired, but no frame arrived")
    problems.extend(problem for problem in report.problems if problem not in problems)
    return LiveScan(start, end, last_frame, tuple(problems), report.stopped_early, failed, instants)


def _instant(capture: StripeCapture, rangefinder: Rangefinder) -> float:
    """Instant on `transport.clock` at which the host had received all frames of a stripe [s].

    If the frames have no stamps or the devices do not run on the machine's clock, this is the current time.
    """
    stamps = [stamp for stamp in (capture.on_stamp, capture.off_stamp, capture.dark_stamp) if not math.isnan(stamp)]
    if not stamps or rangefinder.clock is not None:
        return clock.now()
    return clock.now() - max(0.0, timing.monotonic() - max(stamps))
