"""Monitor of the gait's joint stream: rate, gaps and rejected batches, for the status."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable

import numpy as np

from guara_perception.app.node.pause_stream import PauseStream
from kinematics import KinematicsError, RobotModel
from kinematics.tree import checked_positions
from transport import Health, StanceStream, StatusItem, TransportError, clock
from transport.messages.stance_stream import ANY_WALK

# [1/s] Allowed sampling rates; a higher rate would take computing time from the scans.
LOWEST_RATE, HIGHEST_RATE = 50.0, 1000.0
# Factor by which a measured rate may be outside these bounds, since sampling is not exact.
RATE_SLACK = 1.1
# [s] Longest time between samples that does not count as a gap; duration over which the rate is measured.
LONGEST_GAP, RATE_TIME = 0.1, 1.0
# [s] Silence after which the status shows a warning; time after which a warning is cleared and a silent stream counts
# as ended.
SILENT, FORGOTTEN = 1.0, 10.0
# [s] A pause uses the stream only if the newest batch is at most this old at BEGIN.
FRESH = 0.25


class StreamWatch:
    """Monitor of a joint stream, with status item `stance_stream`. All methods are thread-safe."""

    def __init__(self, robot: RobotModel, name: str) -> None:
        """Monitor the stream of the robot with the instance name `name`."""
        self._robot, self._name = robot, name
        self._lock = threading.Lock()
        self._last: StanceStream | None = None
        self._last_arrival = -np.inf
        self._arrivals: deque[tuple[float, StanceStream]] = deque()
        self._pause: PauseStream | None = None
        self._counts = {"gaps": 0, "lost_batches": 0, "flooded": 0, "refused": 0}
        self._trouble = (-np.inf, "")

    def add(self, batch: StanceStream) -> bool:
        """Add a batch; return False if it is rejected.

        A batch is rejected if it names another robot, if its joints or legs do not fit the robot, or if the sampling
        rate is too high.
        """
        now = clock.now()
        problem = self._problem(batch)
        with self._lock:
            if problem:
                self._counts["refused"] += 1
                self._trouble = now, problem
                return False
            self._last_arrival = now
            self._arrivals.append((now, batch))
            while self._arrivals[0][0] < now - RATE_TIME:
                self._arrivals.popleft()
            if self._rate() > RATE_SLACK * HIGHEST_RATE:
                self._counts["flooded"] += 1
                problem = f"more than {HIGHEST_RATE:g} samples a second: batches are dropped. Sample less often"
                self._trouble = now, problem
                self._arrivals.pop()
                return False
            self._follow(batch, now)
            self._last = batch
            if self._pause is not None:
                self._pause.add(batch)
            return True

    def begin(self, make: Callable[[], PauseStream], epoch: str) -> PauseStream | None:
        """Begin the stream of a new pause with the samples of the last second; return None if the stream is not usable.

        Args:
            make: function that creates the stream without samples, or raises KinematicsError if the pause cannot have a
                stream.
            epoch: walk of the pause.
        """
        with self._lock:
            self._pause = None
            is_slow = self._rate() * RATE_SLACK < LOWEST_RATE
            if (
                self._last is None
                or self._last.epoch not in (ANY_WALK, epoch)
                or is_slow
                or clock.now() - self._last_arrival > FRESH
            ):
                return None
            try:
                self._pause = make()
            except KinematicsError:
                return None
            for _, batch in self._arrivals:
                self._pause.add(batch)
            return self._pause

    def refuse(self, error: TransportError) -> None:
        """Count a batch that cannot be decoded."""
        with self._lock:
            self._counts["refused"] += 1
            self._trouble = clock.now(), str(error)

    def item(self) -> StatusItem:
        """Status item of the stream: rate, counts, and a problem, if any.

        The problem is the newest one of the last FORGOTTEN seconds. Without one, it is that the stream is slow, or has
        been silent for SILENT to FORGOTTEN seconds.
        """
        now = clock.now()
        with self._lock:
            rate = 0.0 if now - self._last_arrival > RATE_TIME else self._rate()
            values = {"rate": f"{rate:.0f}", **{name: str(count) for name, count in self._counts.items()}}
            since, trouble = self._trouble
            silence = now - self._last_arrival
        if now - since > FORGOTTEN:
            trouble = ""
        if not trouble and silence > FORGOTTEN:
            message = "the gait sends no joint stream: the robot must stand still during scans"
            return StatusItem(name="stance_stream", level=Health.OK, message=message, values=values)
        if not trouble and silence > SILENT:
            trouble = f"no sample for {silence:.1f} s"
        elif not trouble and rate * RATE_SLACK < LOWEST_RATE:
            trouble = f"{rate:.0f} samples a second; allowed: {LOWEST_RATE:g} to {HIGHEST_RATE:g}"
        level = Health.WARN if trouble else Health.OK
        return StatusItem(
            name="stance_stream", level=level, message=trouble or f"{rate:.0f} samples a second", values=values
        )

    def _problem(self, batch: StanceStream) -> str:
        """Reason why a batch does not belong to this robot; empty if it does."""
        if batch.robot != self._name:
            return f"a batch of robot {batch.robot!r} arrived on the key of {self._name!r}"
        try:
            for leg in batch.legs:
                self._robot.tree.leg(leg)
            first = np.asarray(batch.joint_positions)[0]
            checked_positions(self._robot.tree, dict(zip(batch.joint_names, first.tolist(), strict=True)))
        except KinematicsError as error:
            return str(error)
        return ""

    def _rate(self) -> float:
        """Sampling rate of the batches in the last `RATE_TIME` [1/s]; 0 for fewer than two batches."""
        if len(self._arrivals) < 2:
            return 0.0
        counts = [len(batch.stamps) for _, batch in self._arrivals]
        # The samples of the first batch do not count: they were taken before its arrival, at which the time starts.
        return sum(counts[1:]) / max(self._arrivals[-1][0] - self._arrivals[0][0], RATE_TIME / 4)

    def _follow(self, batch: StanceStream, now: float) -> None:
        """Count the batches lost before `batch`; count a gap if samples are missing or the stamps do not increase."""
        last = self._last
        if last is None or last.epoch != batch.epoch or batch.sequence <= last.sequence:
            return
        lost, pause = batch.sequence - last.sequence - 1, (batch.stamp - int(last.stamps[-1])) * 1e-9
        longest = max(pause, float(np.diff(np.asarray(batch.times)).max(initial=0.0)))
        self._counts["lost_batches"] += lost
        if longest > LONGEST_GAP or pause <= 0.0 or lost:
            self._counts["gaps"] += 1
            what = (
                f"{lost} batch{'es were' if lost > 1 else ' was'} lost" if lost else f"{longest:.2f} s without a sample"
            )
            if pause <= 0.0:
                what = "the stamps did not increase"
            self._trouble = now, f"joint stream: {what}"
