"""Writes the report of a scan from what its thread counted and from the verdicts on its stripes."""

from __future__ import annotations

from collections import Counter

from drivers.sweep.capture import ScanReport, StripeVerdict
from drivers.sweep.firing_order import PlannedStripe
from drivers.sweep.scan_worker import ScanWorker
from drivers.sweep.sweep_worker import SweepWorker

MEANINGS = {
    StripeVerdict.AMBIENT_CHANGED: "the light or the camera's exposure changed: lock its settings",
    StripeVerdict.LEAK: "light in the off frame: the laser does not go out, or the camera's lag is wrong",
    StripeVerdict.NOT_MOVED: "the stripe did not move: the mirror is stuck, or the camera's lag is wrong",
    StripeVerdict.OUT_OF_BAND: "the stripe is where it cannot be: steps lost, or camera or mirror moved",
    StripeVerdict.REPEATED: "the camera delivers the same picture again: it is frozen",
    StripeVerdict.RESIZED: "the camera changed its picture's size",
    StripeVerdict.LOST: "no frame came",
}


def write_report(
    firing_order: tuple[PlannedStripe, ...],
    worker: ScanWorker | SweepWorker,
    verdicts: tuple[tuple[int, StripeVerdict], ...],
) -> ScanReport:
    """The report.

    Args:
        firing_order: what was planned.
        worker: the scan's thread, alive or not.
        verdicts: (index, verdict) of each stripe handed out, in order.
    """
    grabber = worker.grabber
    return ScanReport(
        planned=tuple(stripe.index for stripe in firing_order),
        fired=tuple(worker.fired),
        verdicts=verdicts,
        stopped_early=worker.stopped_early,
        failure=None if worker.failure is None else str(worker.failure),
        frames_used=grabber.used,
        frames_skipped=grabber.skipped,
        frames_dropped=grabber.dropped,
        frames_repeated=grabber.repeated,
        duration=max(0.0, grabber.last_stamp - worker.begun),
        problems=tuple(_problems(worker, verdicts)),
        notes=tuple(worker.notes),
    )


def _problems(worker: ScanWorker | SweepWorker, verdicts: tuple[tuple[int, StripeVerdict], ...]) -> list[str]:
    counts = Counter(verdict for _, verdict in verdicts)
    problems = [
        f"{counts[kind]} of {len(verdicts)} stripes: {meaning}" for kind, meaning in MEANINGS.items() if counts[kind]
    ]
    if verdicts and counts[StripeVerdict.DARK] == len(verdicts):
        problems.append("no stripe shows the laser: it is dead or covered, or the camera does not look at it")
    elif len(verdicts) > 1 and verdicts[0][1] is StripeVerdict.DARK and verdicts[1][1] is not StripeVerdict.DARK:
        problems.append("the first stripe is dark and the second is not: frames may lag behind the commands")
    if worker.switch.interruptions:
        problems.append(f"the board put the laser out {worker.switch.interruptions} times during the scan")
    if worker.off_frames_lost:
        problems.append(f"{worker.off_frames_lost} off frames did not come")
    if worker.grabber.dropped:
        problems.append(f"{worker.grabber.dropped} frames were dropped on their way from the camera")
    if worker.grabber.repeated:
        problems.append(f"{worker.grabber.repeated} frames came twice")
    if worker.failure is not None:
        problems.append(f"the scan failed: {worker.failure}")
    return problems
