"""The stance pause that the gait is in, as the node follows it: until when the robot is known to have stood still."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from guara_perception.app.messages import message_to_stance
from guara_perception.terrain.map.known_ground import KnownGround
from kinematics import KinematicsError, RobotModel, Stance, StanceError
from kinematics.joint_positions import checked_positions
from transport import StancePause

# A position this far beyond a joint's limits was not measured: encoders are offset by a few degrees, not by thirty.
BEYOND_LIMITS_RAD = 0.5
# Largest position of a joint without limits: sixteen turns.
LARGEST_POSITION_RAD = 100.0

# Raises KinematicsError when the camera was elsewhere at the second stance, or when this is not known.
StillCheck = Callable[[Stance, Stance], None]

UNKNOWN_END = (
    "the pause ended without a stance that can be used: whether the camera stood still during the scan is "
    "not known. The gait must send joints and support feet with END, all finite"
)


@dataclass
class Pause:
    """One pause, begun and perhaps ended. Times are of the clock that `now` comes from [s].

    A scan whose last frame came no later than `still_until` is confirmed: the robot stood as BEGIN said.

    Attributes:
        step: number of the pause.
        epoch: identity of its walk.
        given_epoch: identity of the walk as the gait gave it, empty when it gave none.
        stance: stance at its beginning.
        check: compares a stance with that at the beginning.
        begun: instant at which BEGIN came.
        limit: time after BEGIN at which a pause ends if the gait announces nothing more [s].
        known_ground: what the gait declares, in base_footprint of this pause.
        time_available: time from its beginning to its planned end [s]; 0 when not known.
        stamp: stamp of BEGIN, by the gait's clock [ns].
        ended: set when the gait moves on, the robot moved, or it is not known whether it stands.
        end_stance: stance read again at the end, None until then and when it could not be used.
        still_until: instant until which the robot is known to have stood as BEGIN said; infinite when END said so.
        broken: why the robot is not known to have stood still to the end; empty otherwise.
        moved: whether the robot moved, or cannot be shown to have stood still.
        is_fused: whether its scan is in the map for good.
    """

    step: int
    epoch: str
    stance: Stance
    check: StillCheck
    begun: float
    limit: float
    given_epoch: str = ""
    known_ground: tuple[KnownGround, ...] = ()
    time_available: float = 0.0
    stamp: int = 0
    ended: threading.Event = field(default_factory=threading.Event)
    end_stance: Stance | None = None
    still_until: float = -math.inf
    broken: str = ""
    moved: bool = False
    is_fused: bool = False

    def __post_init__(self) -> None:
        """Plan its end."""
        self.deadline = self.begun + (self.time_available or self.limit)

    def differs(self, stance: Stance) -> str:
        """Why a stance is not that of BEGIN, or cannot be compared with it; empty when it is the same."""
        try:
            self.check(self.stance, stance)
        except KinematicsError as error:
            return str(error)
        return ""

    def hold(self, stance: Stance | None, now: float, stamp: int, time_available: float) -> None:
        """The gait says that the robot still stands.

        Args:
            stance: stance now, None when it cannot be used.
            now: instant at which this came.
            stamp: stamp of the joints, by the gait's clock [ns].
            time_available: time from now to the planned end [s]; 0 when not known.
        """
        if stance is None:
            self.end(None)
            return
        difference = self.differs(stance)
        if difference:
            self._break(difference, moved=True)
            return
        # Joints that were read before the last frame say nothing of it, however late they arrive.
        read_at = self.begun + (stamp - self.stamp) * 1e-9
        self.still_until = max(self.still_until, min(now, read_at))
        if time_available > 0:
            self.deadline = now + time_available
        elif self.time_available == 0:
            self.deadline = now + self.limit

    def end(self, stance: Stance | None) -> None:
        """The gait moves on; without a stance it is not known whether the robot stood still until now."""
        if stance is None:
            self._break(UNKNOWN_END)
            return
        self.end_stance = stance
        difference = self.differs(stance)
        if difference:
            self._break(difference, moved=True)
            return
        self.still_until = math.inf
        self.ended.set()

    def begin_again(self, stance: Stance) -> bool:
        """A second BEGIN of this pause: True when it repeats the first; else this pause is over."""
        difference = self.differs(stance)
        if difference:
            self._break(f"a second BEGIN of step {self.step} came with other joints: {difference}", moved=True)
        return not difference

    def expire(self, now: float) -> None:
        """End it when its time is over."""
        if not self.ended.is_set() and now > self.deadline:
            self._break(f"the pause had no END within its time of {self.deadline - self.begun:.3g} s")

    def time_left(self, now: float) -> float:
        """Time until it ends by itself [s], 0 or more."""
        return max(self.deadline - now, 0.0)

    def _break(self, reason: str, *, moved: bool = False) -> None:
        self.broken, self.moved = reason, moved
        self.ended.set()


def stance_of(announcement: StancePause, robot: RobotModel) -> Stance:
    """The stance that an announcement carries.

    Raises:
        kinematics.KinematicsError: it is not a stance of this robot, or a joint is where no joint can be.
    """
    stance = message_to_stance(announcement.stance)
    for foot in stance.support_feet:
        robot.tree.leg(foot)
    _check_plausible(robot, stance.joint_positions)
    return stance


def _check_plausible(robot: RobotModel, joint_positions: Mapping[str, float]) -> None:
    positions, tree = checked_positions(robot.tree, joint_positions), robot.tree
    lower = np.maximum(tree.lower_limits - BEYOND_LIMITS_RAD, -LARGEST_POSITION_RAD)
    upper = np.minimum(tree.upper_limits + BEYOND_LIMITS_RAD, LARGEST_POSITION_RAD)
    impossible = np.flatnonzero((positions < lower) | (positions > upper))
    if impossible.size:
        first = impossible[0]
        raise StanceError(
            f"{impossible.size} joints are where none can be, {tree.joint_names[first]} at {positions[first]:g} rad; "
            f"allowed are {lower[first]:.3g} ... {upper[first]:.3g} rad"
        )
