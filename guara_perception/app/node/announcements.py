"""Checks of the gait's announcements: plausible stance, declared ground, and order within and between walks."""

from __future__ import annotations

import numpy as np

from guara_perception.app.messages import message_to_stance
from guara_perception.app.node.pause import Pause
from guara_perception.exceptions import InvalidInput
from guara_perception.settings import Settings
from guara_perception.terrain.map.known_ground import KnownGround
from kinematics import RobotModel, Stance, StanceError
from kinematics.tree import checked_positions
from transport import PausePhase, StancePause

# Largest plausible excess of a position over a joint's limits; encoder offsets are only a few degrees.
BEYOND_LIMITS_RAD = 0.5
# Largest plausible position of any joint: sixteen turns.
LARGEST_POSITION_RAD = 100.0
# Frame of declared ground.
FRAME = "base_footprint"
# Largest number of patches of declared ground (four for each of four feet), and of corners of a patch.
MAXIMUM_PATCHES, MAXIMUM_CORNERS = 16, 16
# [m] Largest absolute coordinate of a corner, far beyond any stride; ground outside the map is clipped.
FURTHEST = 20.0
# [m] Largest sigma of declared ground.
LARGEST_SIGMA = 0.1
# Number of ended walks whose late announcements are still rejected.
REMEMBERED = 64


def stance_of(announcement: StancePause, robot: RobotModel) -> Stance:
    """Convert an announcement to the stance of the robot.

    Raises:
        kinematics.KinematicsError: the stance is not one of this robot, or a joint is at an impossible position.
    """
    stance = message_to_stance(announcement.stance)
    for foot in stance.support_feet:
        robot.tree.leg(foot)
    positions, tree = checked_positions(robot.tree, stance.joint_positions), robot.tree
    lower = np.maximum(tree.lower_limits - BEYOND_LIMITS_RAD, -LARGEST_POSITION_RAD)
    upper = np.minimum(tree.upper_limits + BEYOND_LIMITS_RAD, LARGEST_POSITION_RAD)
    impossible = np.flatnonzero((positions < lower) | (positions > upper))
    if impossible.size:
        first = impossible[0]
        raise StanceError(
            f"joints at impossible positions: {impossible.size}, such as {tree.joint_names[first]} at "
            f"{positions[first]:g} rad; allowed: {lower[first]:.3g} ... {upper[first]:.3g} rad"
        )
    return stance


def declared_ground(announcement: StancePause, settings: Settings) -> tuple[KnownGround, ...]:
    """Convert the declared ground of an announcement to known ground for the map.

    Raises:
        InvalidInput: the patches are in another frame or too many, or a patch has too many corners, is too far away, is
            outside the height limits, or has too large a sigma. If one patch is invalid, none is used.
    """
    patches = announcement.known_ground
    if not patches:
        return ()
    if announcement.frame_id != FRAME:
        raise InvalidInput(
            f"known ground is declared in frame {announcement.frame_id!r}; allowed: {FRAME!r}. It is not used"
        )
    if len(patches) > MAXIMUM_PATCHES:
        raise InvalidInput(
            f"known ground has {len(patches)} patches; allowed: up to {MAXIMUM_PATCHES}. None of them is used"
        )
    for patch in patches:
        for name, value, low, high in (
            ("number of corners", len(patch.outline), 3, MAXIMUM_CORNERS),
            ("height [m]", patch.height, settings.minimum_height, settings.maximum_height),
            ("sigma [m]", patch.sigma, 0.0, LARGEST_SIGMA),
            ("largest absolute coordinate [m]", float(np.abs(patch.outline).max()), 0.0, FURTHEST),
        ):
            if not low <= value <= high:
                raise InvalidInput(
                    f"a patch of known ground: its {name} is {value:g}; allowed: {low:g} to {high:g}. No patch is used"
                )
    return tuple(KnownGround(patch.outline, patch.height, patch.sigma) for patch in patches)


class Walks:
    """Register of walks: rejects late or misdirected announcements, and assigns the epochs that a gait leaves out."""

    def __init__(self, robot: str, run: str) -> None:
        """Create the register before the first walk.

        Args:
            robot: instance name of the robot.
            run: identity of this run of the node.
        """
        self._robot, self._run = robot, run
        self._count = 0
        self._past: list[str] = []

    def refusal(self, announcement: StancePause, last: Pause | None) -> str:
        """Reason to reject an announcement, empty to accept it; `last` is the newest pause."""
        if announcement.robot != self._robot:
            return f"the announcement is for robot {announcement.robot!r}; this node is {self._robot!r}"
        epoch = announcement.epoch
        if epoch and last is not None and epoch == last.given_epoch and announcement.step < last.step:
            return f"the announcement comes late: step {last.step} of walk {epoch!r} has begun"
        is_again = last is not None and (announcement.step, epoch) == (last.step, last.given_epoch)
        if is_again and announcement.phase is PausePhase.BEGIN and last is not None and last.ended.is_set():
            if announcement.stamp <= last.newest_stamp:
                return f"the BEGIN comes late: step {last.step} is over"
        if epoch and epoch in self._past:
            return f"the announcement belongs to walk {epoch!r}, which is over"
        return ""

    def epoch_of(self, announcement: StancePause, last: Pause | None) -> str:
        """Identity of the walk of a new pause. If the epoch has changed, mark the previous walk as ended.

        If the gait gives no epoch, a walk begins with the first pause, at a lower step, and after a walk with an epoch.
        """
        if last is not None and last.given_epoch and last.given_epoch != announcement.epoch:
            self._past = [*self._past[1 - REMEMBERED :], last.given_epoch]
        if announcement.epoch:
            return announcement.epoch
        if last is None or last.given_epoch or announcement.step < last.step:
            self._count += 1
        return f"{self._run}-{self._count}"
