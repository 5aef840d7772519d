"""Models of a robot's knowledge of the ground ahead: complete, none, or from a depth camera."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from scipy import ndimage

from guara_perception.arrays import Float, Mask
from guara_perception.simulation.footing import CELL_M, Footing, around, widened
from kinematics import RobotModel
from testbed.crossing import ground
from testbed.crossing.courses import Course
from testbed.crossing.ground import SOLE_M
from testbed.physics.robot import Robot

# Model of a D4xx depth camera: size of cells, standard deviations of height noise and of the blur at edges, range ahead
# of the body, and largest height difference of neighbouring cells that its step filter accepts [m].
DEPTH_CELL_M, DEPTH_NOISE_M, DEPTH_BLUR_M, DEPTH_X_M, DEPTH_STEP_M = 0.02, 0.005, 0.010, (0.30, 1.00), 0.030


@dataclass(frozen=True)
class Sight:
    """Knowledge of a robot at a pause, in the frame of its map.

    Attributes:
        ground: known ground.
        feet: (4, 3) estimated positions of the feet [m].
        to_world: (4, 4) true transform from this frame to the world.
        foot_errors: (4, 3) true minus estimated position of each foot, in the world [m].
    """

    ground: Footing
    feet: Float
    to_world: Float = field(default_factory=lambda: np.eye(4))
    foot_errors: Float = field(default_factory=lambda: np.zeros((4, 3)))


class Eye(Protocol):
    """Sensor that observes the ground at each pause."""

    # Time for which the robot stands still for each observation [s].
    standing_s: float

    def look(self, robot: Robot) -> Sight:
        """Observe the ground while the robot stands still, and return the robot's knowledge."""


class AllKnowing:
    """Complete knowledge of the true ground."""

    standing_s = 0.0

    def __init__(self, course: Course, product: RobotModel) -> None:
        """Store the true ground of the course."""
        self._world = course.world

    def look(self, robot: Robot) -> Sight:
        """See `Eye`."""
        return Sight(ground.of_heights(robot.base, self._world.height, sole=robot.sole), robot.feet)


class Blind:
    """No sensor: the ground is assumed to be the plane through the feet."""

    standing_s = 0.0

    def __init__(self, course: Course, product: RobotModel) -> None:
        """Ignore the course."""

    def look(self, robot: Robot) -> Sight:
        """See `Eye`."""
        return Sight(ground.of_plane(robot.base, robot.feet), robot.feet)


class DepthCamera:
    """Elevation map of a depth camera with a step filter; poses are exact, and cells are means of all observations."""

    standing_s = 0.0

    def __init__(self, course: Course, product: RobotModel) -> None:
        """Blur the true ground as the camera does, and observe the ground before the field."""
        self._random = np.random.default_rng([course.seed, 23])
        world, ratio = course.world, round(DEPTH_CELL_M / CELL_M)
        self._x, self._y = (np.arange(low, high, DEPTH_CELL_M) + DEPTH_CELL_M / 2 for low, high in (world.x, world.y))
        heights, _ = world.raster(world.x, world.y, CELL_M)
        whole = ndimage.gaussian_filter(heights, DEPTH_BLUR_M / CELL_M).T[
            : len(self._x) * ratio, : len(self._y) * ratio
        ]
        self._true = whole.reshape(len(self._x), ratio, len(self._y), ratio).mean(axis=(1, 3))
        self._sum, self._looks = np.zeros(self._true.shape), np.zeros((len(self._x), 1))
        self._see(self._x < DEPTH_X_M[0] + DEPTH_CELL_M)

    def _see(self, rows: Mask) -> None:
        noise = DEPTH_NOISE_M * self._random.standard_normal((int(rows.sum()), len(self._y)))
        self._sum[rows] += self._true[rows] + noise
        self._looks[rows] += 1

    def look(self, robot: Robot) -> Sight:
        """See `Eye`."""
        body = robot.base
        self._see((self._x > body[0] + DEPTH_X_M[0]) & (self._x < body[0] + DEPTH_X_M[1]))
        seen = np.broadcast_to(self._looks > 0, self._sum.shape)
        heights = np.where(seen, self._sum / np.maximum(self._looks, 1), 0.0)
        step = ndimage.maximum_filter(heights, size=3) - ndimage.minimum_filter(heights, size=3)
        passed = seen & (step <= DEPTH_STEP_M)
        x, y = around(body)
        nearest = (np.rint((at - own[0]) / DEPTH_CELL_M).astype(np.intp) for at, own in ((x, self._x), (y, self._y)))
        cells = np.ix_(*nearest)
        safe, near = passed[cells], np.where(seen, heights, np.inf)[cells]
        return Sight(
            Footing(x, y, heights[cells], safe, SOLE_M + ground.room(safe), *(widened(near),) * 2),
            robot.feet,
        )
