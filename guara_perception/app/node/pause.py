"""The stance pause that the gait is in, as the node follows it."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field

from kinematics import Stance
from transport import GroundPatch, StancePause


@dataclass
class Pause:
    """One pause, begun and perhaps ended.

    Attributes:
        step: number of the pause.
        stance: at its beginning.
        known_ground: what the gait declares, in base_footprint of this pause.
        time_available: from its beginning to its planned end [s]; 0 when not known.
        ended: set when the gait moves on.
        end_stance: read again at the end, None until then and when it could not be used.
    """

    step: int
    stance: Stance
    known_ground: tuple[GroundPatch, ...] = ()
    time_available: float = 0.0
    ended: threading.Event = field(default_factory=threading.Event)
    end_stance: Stance | None = None

    def end(self, stance: Stance | None) -> None:
        """The gait moves on; without a stance it is not known whether the robot stood still until now."""
        self.end_stance = stance
        self.ended.set()


def stance_of(announcement: StancePause) -> Stance:
    """The stance that an announcement carries.

    Raises:
        kinematics.StanceError: it is not a stance of this robot.
    """
    stance = announcement.stance
    return Stance(stance.joint_positions, stance.support_feet, stance.gravity_in_base)
