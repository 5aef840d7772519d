"""Acquisition of a scan; each stripe is verified when it is handed over, while the scan continues."""

from __future__ import annotations

import dataclasses
import logging
import math
import queue
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from types import TracebackType

import numpy as np

from drivers.arrays import Image
from drivers.board.board import Board
from drivers.board.laser_board import LaserBoard
from drivers.cameras.camera import Camera
from drivers.errors import AcquisitionNotEntered, BoardTooOld, DriverError
from drivers.sweep.capture import ScanReport, StripeCapture, StripeEvidence, StripeVerdict
from drivers.sweep.firing_order import RowRangeOf, check_firing_order
from drivers.sweep.options import AcquireOptions
from drivers.sweep.proof import Align, StripeProof
from drivers.sweep.scan_worker import ScanWorker
from drivers.sweep.stripe_worker import ScanTask
from drivers.sweep.sweep_worker import SweepWorker

logger = logging.getLogger(__name__)
# Interval of checks that the scan thread is still running [s].
POLL = 1.0
# Longest wait for the scan thread at the end of a scan [s].
JOIN = 2.0
MEANINGS = {
    StripeVerdict.AMBIENT_CHANGED: "the light or the camera's exposure changed: lock its settings",
    StripeVerdict.LEAK: "light in the off frame: the laser does not go off, or the camera's lag is wrong",
    StripeVerdict.NOT_MOVED: "the stripe did not move: the mirror is stuck, or the camera's lag is wrong",
    StripeVerdict.OUT_OF_BAND: "the stripe is outside its possible rows: steps lost, or camera or mirror moved",
    StripeVerdict.REPEATED: "the camera delivers the same image again: it is frozen",
    StripeVerdict.RESIZED: "the camera changed the size of its images",
    StripeVerdict.LOST: "no frame arrived, or none could be verified",
}


def acquire(
    board: Board,
    camera: Camera,
    firing_order: Iterable[tuple[int, float]],
    options: AcquireOptions | None = None,
    *,
    band: RowRangeOf | None = None,
    should_stop: Callable[[], bool] | None = None,
    align: Align | None = None,
) -> StripeStream:
    """Return a scan as a context manager that iterates over its stripes. The scan starts on entry.

    ```python
    with acquire(board, camera, firing_order, should_stop=pause_is_over) as stripes:
        for stripe in stripes:
            processor.add(stripe.index, stripe.on, stripe.off)
    report = stripes.report
    ```

    With `options.together`, `stripes.groups()` iterates over tuples of stripes.

    The laser is off after the block, even if the block raises an exception.

    Args:
        board: open laser board.
        camera: open camera.
        firing_order: pairs (index, mirror angle [rad]) in the order of scanning.
        options: options of the scan; None = defaults (one off frame for all stripes).
        band: returns the rows (first, end) in which the stripe with a given index can be; None = anywhere.
        should_stop: called often on the scan thread; return True to end the scan early.
        align: for a camera that may move during the scan: function that warps the first image to the view of the
            second, or returns None if it finds no motion. A stripe with verdict LEAK, DARK, OUT_OF_BAND or NOT_MOVED is
            verified again with the aligned reference. None = the camera does not move.

    Raises:
        BadFiringOrder: the order is empty, has a repeated or negative index, or contains an angle that is not finite.
        BoardTooOld: a sweep is requested, but `board` is not a `LaserBoard`.
    """
    order = check_firing_order(firing_order)
    return StripeStream(ScanTask(board, camera, order, options or AcquireOptions(), should_stop), band, align)


def prepare(board: Board, firing_order: Iterable[tuple[int, float]]) -> int:
    """Home the mirror between scans and move it to the first stripe.

    Returns:
        Error of the step count since the mirror was last homed [steps]. If it is not 0, the scans since then are
        doubtful.

    Raises:
        BadFiringOrder: the order is not valid; see `acquire`.
        BoardError: the board cannot be reached, made ready or homed, or the first angle is outside its travel.
    """
    first = check_firing_order(firing_order)[0]
    board.ensure_ready()
    lost = board.home()
    board.clear_faults()
    board.go_to_angle(first.mirror_angle)
    return lost


class StripeStream:
    """Scan in progress, created by `acquire`.

    Attributes:
        dark_after: indices of the stripes for which a dark flash is planned; empty if the board cannot make dark
            flashes.
    """

    def __init__(self, task: ScanTask, band: RowRangeOf | None, align: Align | None = None) -> None:
        """Prepare the scan; see `acquire`."""
        self._task, self._band = task, band
        if task.options.sweep is not None and not isinstance(task.board, LaserBoard):
            raise BoardTooOld(
                f"{type(task.board).__name__} cannot run sweeps, which a triggered camera needs: let the camera run "
                "freely"
            )
        self._worker = ScanWorker(task) if task.options.sweep is None else SweepWorker(task)
        self._proof = StripeProof(task.options.limits, align)
        takes_darks = not isinstance(self._worker, SweepWorker) or self._worker.takes_darks
        self.dark_after: frozenset[int] = task.options.dark_after if takes_darks else frozenset()
        self._verdicts: list[tuple[int, StripeVerdict]] = []
        self._on_before: Image | None = None
        self._waiting: deque[StripeCapture] = deque()
        self._entered = self._ended = False

    def __enter__(self) -> StripeStream:
        """Make the board ready (clear faults, home the mirror if necessary) and start the scan.

        Raises:
            MirrorOutOfRange: an angle is outside the board's travel.
            BoardError: the board cannot be reached or made ready.
        """
        for stripe in self._task.firing_order:
            self._task.board.step_at(stripe.mirror_angle)
        self._task.board.ensure_ready()
        self._entered = True
        self._worker.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Turn the laser off and end the scan."""
        try:
            self._worker.cancel()
        except DriverError as failure:
            # The iteration has already raised the error that ended the scan; a second one from `cancel` is only logged.
            if error is None and not (self._ended and self._worker.failure is not None):
                raise
            logger.error("ending the scan failed after %r: %s", error or self._worker.failure, failure)
        finally:
            self._worker.join(JOIN)
            if self._worker.is_alive():
                logger.error("the scan thread did not stop within %g s", JOIN)

    def __iter__(self) -> Iterator[StripeCapture]:
        """Iterate over the stripes as they are handed over.

        Raises:
            AcquisitionNotEntered: the `with` block has not been entered.
            Exception: the error that ended the scan, usually a DriverError; `report` lists the stripes before it.
        """
        while self._await_group():
            while self._waiting:
                yield self._judged(self._waiting.popleft())

    def groups(self) -> Iterator[tuple[StripeCapture, ...]]:
        """Iterate over groups of stripes that are handed over together (see `AcquireOptions.together`).

        Raises:
            AcquisitionNotEntered: the `with` block has not been entered.
            Exception: the error that ended the scan, usually a DriverError; `report` lists the stripes before it.
        """
        while self._await_group():
            yield tuple(self._judged(self._waiting.popleft()) for _ in range(len(self._waiting)))

    @property
    def report(self) -> ScanReport:
        """Result of the scan so far; complete once the iteration has ended."""
        worker, grabber, verdicts = self._worker, self._worker.grabber, tuple(self._verdicts)
        return ScanReport(
            planned=tuple(stripe.index for stripe in self._task.firing_order),
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

    def _await_group(self) -> bool:
        """Wait until a stripe is available; return False at the end of the scan."""
        if not self._entered:
            raise AcquisitionNotEntered("enter the scan first: `with acquire(...) as stripes:`")
        while not self._waiting and not self._ended:
            try:
                group = self._worker.items.get(timeout=POLL)
            except queue.Empty:
                if self._worker.is_alive() or not self._worker.items.empty():
                    continue
                group = None
            self._waiting.extend(group or ())
            self._ended = group is None
            if self._ended and self._worker.failure is not None:
                raise self._worker.failure
        return bool(self._waiting)

    def _judged(self, taken: StripeCapture) -> StripeCapture:
        verdict, evidence = self._verdict(taken)
        self._verdicts.append((taken.index, verdict))
        if verdict is StripeVerdict.RESIZED:
            taken = dataclasses.replace(taken, on=None, on_stamp=math.nan)
        elif taken.on is not None:
            self._on_before = taken.on
        is_dark_due = taken.index in self.dark_after or taken.dark is not None
        return dataclasses.replace(taken, verdict=verdict, evidence=evidence, is_dark_due=is_dark_due)

    def _verdict(self, taken: StripeCapture) -> tuple[StripeVerdict, StripeEvidence | None]:
        image = taken.on
        reference = self._on_before if taken.off is None else taken.off
        if image is None or reference is None:
            return taken.verdict, None
        before = self._on_before if self._on_before is not None else reference
        if any(image.shape != other.shape or image.dtype != other.dtype for other in (reference, before)):
            return StripeVerdict.RESIZED, None
        band = None if self._band is None else self._band(taken.index)
        verdict, evidence = self._proof.judge(
            taken.mirror_angle, image, reference, reference_is_off=taken.off is not None, band=band
        )
        if verdict in (StripeVerdict.DARK, StripeVerdict.NOT_MOVED) and (
            np.array_equal(image, reference) or (before is not reference and np.array_equal(image, before))
        ):
            verdict = StripeVerdict.REPEATED
        return verdict, evidence


def _problems(worker: ScanWorker | SweepWorker, verdicts: tuple[tuple[int, StripeVerdict], ...]) -> list[str]:
    counts = Counter(verdict for _, verdict in verdicts)
    problems = [
        f"{counts[kind]} of {len(verdicts)} stripes: {meaning}" for kind, meaning in MEANINGS.items() if counts[kind]
    ]
    if verdicts and counts[StripeVerdict.DARK] == len(verdicts):
        problems.append("no stripe shows the laser: it is dead, covered, or out of the camera's view")
    elif len(verdicts) > 1 and verdicts[0][1] is StripeVerdict.DARK and verdicts[1][1] is not StripeVerdict.DARK:
        problems.append("the first stripe is dark and the second is not: frames may lag behind the commands")
    counted = {
        "times that the board refused to switch the laser on because of a fault: {}": worker.switch.interruptions,
        "off frames that did not arrive: {}": worker.off_frames_lost,
        "frames dropped on their way from the camera: {}": worker.grabber.dropped,
        "frames that arrived twice: {}": worker.grabber.repeated,
    }
    problems += [text.format(count) for text, count in counted.items() if count]
    if worker.failure is not None:
        problems.append(f"the scan failed: {worker.failure}")
    return problems
