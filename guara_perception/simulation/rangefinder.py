"""Simulated rangefinder that renders camera frames for any pose of the body in a world."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from guara_perception.arrays import Float, Float32, Image
from guara_perception.calibration.calibration import Calibration
from guara_perception.exceptions import CalibrationMismatch, InvalidInput
from guara_perception.ranging.scan_geometry import laser_origin
from guara_perception.simulation.bounce import Bounce
from guara_perception.simulation.light import Light
from guara_perception.simulation.relief import Relief
from guara_perception.simulation.scene_view import Body, SceneView, view_scene
from guara_perception.simulation.sensor import Sensor
from guara_perception.simulation.world import World
from kinematics import RobotModel
from kinematics.transforms import inverse, transform_points

# Distance from the laser plane [sigmas] beyond which the light is neglected: with the default light, less than 0.03 %
# of the peak remains there. Sigma includes the blur of the lens for a pixel of extent MAX_FOOTPRINT_M.
REACH_SIGMAS = 4.5
# Largest extent of a pixel across the laser plane. A larger extent occurs at depth edges and is reduced to this value.
MAX_FOOTPRINT_M = 0.002
# The image rows near a laser plane are those in which a point is within NEAR_PLANE_M of the plane; only every
# THINNING_PX-th row and column is tested.
THINNING_PX = 4
NEAR_PLANE_M = 0.020
# Minimum height of camera and laser above the ground; a pose with a smaller height is rejected.
LEAST_CLEARANCE_M = 0.05


class SimulatedRangefinder:
    """Simulated rangefinder on a robot in a simulated world.

    Example:
        rangefinder = SimulatedRangefinder(world, specimen(robot), robot, seed=0)
        rangefinder.set_pose(transform_base_to_world, joint_positions)
        for index, on, off in rangefinder.frames(range(0, 70, 2)):
            processor.add(index, on, off)
    """

    def __init__(
        self, world: World, calibration: Calibration, robot: RobotModel, seed: int = 0, *, light: Light | None = None
    ) -> None:
        """Set up camera, laser planes and noise; call `set_pose` before rendering.

        Args:
            world: the terrain.
            calibration: true calibration of the rangefinder, for instance from `specimen`.
            robot: robot that carries the rangefinder.
            seed: seed of all noise; the same sequence of calls gives the same frames.
            light: parameters of light and sensor; None = those of the world.

        Raises:
            CalibrationMismatch: the calibration belongs to another robot.
        """
        if calibration.robot != robot.name:
            raise CalibrationMismatch(f"the calibration belongs to robot {calibration.robot!r}, not to {robot.name!r}")
        self.world, self.calibration, self.robot = world, calibration, robot
        self.light = world.light if light is None else light
        self.laser_planes = LaserPlanes.of(calibration)
        self._relief = Relief.of(world)
        width, height = calibration.camera.size
        pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).reshape(-1, 2)
        self._rays = calibration.camera.rays(pixels).reshape(height, width, 3).astype(np.float32)
        camera = calibration.transform_camera_to_base[:3, 3]
        self._laser_in_base = laser_origin(self.laser_planes.planes_in_base, camera)
        self._sensor = Sensor(self.light, (height, width), seed)
        self._view: SceneView | None = None
        self._thin_points: Float32 = np.zeros((0, 0, 3), np.float32)
        self._bounce: Bounce | None = None
        self._transform_world_to_base: Float = np.eye(4)

    @property
    def view(self) -> SceneView:
        """View of the scene from the current pose.

        Raises:
            InvalidInput: `set_pose` has not been called.
        """
        if self._view is None:
            raise InvalidInput("the simulated rangefinder has no pose: call set_pose(transform_base_to_world) first")
        return self._view

    def set_pose(
        self,
        transform_base_to_world: npt.ArrayLike,
        joint_positions: Mapping[str, float] | None = None,
        view: SceneView | None = None,
    ) -> SceneView:
        """Set the pose of the body; return the view of the scene that all frames from this pose share.

        Args:
            transform_base_to_world: (4, 4) pose of the body.
            joint_positions: joint positions by name [rad]; the robot is drawn and casts shadows. None = no robot.
            view: result of an earlier call with the same arguments, so that it need not be computed again.

        Raises:
            InvalidInput: camera or laser is in the ground or too close to it.
            kinematics.KinematicsError: the joint positions do not fit the robot.
        """
        transform = np.asarray(transform_base_to_world, dtype=np.float64)
        camera = transform @ self.calibration.transform_camera_to_base
        laser = transform_points(transform, self._laser_in_base)
        for name, position in (("camera", camera[:3, 3]), ("laser", laser)):
            clearance = position[2] - float(self.world.height(position[0], position[1]))
            if clearance < LEAST_CLEARANCE_M:
                raise InvalidInput(
                    f"the {name} is {clearance:.3f} m above the ground; allowed: {LEAST_CLEARANCE_M} m or more"
                )
        if view is None:
            body = None if joint_positions is None else Body(self.robot.state(joint_positions), transform)
            beam = (laser, transform[:3, 1])
            view = view_scene(self._relief, self._rays, camera, beam, body, self.light)
        self._view = view
        self._sensor.set_scene(self._view.ambient)
        self._bounce = Bounce(self._view) if self.light.bounce > 0 else None
        self._transform_world_to_base = inverse(transform)
        self._thin_points = np.ascontiguousarray(self._view.points[::THINNING_PX, ::THINNING_PX])
        return self._view

    def frames(self, indices: Iterable[int]) -> Iterator[tuple[int, Image, Image]]:
        """Yield index, laser-on and laser-off frame of each stripe; frames are (h, w, 3) BGR uint8.

        Raises:
            CalibrationMismatch: the calibration has no stripe with this index.
            InvalidInput: `set_pose` has not been called.
        """
        for index in indices:
            angle = self.calibration.stripe(index).mirror_angle
            yield index, self.frame(mirror_angle=angle), self.frame(laser=0.0)

    def frame(
        self, *, laser: float = 1.0, mirror_angle: float = 0.0, mirror_travel: float = 0.0, exposure: float = 1.0
    ) -> Image:
        """Render one frame, (h, w, 3) BGR uint8.

        Args:
            laser: share of the exposure during which the laser is on, 0 ... 1.
            mirror_angle: mirror angle halfway through the exposure [rad].
            mirror_travel: rotation of the mirror during the exposure [rad].
            exposure: exposure time relative to the nominal one.

        Raises:
            InvalidInput: `set_pose` has not been called, or the exposure is not a finite number above 0.
        """
        view = self.view
        if not (np.isfinite(exposure) and exposure > 0):
            raise InvalidInput(f"exposure is {exposure} times the nominal one; allowed: finite factors above 0")
        if laser <= 0:
            return self._sensor.dark_picture(exposure)
        light, rows = self._laser_light(view, mirror_angle, mirror_travel)
        return self._sensor.picture(light, rows, laser, exposure)

    def _laser_light(
        self, view: SceneView, mirror_angle: float, mirror_travel: float
    ) -> tuple[Float32, tuple[int, int]]:
        """Grey levels (rows, w) of the laser light, and the range (first, end) of image rows that contains it."""
        plane = self.laser_planes.plane_at(mirror_angle)
        normal = self._transform_world_to_base[:3, :3].T @ plane[:3]
        # The plane is in world axes, relative to the origin of the view, so that float32 is accurate enough.
        offset = plane[3] + plane[:3] @ self._transform_world_to_base[:3, 3] + normal @ view.origin
        height, width = view.laser_gain.shape
        top, bottom = self._rows_near(normal, offset, height)
        distance = view.points[top:bottom].reshape(-1, 3) @ normal.astype(np.float32) + np.float32(offset)
        # The laser plane turns by twice the travel. The width that it sweeps at 0.5 m widens the Gaussian profile.
        swept = 2 * mirror_travel * 0.5
        sigma = np.hypot(self.light.stripe_sigma, swept / np.sqrt(12))
        reach = np.float32(REACH_SIGMAS * np.hypot(sigma, MAX_FOOTPRINT_M * self.light.blur))
        within = np.flatnonzero(np.abs(distance) < reach)
        near = within + top * width
        row = near // width
        gain = view.laser_gain.ravel()[near]
        within, near, row, gain = within[gain > 0], near[gain > 0], row[gain > 0], gain[gain > 0]
        if not near.size:
            return np.zeros((0, width), np.float32), (0, 0)
        from_plane = distance[within]
        below = distance[np.minimum(within + width, distance.size - 1)]
        # A pixel integrates light over its own height and, due to the blur of the lens, over its neighbours. Widening
        # the Gaussian accordingly is accurate on smooth ground, and avoids the aliasing of a blur applied to the image.
        footprint = np.minimum(np.abs(below - from_plane), np.float32(MAX_FOOTPRINT_M))
        variance = np.float32(sigma**2) + footprint**2 * np.float32(1 / 12 + self.light.blur**2)
        strength = gain * np.float32(self.light.stripe_sigma) / np.sqrt(variance)
        level = strength * np.exp(-0.5 * from_plane**2 / variance)
        speckled = level * self._sensor.speckle(near.size)
        bounced = None if self._bounce is None else self._bounce.light(near, level, self.light.bounce)
        first, end = (int(row.min()), int(row.max()) + 1) if bounced is None else (0, height)
        light = np.zeros((end - first, width), np.float32)
        light.ravel()[near - first * width] = speckled
        if bounced is not None:
            light += bounced
        return light, (first, end)

    def _rows_near(self, normal: Float, offset: float, height: int) -> tuple[int, int]:
        """Range of rows that may be near a laser plane: the first, and one past the last."""
        thin = self._thin_points
        distance = thin.reshape(-1, 3) @ normal.astype(np.float32) + np.float32(offset)
        rows = np.flatnonzero((np.abs(distance) < NEAR_PLANE_M).reshape(thin.shape[:2]).any(axis=1))
        if not rows.size:
            return 0, 0
        return int(rows[0] - 2) * THINNING_PX if rows[0] > 2 else 0, min(int(rows[-1] + 3) * THINNING_PX, height)


@dataclass(frozen=True, slots=True)
class LaserPlanes:
    """Laser plane as a continuous function of the mirror angle, interpolated between the planes of all stripes.

    Attributes:
        angles: (s,) mirror angles, ascending [rad].
        planes_in_base: (s, 4) planes n . X + d = 0 in base_link, n a unit vector pointing forwards.
    """

    angles: Float
    planes_in_base: Float

    @staticmethod
    def of(calibration: Calibration) -> LaserPlanes:
        """Create the function from the laser planes of a calibration."""
        stripes = sorted(calibration.stripes, key=lambda stripe: stripe.mirror_angle)
        planes = np.array([stripe.plane for stripe in stripes]) @ inverse(calibration.transform_camera_to_base)
        planes *= np.where(planes[:, :1] < 0, -1.0, 1.0)
        return LaserPlanes(np.array([stripe.mirror_angle for stripe in stripes]), planes)

    def plane_at(self, mirror_angle: float) -> Float:
        """Laser plane (4,) in base_link at a mirror angle [rad].

        Between two stripes, the plane turns about the line of intersection of their planes, as a mirror would turn it.
        Beyond the first or last stripe, the plane is extrapolated from the nearest two stripes.
        """
        after = int(np.clip(np.searchsorted(self.angles, mirror_angle), 1, len(self.angles) - 1))
        a, b = self.planes_in_base[after - 1], self.planes_in_base[after]
        share = (mirror_angle - self.angles[after - 1]) / (self.angles[after] - self.angles[after - 1])
        turn = np.arccos(np.clip(a[:3] @ b[:3], -1.0, 1.0))
        # Spherical interpolation turns the normal at a constant rate. Every linear combination of two planes contains
        # their line of intersection.
        weights = np.array([np.sin((1 - share) * turn), np.sin(share * turn)]) / np.sin(turn)
        plane = weights @ np.array([a, b])
        return np.asarray(plane / np.linalg.norm(plane[:3]))
