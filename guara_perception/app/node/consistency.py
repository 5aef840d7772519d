"""Consistency checks of joint readings and foot contacts at each stance pause, reported in the status."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection

import numpy as np

from guara_perception.app.node.node_status import NodeStatus
from guara_perception.app.node.pause import Pause
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.layers.geometry import inside_polygon
from guara_perception.terrain.layers.record import MapRecord
from kinematics import JointCheck, JointReport, RobotModel, StanceError
from kinematics.transforms import transform_points
from transport import Health

# Largest number of landings in the statistics, and smallest number for a warning (two cycles).
MOST_LANDINGS, FEWEST_LANDINGS = 40, 8


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
            self._note(pause)
        return self._doubts

    def _known_heights(self, pause: Pause) -> dict[str, tuple[float, float]]:
        """Leg -> height of the declared ground below its sole and its standard deviation [m]."""
        heights = dict[str, tuple[float, float]]()
        if not pause.known_ground:
            return heights
        try:
            pose, feet = self._robot.stance_pose(pause.stance), pause.stance.support_feet
        except StanceError:
            # With two support feet and no IMU, the pose is known from odometry alone.
            return heights
        soles = transform_points(pose.transform_base_to_footprint, pose.state.soles_in_base(feet))
        for ground in pause.known_ground:
            for leg, is_on in zip(feet, inside_polygon(ground.outline, soles[:, 0], soles[:, 1]), strict=True):
                if is_on:
                    heights[leg] = ground.height, ground.sigma
        return heights

    def _note(self, pause: Pause) -> None:
        faults, residual = self._report.faults, self._report.residual
        self._doubts = tuple(str(fault) for fault in faults)
        message = "; ".join(self._doubts)
        values = {"step": str(pause.step), "residual": f"{residual:.2f}"}
        if faults:
            values["joints"] = ", ".join(name for fault in faults for name in fault.joints)
        elif math.isnan(residual):
            message = "not checked: first pause, or fewer than three feet stayed on the ground since the last one"
        else:
            message = "the joint readings of the standing legs agree with those of the last pause"
        self._status.note("joints", message, Health.WARN if faults else Health.OK, values)


class ContactWatch:
    """Monitor of landings and of ground that gives way, with two status items.

    `contact` has bias and sigma of the latest landings, and the worst landing of the last pause with landings. `ground`
    reports feet that sank or slid.
    """

    def __init__(self, status: NodeStatus) -> None:
        """Start without landings; `status` gets the items."""
        self._status = status
        self._heights: deque[float] = deque(maxlen=MOST_LANDINGS)

    def add(self, fused: TerrainGrid, stayed: Collection[str]) -> None:
        """Add the feet that landed since the last pause, and update the status items.

        Args:
            fused: map of the pause.
            stayed: feet that did not swing since the last pause.
        """
        record = fused.record
        assert isinstance(record, MapRecord)
        sunk, slid = record.sunk_feet or {}, record.slid_feet or {}
        told = [f"gave way under {leg} by {1e3 * depth:.0f} mm" for leg, depth in sunk.items()]
        told += [f"is slippery: {leg} slid by {1e3 * way:.0f} mm" for leg, way in slid.items()]
        self._status.note("ground", f"step {fused.step}: the ground {' and '.join(told)}" if told else "")
        residuals = record.support_residuals or {}
        landed = {leg: height for leg, height in residuals.items() if height is not None and leg not in stayed}
        self._heights.extend(landed.values())
        if not landed:
            return
        worst = max(landed, key=lambda leg: abs(landed[leg]))
        bias, sigma, count = float(np.mean(self._heights)), float(np.std(self._heights)), len(self._heights)
        values = {
            "landings": str(count),
            "bias_mm": f"{1e3 * bias:.1f}",
            "sigma_mm": f"{1e3 * sigma:.1f}",
            "last_worst_mm": f"{1e3 * landed[worst]:.1f}",
            "last_worst_leg": worst,
        }
        limit = record.required_limits.sigma
        text, level = f"feet land {1e3 * bias:+.1f} mm off the map, sigma {1e3 * sigma:.1f} mm", Health.OK
        # Without a fault, the mean is within the limit plus two standard errors of the mean.
        if count >= FEWEST_LANDINGS and abs(bias) > limit + 2 * sigma / np.sqrt(count):
            level = Health.WARN
            text += (
                f"; allowed: {1e3 * limit:.0f} mm. The calibration, the joint zeros or the sole size is wrong, or the "
                "ground gives way everywhere"
            )
        self._status.note("contact", text, level, values)
