"""Assignment of announcements to walks, and rejection of announcements that are late or for another robot."""

from __future__ import annotations

from guara_perception.app.node.pause import Pause
from transport import PausePhase, StancePause

# Number of ended walks whose late announcements are still rejected.
REMEMBERED = 64


class Walks:
    """Register of walks: rejects late or misdirected announcements, and names the walks of a gait without epochs."""

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
