"""Joint stream of one pause: body poses, the time up to which they are known, and flash times on the gait's clock."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable

import numpy.typing as npt

from guara_perception.app.messages import add_samples
from kinematics import BodyTrack, RobotModel, Stance
from kinematics.body_track import HALF_WINDOW, MOST_TIME_SIGMA
from transport import StanceStream, clock
from transport.messages.stance_stream import ANY_WALK
from transport.recording import FlashRecord
from transport.stance_link import GaitClock

# [s] Longest waits: for the gait's clock, and for joint samples after they are due.
CLOCK_WAIT, SAMPLE_WAIT = 0.5, 0.5


class PauseStream:
    """Joint samples of one pause, added on the receiver's thread and used on the scan thread.

    Attributes:
        begin: stamp of BEGIN, the zero of the track's times [ns].
        track: poses of the body relative to BEGIN.
    """

    def __init__(
        self,
        robot: RobotModel,
        stance: Stance,
        begin: int,
        gait_clock: GaitClock,
        *,
        epoch: str = "",
        transform_camera_to_base: npt.ArrayLike | None = None,
    ) -> None:
        """Start without samples.

        Raises:
            kinematics.KinematicsError: as in `BodyTrack`.
        """
        self.begin = begin
        self.track = BodyTrack(robot, stance, transform_camera_to_base=transform_camera_to_base)
        self._robot, self._epoch, self._clock = robot, epoch, gait_clock
        self._added = threading.Condition()
        self._last_arrival = self._last_flash = -math.inf

    def add(self, batch: StanceStream) -> None:
        """Add a batch of samples of this walk or of `ANY_WALK`; a batch of another walk is ignored.

        Raises:
            kinematics.KinematicsError: as in `add_samples`.
        """
        if batch.epoch not in (ANY_WALK, self._epoch):
            return
        with self._added:
            add_samples(self.track, self._robot, batch, self.begin)
            self._last_arrival = clock.now()
            self._added.notify_all()

    @property
    def shown(self) -> tuple[int, float]:
        """Stamp up to which the samples give the body's pose [ns], and arrival of the last batch [s].

        The arrival is on `transport.clock`. Without samples, these are `begin` and -inf.
        """
        latest = self.track.latest
        if not math.isfinite(latest):
            return self.begin, -math.inf
        return self.begin + round(1e9 * (latest - HALF_WINDOW)), self._last_arrival

    def doubt(self, flash: tuple[float, float] | None) -> str:
        """Reason why flash times on the gait's clock are unknown or too uncertain; empty if they can be used.

        Waits up to CLOCK_WAIT for the gait's clock.

        Args:
            flash: current time on `transport.clock`, and standard deviation of flash times [s]; None if that standard
                deviation is unknown.
        """
        if flash is None:
            return "the camera's lag is not known: `guara record` measures it for devices.toml"
        if self._clock.at(clock.now()) is None:
            self._clock.wait(CLOCK_WAIT)
        if self._clock.at(clock.now()) is None:
            return "the gait does not report its clock"
        sigma = self.instant(*flash)[1]
        if sigma > MOST_TIME_SIGMA:
            return (
                f"the sigma of flash times is {1e3 * sigma:.0f} ms; allowed: up to {1e3 * MOST_TIME_SIGMA:.0f} ms. Set "
                "the exposure in devices.toml, or use a faster link to the gait"
            )
        return ""

    def instant(self, time: float, sigma: float) -> tuple[float, float]:
        """Time of a flash since BEGIN on the gait's clock, and its sigma [s]; NaN and 0 if that clock is not known.

        Both are rounded to nanoseconds, the sigma upwards.

        Args:
            time: time of the flash on `transport.clock` [s].
            sigma: standard deviation of `time` [s].
        """
        read = self._clock.at(time)
        if read is None:
            return math.nan, 0.0
        # The error of the clock is assumed to be uniformly distributed within its bound.
        sigma = math.hypot(sigma, read[1] / math.sqrt(3.0))
        self._last_flash = max(self._last_flash, time)
        return (round(1e9 * read[0]) - self.begin) * 1e-9, math.ceil(1e9 * sigma) * 1e-9

    def record(self, flash: tuple[float, float] | None) -> FlashRecord | None:
        """Convert a result of `instant` to the record of a flash; None stays None."""
        if flash is None:
            return None
        return FlashRecord(self.begin, self.begin + round(1e9 * flash[0]), round(1e9 * flash[1]))

    def wait(self, is_enough: Callable[[], bool]) -> None:
        """Wait until `is_enough` returns True, which is tested at once and whenever samples arrive.

        It waits at most until HALF_WINDOW + SAMPLE_WAIT after the last flash or this call, whichever is later.
        """
        ahead = max(self._last_flash - clock.now(), 0.0)
        with self._added:
            self._added.wait_for(is_enough, ahead + HALF_WINDOW + SAMPLE_WAIT)
