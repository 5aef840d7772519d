"""Knowledge from the laser: the package's scans of simulated frames, fused in the map of the walk."""

from __future__ import annotations

import numpy as np

import guara_perception as gp
from guara_perception.settings import Settings
from guara_perception.simulation import SimulatedRangefinder, specimen
from guara_perception.simulation.footing import Footing
from guara_perception.terrain.scan.policy import ScanPolicy
from kinematics import LegOdometry, RobotModel, Stance
from testbed.crossing.courses import Course
from testbed.crossing.eyes import Sight
from testbed.physics.robot import Robot
from testbed.scanned_walk import swept

PICTURE = (640, 512)
# Bias of a joint, noise of the mean of eight readings, and noise of gravity, as in the robot.toml of both robots [rad].
BIAS, NOISE, GRAVITY_NOISE = 0.0035, 0.00035, 0.00175
# Length by which the ground declared by the gait at the start extends into the scanned area [m].
DECLARED_M = 0.11
# Duration of a stripe with a camera of 120 frames per second (`benchmarks sweeps`) [s].
STRIPE_S = 0.59 / 35


class Laser:
    """Scans, odometry and map; the knowledge is in the frame `odom`."""

    standing_s = 0.0

    def __init__(self, course: Course, product: RobotModel) -> None:
        """Begin the walk of a robot on a course."""
        self._pause = 0
        self._random = np.random.default_rng([course.seed, 17])
        self._bias = BIAS * self._random.standard_normal(len(product.joint_names))
        self._calibration = specimen(product, PICTURE, course.seed)
        self._rangefinder = SimulatedRangefinder(course.world, self._calibration, product, course.seed)
        self._odometry, self._map, self._policy = LegOdometry(product), gp.TerrainMap(product), ScanPolicy(product)

    def look(self, robot: Robot) -> Sight:
        """Scan, update the map, and return its ground."""
        base_to_world, stance = robot.transform_base_to_world, self._stance(robot)
        self._rangefinder.set_pose(base_to_world, robot.joints)
        processor = gp.ScanProcessor(self._calibration, robot.product, stance, "coarse", step=self._pause)
        processor, scanned, stripes = swept(processor, self._rangefinder, self._policy.first_stripes, self._policy)
        self.standing_s = stripes * STRIPE_S
        pose, known = self._odometry.update(stance), () if self._pause else (declared(robot.product),)
        fused = self._map.update(scanned, pose, known_ground=known, picture=processor.ground_picture)
        self._pause += 1
        to_footprint = np.array(scanned.metadata["transform_base_to_footprint"])
        footprint_to_odom = np.array(fused.metadata["transform_footprint_to_odom"])
        base_to_odom = footprint_to_odom @ to_footprint
        feet = robot.feet_by(np.array([stance.joint_positions[name] for name in robot.joint_names]), base_to_odom)
        errors = [-robot.jacobian(leg)[:, robot.dofs] @ self._bias for leg in range(4)]
        to_world = base_to_world @ np.linalg.inv(base_to_odom)
        return Sight(
            Footing.of_map(fused, base_to_odom[:3, 3], feet, footprint_to_odom), feet, to_world, np.array(errors)
        )

    def _stance(self, robot: Robot) -> Stance:
        """Measured stance, with noise and bias."""
        read = robot.joint_positions + self._bias + NOISE * self._random.standard_normal(self._bias.size)
        down = -robot.rotation[2] + GRAVITY_NOISE * self._random.standard_normal(3)
        positions = dict(zip(robot.joint_names, read.tolist(), strict=True))
        return Stance(positions, robot.product.legs, tuple((down / np.linalg.norm(down)).tolist()))


def declared(robot: RobotModel) -> gp.KnownGround:
    """Level ground that the gait declares at the beginning of the walk."""
    settings = Settings.of(robot)
    (x0, _), (y0, y1), x1 = settings.map_x, settings.map_y, settings.footprint_x[0] + DECLARED_M
    return gp.KnownGround(np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)]), height=0.0, sigma=0.001)
