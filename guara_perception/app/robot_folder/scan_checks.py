"""Check that camera and laser of a robot cover the scanned area in the scan posture."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from drivers.emulator import EmulatorConfig
from guara_perception.app.robot_folder.finding import Finding, note, wrong
from guara_perception.arrays import Float, Mask
from guara_perception.settings import Settings
from guara_perception.simulation.specimen import specimen
from kinematics import RobotModel, SelfFilter, Stance
from kinematics.scan_pattern import END_TOLERANCE_M, plane_on_floor
from kinematics.stance_pose import StancePose
from kinematics.transforms import transform_points

PICTURE_PX = (640, 512)
CELLS = (46, 55)
# Fractions of the area that may be hidden, or out of view, without a finding.
HIDDEN_SHARE, UNSEEN_SHARE = 0.02, 0.005
# Largest angle between the mirror axis and the y axis of base_link [rad].
MAX_AXIS_ANGLE = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class Coverage:
    """Coverage of a flat floor by camera and laser in the scan posture.

    Attributes:
        x, y: coordinates of the cells in base_footprint [m].
        in_view: (ny, nx) mask of the cells in view of the nominal camera.
        hidden: (ny, nx) mask of the cells that the robot itself hides from camera or laser; all False if `inside` is
            not empty.
        lit: (ny, nx) mask of the cells between the first and the last laser plane.
        inside: names of the links whose shape encloses camera or laser.
        stance, pose: stance of a scan, and pose of the body in it.
        camera, laser: (3,) positions of camera and mirror in base_footprint [m].
        planes: x of the first and the last laser plane on the floor, in base_footprint [m].
    """

    x: Float
    y: Float
    in_view: Mask
    hidden: Mask
    lit: Mask
    inside: tuple[str, ...]
    stance: Stance
    pose: StancePose
    camera: Float
    laser: Float
    planes: tuple[float, ...]

    @property
    def seen(self) -> Mask:
        """(ny, nx) mask of the cells that both camera and laser reach."""
        return self.in_view & ~self.hidden & self.lit


def coverage(robot: RobotModel) -> Coverage:
    """Compute the coverage of the scanned area by camera and laser at their nominal mounts, with the nominal lens."""
    settings = Settings.of(robot)
    stance = Stance(robot.posture(robot.config.scan_posture), robot.legs)
    pose = robot.stance_pose(stance, find_unloaded=False)
    x, y = np.linspace(*settings.footprint_x, CELLS[0]), np.linspace(*settings.footprint_y, CELLS[1])
    every_x, every_y = np.meshgrid(x, y)
    floor = np.column_stack((every_x.ravel(), every_y.ravel(), np.zeros(every_x.size), np.ones(every_x.size)))
    in_base = (floor @ pose.transform_footprint_to_base.T)[:, :3]
    camera, laser = robot.transform_camera_to_base, robot.transform_laser_to_base[:3, 3]
    body = SelfFilter(pose.state)
    origins = np.array([camera[:3, 3], laser])
    inside = tuple(dict.fromkeys(shape.link for shape in body.shapes if np.any(shape.contains(origins))))
    hidden = np.zeros(len(floor), dtype=bool)
    if not inside:
        hidden = body.blocks(camera[:3, 3], in_base) | body.blocks(laser, in_base)
    in_camera = (in_base - camera[:3, 3]) @ camera[:3, :3]
    at_camera, at_mirror = transform_points(pose.transform_base_to_footprint, origins)
    x_mirror, _, z_mirror = at_mirror.tolist()
    planes = tuple(plane_on_floor(x_mirror, z_mirror, angle) for angle in settings.mirror_angles)
    shape = every_x.shape
    return Coverage(
        x,
        y,
        _in_picture(robot, in_camera).reshape(shape),
        hidden.reshape(shape),
        (every_x >= planes[0] - END_TOLERANCE_M) & (every_x <= planes[1] + END_TOLERANCE_M),
        inside,
        stance,
        pose,
        at_camera,
        at_mirror,
        planes,
    )


def _in_picture(robot: RobotModel, in_camera: Float) -> Mask:
    """Mask (n,) of points (n, 3) in the camera frame that are in view of the nominal camera."""
    model = specimen(robot, PICTURE_PX, None).camera
    ahead = in_camera[:, 2] > 0.01
    pixels = np.full((len(in_camera), 2), -1.0)
    if ahead.any():
        pixels[ahead] = model.project(in_camera[ahead])
    return np.asarray(np.all((pixels >= 0) & (pixels <= np.array(PICTURE_PX) - 1), axis=1))


def scan_findings(robot: RobotModel) -> Iterator[Finding]:
    """Yield findings about camera and laser. `load_robot` already reports a pattern that misses the area."""
    axis = robot.transform_laser_to_base[:3, 1]
    if abs(axis[1]) < np.cos(MAX_AXIS_ANGLE):
        yield wrong("frames.laser", "its y axis, the axis of the mirror, is not parallel to y of the base")
    seen = coverage(robot)
    for link in seen.inside:
        yield wrong(
            "frames",
            f"camera or laser lies inside the shape of link {link!r}: move the device, or list the link in "
            "[self_filter] ignore",
        )
    unseen, hidden = float(np.mean(~seen.in_view)), float(np.mean(seen.hidden))
    if unseen > UNSEEN_SHARE:
        yield wrong(
            "frames.camera",
            f"{unseen:.0%} of the scanned area is out of view of a lens of 57 x 47 degrees: mount the camera higher or "
            "turn it",
        )
    if hidden > HIDDEN_SHARE:
        yield wrong(
            "frames.camera, frames.laser",
            f"the robot itself hides {hidden:.0%} of the scanned area from camera or laser (legs, body): mount them "
            "farther ahead or higher",
        )
    board = EmulatorConfig().identity
    angles = np.degrees(sorted(Settings.of(robot).mirror_angles))
    travel = np.degrees([board.angle_of(board.min_step), board.angle_of(board.max_step)])
    if angles[0] < travel[0] or angles[1] > travel[1]:
        yield note(
            "robot.toml [scan]",
            f"the mirror turns from {angles[0]:.1f} to {angles[1]:.1f} degrees, but the firmware of this project only "
            f"from {travel[0]:.1f} to {travel[1]:.1f}: set MIN_STEP, MAX_STEP and ZERO_STEP in its config.h",
        )
