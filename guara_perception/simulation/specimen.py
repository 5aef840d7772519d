"""True calibration of a simulated rangefinder: nominal mounts of the robot with assembly errors."""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from guara_perception.arrays import Float
from guara_perception.calibration.calibration import Calibration, CameraModel, StripePlane
from guara_perception.calibration.file import content_hash
from guara_perception.exceptions import InvalidInput
from guara_perception.settings import Settings
from kinematics import RobotModel

# Ratio of focal length to sensor width, for example a 3.2 mm lens on a sensor about 3.5 mm wide. Without assembly
# errors, the scanned area is in view with a margin of about 3 % of the image or more on each side.
FOCAL_LENGTH_OF_WIDTH = 0.921
DISTORTION = (-0.23, 0.06, 0.0, 0.0, 0.0)
# Errors that remain after careful assembly (one sigma). Two sigma are about a degree, 3 mm, 1 % of the focal length,
# and 1 % of the image width for the principal point.
ANGLE_SIGMA = 0.008
POSITION_SIGMA_M = 0.0015
FOCAL_SIGMA = 0.005
CENTRE_SIGMA_OF_WIDTH = 0.006
DISTORTION_SIGMA = 0.01
# Angle between two neighbouring positions of the mirror [rad], for a stepper of 1.8 degrees with 256 microsteps.
MIRROR_STEP = 122718e-9


def specimen(
    robot: RobotModel, size: tuple[int, int] = (640, 512), seed: int | None = 0, *, mirror_step: float = MIRROR_STEP
) -> Calibration:
    """Create the true calibration of a simulated rangefinder, with its content hash.

    Args:
        robot: robot with the nominal mounts and the scan pattern.
        size: image width and height [px].
        seed: seed of the assembly errors; None = exactly nominal.
        mirror_step: step to which mirror angles are rounded [rad]; 0 = do not round.

    Raises:
        InvalidInput: the image is less than 64 px wide or high.
        FileFormatError: the robot's perception settings are invalid.
    """
    width, height = size
    if min(size) < 64:
        raise InvalidInput(f"picture size is {width}x{height}, allowed: 64x64 px or more")
    errors = np.zeros(16) if seed is None else np.random.default_rng(seed).standard_normal(16)
    # Pixels are nearly square, so one focal length must suit both width and height, whatever their ratio.
    focal = FOCAL_LENGTH_OF_WIDTH * max(width, 1.25 * height) * (1 + FOCAL_SIGMA * errors[0])
    centre = np.array([width - 1, height - 1]) / 2 + CENTRE_SIGMA_OF_WIDTH * width * errors[1:3]
    camera = CameraModel(
        size=size,
        matrix=np.array([[focal, 0, centre[0]], [0, focal * (1 + 0.002 * errors[3]), centre[1]], [0, 0, 1]]),
        distortion=np.array(DISTORTION) + np.array([DISTORTION_SIGMA * errors[4], 0, 0, 0, 0]),
    )
    mount = np.eye(4)
    mount[:3, :3] = rotation(ANGLE_SIGMA * errors[5:8])
    mount[:3, 3] = POSITION_SIGMA_M * errors[8:11]
    transform_camera_to_base = robot.transform_camera_to_base.copy()
    transform_camera_to_base[:3, :3] = mount[:3, :3] @ transform_camera_to_base[:3, :3]
    transform_camera_to_base[:3, 3] += mount[:3, 3]
    settings = Settings.of(robot)
    angles = np.linspace(*settings.mirror_angles, settings.stripes)
    if mirror_step > 0:
        angles = np.round(angles / mirror_step) * mirror_step
    planes = _laser_planes(robot, angles, errors[11:])
    stripes = tuple(
        StripePlane(index=i, mirror_angle=float(angle), plane=plane @ transform_camera_to_base)
        for i, (angle, plane) in enumerate(zip(angles, planes, strict=True))
    )
    calibration = Calibration(
        robot=robot.name,
        camera=camera,
        transform_camera_to_base=transform_camera_to_base,
        stripes=stripes,
        quality={"verdict": "good", "reasons": ["true calibration of a simulated rangefinder"]},
        created="simulated",
    )
    return dataclasses.replace(calibration, hash=content_hash(calibration))


def rotation(turn: npt.ArrayLike) -> Float:
    """Rotation matrix (3, 3) from a rotation vector (3,) [rad]."""
    return np.asarray(Rotation.from_rotvec(turn).as_matrix())


def _laser_planes(robot: RobotModel, angles: Float, errors: Float) -> Float:
    """Planes (s, 4) in base_link of a horizontal laser, reflected by a mirror inclined by 45 degrees at angle 0."""
    position = robot.transform_laser_to_base[:3, 3] + POSITION_SIGMA_M * np.array([errors[0], 0, errors[1]])
    axis = rotation(ANGLE_SIGMA * 0.3 * np.array([errors[2], 0, errors[3]])) @ np.array([0.0, 1.0, 0.0])
    # Apart from the tilt of the axis, the incoming laser plane is horizontal and contains the axis. At angle zero, it
    # is reflected straight down. errors[4] turns the plane about its own normal, which has no effect except rounding.
    # The term stays, so that the calibration of a seed does not change.
    incoming_normal = rotation(ANGLE_SIGMA * 0.3 * np.array([0, 0, errors[4]])) @ np.array([0.0, 0.0, 1.0])
    planes = []
    for angle in angles:
        face = rotation(axis * -angle) @ rotation(axis * (np.pi / 4)) @ np.array([0.0, 0.0, 1.0])
        normal = incoming_normal - 2 * (incoming_normal @ face) * face
        planes.append(np.append(normal, -(normal @ position)))
    return np.array(planes)
