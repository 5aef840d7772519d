"""Wave gait (order of the legs, landings, first stance), and pose of the body on given footholds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from guara_perception.arrays import Float
from guara_perception.exceptions import InvalidInput
from kinematics import RobotModel

# Step by which the body is lowered until the legs reach all footholds, and largest total lowering.
CROUCH_STEP_M = 0.005
DEEPEST_CROUCH_M = 0.060
# Largest slope of the body relative to the horizontal [-].
LARGEST_TILT = 0.12


@dataclass(frozen=True, slots=True, kw_only=True)
class WaveGait:
    """Wave gait: one leg swings at a time, from rear to front on the right side, then on the left.

    Attributes:
        lift_order: legs in the order in which they swing.
        hips: position (x, y) of each sole in base_link halfway between landing and lift-off [m], by leg.
        cycle_length: advance of the body in one cycle, in which each leg swings once [m].
        hip_height: height of the body's origin above the plane of the soles [m].
    """

    lift_order: tuple[str, ...]
    hips: dict[str, tuple[float, float]]
    cycle_length: float = 0.140
    hip_height: float = 0.360

    @staticmethod
    def of(robot: RobotModel) -> WaveGait:
        """Create the gait of a robot around its scan posture; the order of four legs is RH, RF, LH, LF."""
        # `hips` holds the sole positions of the scan posture, not those of the hip joints, which on most robots are not
        # directly above the soles.
        state = robot.state(robot.posture(robot.config.scan_posture))
        soles = state.soles_in_base()
        hips = {leg: np.round(sole, 6) for leg, sole in zip(robot.legs, soles, strict=True)}
        order = sorted(hips, key=lambda leg: (hips[leg][1] > 0, hips[leg][0]))
        return WaveGait(
            lift_order=tuple(order),
            hips={leg: (float(hip[0]), float(hip[1])) for leg, hip in hips.items()},
            hip_height=round(-float(soles[:, 2].mean()), 6),
        )

    @property
    def advance(self) -> float:
        """Advance of the body between two swings [m]."""
        return self.cycle_length / len(self.lift_order)

    def leg_of_swing(self, number: int) -> str:
        """Leg that swings after pause `number`."""
        return self.lift_order[number % len(self.lift_order)]

    def landing(self, leg: str) -> tuple[float, float]:
        """Landing (x, y) of a foot in base_link after the body's advance: `cycle_length` / 2 ahead of `hips` [m]."""
        x, y = self.hips[leg]
        return x + self.cycle_length / 2, y

    def first_stance(self) -> dict[str, tuple[float, float]]:
        """Positions (x, y) of the feet in base_link at pause 0 [m], by leg, as during a steady walk."""
        stance = {}
        for order, leg in enumerate(self.lift_order):
            x, y = self.hips[leg]
            stance[leg] = (x - self.cycle_length / 2 + (order + 1) * self.advance, y)
        return stance

    def support_polygon(self, margin: float) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
        """Corners (4, 2) of the rectangle around all feet of the first stance, enlarged by a margin [m]."""
        feet = np.array(list(self.first_stance().values()))
        (x0, y0), (x1, y1) = feet.min(axis=0) - margin, feet.max(axis=0) + margin
        return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])


class OutOfReach(InvalidInput):
    """A leg cannot reach its foothold; the message names both."""


def stand_on(
    robot: RobotModel, soles_in_world: Mapping[str, npt.ArrayLike], position: tuple[float, float], height: float
) -> tuple[Float, dict[str, float]]:
    """Compute pose and joint positions of a robot that stands on all feet, heading along x of the world.

    The body is parallel to the plane through the feet, up to the slope LARGEST_TILT; the x axes of the soles are level.
    If a foothold is out of reach, the body is lowered by up to DEEPEST_CROUCH_M.

    Args:
        robot: the robot.
        soles_in_world: sole centre (3,) of every leg [m], by leg.
        position: x and y of the body's origin [m].
        height: distance of the body's origin from the plane of the feet, before any lowering [m].

    Returns:
        transform_base_to_world (4, 4), and joint positions by name [rad].

    Raises:
        OutOfReach: a leg cannot reach its foothold even from the lowest pose of the body.
    """
    soles = {leg: np.asarray(sole, np.float64) for leg, sole in soles_in_world.items()}
    failed = ""
    for crouch in np.arange(0.0, DEEPEST_CROUCH_M + 1e-9, CROUCH_STEP_M):
        transform = body_pose(np.array(list(soles.values())), position, height - float(crouch))
        joints: dict[str, float] = {}
        for leg, sole in soles.items():
            reached = robot.reach_from(leg, sole, transform)
            if not reached.is_reachable:
                failed = leg
                break
            joints.update(zip(robot.tree.leg(leg).joints, reached.joint_positions.tolist(), strict=True))
        else:
            return transform, joints
    raise OutOfReach(
        f"leg {failed!r} cannot reach its foothold {np.round(soles[failed], 3).tolist()} with the body at "
        f"x {position[0]:.3f}, y {position[1]:.3f}, even if it is lowered by {DEEPEST_CROUCH_M} m: choose a foothold "
        "nearer to the hip"
    )


def body_pose(soles: Float, position: tuple[float, float], height: float) -> Float:
    """Pose transform_base_to_world (4, 4) of a body parallel to the plane through soles (n, 3), heading along x.

    The slope is limited to LARGEST_TILT. `height` is the distance of the body's origin from the plane [m].
    """
    centre = soles.mean(axis=0)
    offsets = soles - centre
    slope = np.linalg.lstsq(offsets[:, :2], offsets[:, 2], rcond=None)[0]
    slope *= min(1.0, LARGEST_TILT / max(float(np.linalg.norm(slope)), 1e-9))
    up = np.array([-slope[0], -slope[1], 1.0])
    up /= np.linalg.norm(up)
    # The body's x axis projects onto the x axis of the world, so the heading is zero.
    ahead = np.array([up[2], 0.0, -up[0]]) / np.hypot(up[0], up[2])
    transform = np.eye(4)
    transform[:3, :3] = np.column_stack((ahead, np.cross(up, ahead), up))
    ground = centre[2] + slope @ (np.asarray(position) - centre[:2])
    transform[:3, 3] = position[0], position[1], ground + height / up[2]
    return transform
