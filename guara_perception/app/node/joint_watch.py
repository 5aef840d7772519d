"""Consistency check of the joint readings at each stance pause, reported in the status and in the health of grids."""

from __future__ import annotations

import math

from guara_perception.app.node.node_status import NodeStatus
from guara_perception.app.node.pause import Pause
from kinematics import JointCheck, JointReport, RobotModel
from transport import Health, StatusItem


class JointWatch:
    """Check of the joint readings, with status item `joints`; not thread-safe."""

    def __init__(self, robot: RobotModel, status: NodeStatus) -> None:
        self._check, self._status = JointCheck(robot), status
        self._last: Pause | None = None
        self._report, self._doubts = JointReport(math.nan), tuple[str, ...]()

    def doubts(self, pause: Pause) -> tuple[str, ...]:
        """Faults of the joint readings of a pause, one text each. A pause is tested once, even if it is scanned again.

        Raises:
            kinematics.KinematicsError: the stance does not fit the robot.
        """
        last = self._last
        if pause is not last:
            if last is not None and (pause.epoch != last.epoch or pause.step <= last.step):
                self._check.reset()
            self._report, self._last = self._check.update(pause.stance), pause
            self._tell(pause)
        return self._doubts

    def _tell(self, pause: Pause) -> None:
        faults, residual = self._report.faults, self._report.residual
        self._doubts = tuple(str(fault) for fault in faults)
        message = "; ".join(self._doubts)
        values = {"step": str(pause.step), "residual": f"{residual:.2f}"}
        if faults:
            values["joints"] = ", ".join(name for fault in faults for name in fault.joints)
        elif math.isnan(residual):
            message = "not checked: first pause, or fewer than three feet stayed on the ground since the last one"
        else:
            message = "the joints of standing legs fit those of the last pause"
        level = Health.WARN if faults else Health.OK
        self._status.set(StatusItem(name="joints", level=level, message=message, values=values))
