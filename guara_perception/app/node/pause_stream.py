"""Stream of the gait's joints during one pause: where the body is at each flash, and until when it is known."""

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

# [s] How long a scan waits for the gait's clock, and for the samples after its last flash beyond their own time.
CLOCK_WAIT, SAMPLE_WAIT = 0.5, 0.5


class PauseStream:
    """Samples of one pause; they are added on the receiver's thread and used on that of the scans.

    Attributes:
        begin: stamp of BEGIN, from which the times of the track count [ns].
        track: places of the body relative to BEGIN.
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
            kinematics.KinematicsError: fewer than three feet carry the body.
        """
        self.begin = begin
        self.track = BodyTrack(robot, stance, transform_camera_to_base=transform_camera_to_base)
        self._robot, self._epoch, self._clock = robot, epoch, gait_clock
        self._added = threading.Condition()
        self._heard = self._last_flash = -math.inf

    def add(self, batch: StanceStream) -> None:
        """Add a batch; one of another walk is none of this pause, and `ANY_WALK` is this one."""
        if batch.epoch not in (ANY_WALK, self._epoch):
            return
        with self._added:
            add_samples(self.track, self._robot, batch, self.begin)
            self._heard = clock.now()
            self._added.notify_all()

    @property
    def shown(self) -> tuple[int, float]:
        """Stamp up to which the samples show where the body is [ns], and arrival of the last of them."""
        latest = self.track.latest
        if not math.isfinite(latest):
            return self.begin, -math.inf
        return self.begin + round(1e9 * (latest - HALF_WINDOW)), self._heard

    def doubt(self, flash: tuple[float, float] | None) -> str:
        """Reason why flashes cannot be placed; waits for the gait's clock, for a short time.

        Args:
            flash: a time by `transport.clock` and its standard deviation as for all flashes [s]; None if these are not
                known.
        """
        if flash is None:
            return "the camera's lag is not known: `guara record` measures it for devices.toml"
        if self._clock.at(clock.now()) is None:
            self._clock.wait(CLOCK_WAIT)
        if self._clock.at(clock.now()) is None:
            return "the gait does not tell its clock"
        sigma = self.instant(*flash)[1]
        if sigma > MOST_TIME_SIGMA:
            return (
                f"the instants of flashes are known to {1e3 * sigma:.0f} ms, allowed: {1e3 * MOST_TIME_SIGMA:.0f} ms: "
                "set the exposure in devices.toml, or mend the link to the gait"
            )
        return ""

    def instant(self, time: float, sigma: float) -> tuple[float, float]:
        """Time of a flash since BEGIN by the gait's clock, and its standard deviation, in whole nanoseconds [s].

        Args:
            time: by `transport.clock` [s].
            sigma: its standard deviation [s].
        """
        read = self._clock.at(time)
        if read is None:
            return math.nan, 0.0
        # The bound is a rectangle's half.
        sigma = math.hypot(sigma, read[1] / math.sqrt(3.0))
        self._last_flash = max(self._last_flash, time)
        return (round(1e9 * read[0]) - self.begin) * 1e-9, math.ceil(1e9 * sigma) * 1e-9

    def record(self, flash: tuple[float, float] | None) -> FlashRecord | None:
        """Record of what `instant` returned; None for None."""
        if flash is None:
            return None
        return FlashRecord(self.begin, self.begin + round(1e9 * flash[0]), round(1e9 * flash[1]))

    def wait(self, is_enough: Callable[[], bool]) -> None:
        """Wait until there are enough samples, no longer than those about the last flash may take."""
        ahead = max(self._last_flash - clock.now(), 0.0)
        with self._added:
            self._added.wait_for(is_enough, ahead + HALF_WINDOW + SAMPLE_WAIT)
