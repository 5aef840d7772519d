"""Stance pause tracked by the node, and the instant until which the robot is known to have stood still."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from guara_perception.app.node.pause_stream import PauseStream
from guara_perception.terrain.map.known_ground import KnownGround
from kinematics import KinematicsError, Stance, Stillness
from kinematics.robot_settings import PauseLimits

# Upper bound of an announced length [s]; a longer length is clipped. HOLD renews the announcement much earlier.
LONGEST_S = 3600.0
# Largest time by which rounding can put a stamp ahead of its arrival [s]; a larger time means another clock.
AHEAD_S = 0.005

UNKNOWN_END = (
    "the pause ended without a usable stance: it is not known whether the camera stood still during the scan. "
    "The gait must send finite joint positions and the support feet with END"
)


@dataclass
class Pause:
    """Stance pause since its BEGIN. Instants are on `transport.clock` [s], stamps on the gait's clock [ns].

    A frame is confirmed by joints that were read after it and show that the robot stood as at BEGIN: the frame is then
    no later than `still_until`. The stamp of a message counts, not its arrival. A stamp is converted to the earliest
    instant at which the gait's clock can have shown it, but never to an instant after its arrival.

    With a stream the body may move: joint samples give the body's pose at each frame, and confirm the frame.

    Attributes:
        step: number of the pause.
        epoch: identity of its walk.
        stance: stance at its beginning.
        stillness: stillness test of all readings; the reading of BEGIN has time 0.
        earliest: function that returns the earliest instant at which the gait's clock can have shown a stamp, or None
            while that clock is not known.
        limits: time limits of pauses, from robot.toml.
        begun: arrival of BEGIN.
        stamp: stamp of BEGIN.
        given_epoch: identity of the walk given by the gait; empty if none.
        known_ground: ground declared by the gait, in base_footprint of this pause.
        standing_pauses: by leg, number of previous pauses through which the foot has stayed on the ground, as the gait
            reports.
        time_available: time from the stamp of BEGIN to the planned end [s]; 0 when not known.
        stream: joint samples during this pause; None if the robot must stand still.
        ended: set when the gait moves on, the robot has moved, or the robot is no longer known to stand still.
        end_stance: stance of END; None before END, and if that stance was unusable or showed motion without a stream.
        newest_stamp: latest stamp of this pause's announcements.
        broken: reason why the robot is not known to have stood still to the end; empty otherwise.
        moved: True if the pause was ended by a reading that shows motion or could not be tested; False if readings are
            merely missing.
    """

    step: int
    epoch: str
    stance: Stance
    stillness: Stillness
    earliest: Callable[[int], float | None]
    limits: PauseLimits
    begun: float
    stamp: int
    given_epoch: str = ""
    known_ground: tuple[KnownGround, ...] = ()
    standing_pauses: Mapping[str, int] = field(default_factory=dict)
    time_available: float = 0.0
    stream: PauseStream | None = None
    ended: threading.Event = field(default_factory=threading.Event)
    end_stance: Stance | None = None
    newest_stamp: int = 0
    broken: str = ""
    moved: bool = False

    def __post_init__(self) -> None:
        """Plan the end of the pause."""
        self.time_available = _sound(self.time_available)
        self.newest_stamp = self.stamp
        # Stamp up to which the readings show stillness, and arrival of the message with that stamp.
        self._still = (self.stamp, self.begun)
        self._motion = ""
        # Stamp and arrival of the newest announcement of the pause's length, and that length [s].
        self._plan = (self.stamp, self.begun, self.time_available)

    @property
    def still_until(self) -> float:
        """Instant until which the robot is known to have stood as at BEGIN.

        With a stream, this is the instant until which the pose of the body is known. The value is -inf while the
        gait's clock is not known or the stamp is in the future.
        """
        stream = self.stream
        stamp, arrival = self._still if stream is None else stream.shown
        earliest = self.earliest(stamp)
        return -math.inf if earliest is None or earliest > arrival + AHEAD_S else min(earliest, arrival)

    @property
    def is_clock_known(self) -> bool:
        """True if the gait's clock is known and fits the pause.

        It does not fit if a stamp is in the future, for instance after the clock was changed.
        """
        instants = [(self.earliest(stamp), arrival) for stamp, arrival in ((self.stamp, self.begun), self._still)]
        return all(earliest is not None and earliest <= arrival + AHEAD_S for earliest, arrival in instants)

    @property
    def planned_end(self) -> float:
        """Instant at which the gait is expected to move on; no frame is taken after it.

        If no length was announced, this is `time_limit` after the arrival of BEGIN or of the last HOLD.
        """
        stamp, arrival, length = self._plan
        if not length:
            return arrival + self.limits.time_limit
        earliest = self.earliest(stamp)
        return length + (arrival if earliest is None else min(earliest, arrival))

    @property
    def deadline(self) -> float:
        """Instant by which END must have arrived."""
        return self.planned_end + self.limits.grace(self._plan[2] or self.limits.time_limit)

    def hold(self, stance: Stance | None, now: float, stamp: int, time_available: float = 0.0) -> None:
        """Handle HOLD, which reports that the robot still stands and may extend the pause.

        Args:
            stance: stance at the stamp; None if unusable, which ends the pause.
            now: arrival of the message.
            stamp: stamp of the joints.
            time_available: time from the stamp to the planned end [s]; 0 when not known.
        """
        if stance is None:
            self.end(None)
        elif self._add(stance, now, stamp):
            length = _sound(time_available)
            if length and stamp >= self._plan[0]:
                self._plan = (stamp, now, length)
            elif not self._plan[2]:
                self._plan = (stamp, now, 0.0)

    def end(self, stance: Stance | None, now: float = 0.0, stamp: int = 0) -> None:
        """Handle END. If `stance` is None, the robot is not known to have stood still to the end."""
        if stance is None:
            self._break(UNKNOWN_END)
        elif self._add(stance, now, stamp):
            self.end_stance = stance
            self.ended.set()

    def begin_again(self, stance: Stance, now: float, stamp: int) -> bool:
        """Handle a second BEGIN; if `_add` rejects its stance, end the pause and return False."""
        if self._add(stance, now, stamp):
            return True
        self.broken = f"a second BEGIN of step {self.step} had other joint positions: {self.broken}"
        return False

    def leave_stream(self) -> None:
        """Ignore the stream from now on: the readings must show that the robot stood still, or the pause ends."""
        # The stream is cleared first, because `_add` runs on another thread: a motion is then handled there or here.
        self.stream = None
        if self._motion:
            self._break(self._motion, moved=True)

    def add_late(self, stance: Stance | None, now: float, stamp: int) -> None:
        """Handle joints that arrive after END: test those read before END; later ones belong to the next swing."""
        if stance is not None and not self.broken and stamp < self.newest_stamp:
            self._add(stance, now, stamp)

    def expire(self, now: float) -> None:
        """End the pause if its deadline has passed."""
        if not self.ended.is_set() and now > self.deadline:
            length = self.planned_end - self.begun
            if self._plan[0] == self.stamp:
                length = self.time_available or self.limits.time_limit
            grace = self.deadline - self.planned_end
            self._break(f"no END arrived within the {length:.3g} s of the pause and {grace:.3g} s of grace")

    def time_left(self, now: float) -> float:
        """Time until the planned end [s], 0 or more."""
        return max(self.planned_end - now, 0.0)

    def _add(self, stance: Stance, now: float, stamp: int) -> bool:
        """Test a reading. Without a stream, end the pause and return False if it shows motion or cannot be tested."""
        is_late = stamp < self.newest_stamp
        self.newest_stamp = max(self.newest_stamp, stamp)
        try:
            self.stillness.add((stamp - self.stamp) * 1e-9, stance)
            motion = self.stillness.motion
        except KinematicsError as error:
            motion = str(error)
        if math.isfinite(self.stillness.still_until):
            still = self.stamp + round(self.stillness.still_until * 1e9)
            self._still = (still, now if still > self._still[0] else self._still[1])
        if motion:
            if is_late:
                # Readings are tested in order of arrival, so a late reading does not show when the motion began.
                self._still = (self.stamp, self.begun)
            self._motion = self._motion or motion
            if self.stream is not None:
                return True
            self._break(motion, moved=True)
        return not motion

    def _break(self, reason: str, *, moved: bool = False) -> None:
        self.broken, self.moved = reason, moved
        self.ended.set()


def _sound(time_available: float) -> float:
    """Length of a pause [s], at most LONGEST_S; 0 (not known) for an impossible length."""
    return min(time_available, LONGEST_S) if 0.0 < time_available < math.inf else 0.0
