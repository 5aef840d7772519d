"""Consistency check of the joint readings at each stance pause, reported in the status and in the health of grids."""

from __future__ import annotations

import math

from guara_perception.app.node.node_status import NodeStatus
from guara_perception.app.node.pause import Pause
from guara_perception.terrain.layers.geometry import inside_polygon
from kinematics import JointCheck, JointReport, RobotModel, StanceError
from kinematics.transforms import transform_points
from transport import Health


class JointWatch:
    """Check of the joint readings, with status item `joints`; not thread-safe."""

    def __init__(self, robot: RobotModel, status: NodeStatus) -> None:
        self._robot, self._check, self._status = robot, JointCheck(robot), status
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
            self._report, self._last = self._check.update(pause.stance, self._known_heights(pause)), pause
            self._tell(pause)
        return self._doubts

    def _known_heights(self, pause: Pause) -> dict[str, tuple[float, float]]:
        """Leg -> height of the declared ground below its sole and its standard deviation [m]."""
        heights = dict[str, tuple[float, float]]()
        if not pause.known_ground:
            return heights
        try:
            pose, feet = self._robot.stance_pose(pause.stance), pause.stance.support_feet
        except StanceError:
            # Of two feet without an IMU, the pose is known by odometry alone.
            return heights
        soles = transform_points(pose.transform_base_to_footprint, pose.state.soles_in_base(feet))
        for ground in pause.known_ground:
            for leg, is_on in zip(feet, inside_polygon(ground.outline, soles[:, 0], soles[:, 1]), strict=True):
                if is_on:
                    heights[leg] = ground.height, ground.sigma
        return heights

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
        self._status.note("joints", message, Health.WARN if faults else Health.OK, values)
