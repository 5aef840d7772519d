"""Proposal of the mounts of camera and laser mirror: low positions outside the robot with a clear view of the area."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from guara_perception.app.robot_folder.postures import FoundPosture
from guara_perception.arrays import Float, Mask
from kinematics import SelfFilter
from kinematics.tree import KinematicTree, RobotState

# Scanned area, as on the Guará. It begins AREA_AHEAD_M ahead of the front feet, since earlier scans cover the ground
# up to there.
AREA_AHEAD_M = 0.20
AREA_DEPTH_M, AREA_WIDTH_M = 0.45, 0.54
# Additional width on each side of the soles, since the planner may place a foot farther out.
BESIDE_M = 0.06
# Mounts of the Guará: camera at 0.5 m height and 0.1 m behind the near edge of the area, mirror 0.2 m ahead of the
# camera and 0.03 m lower.
CAMERA_HEIGHT_M, CAMERA_BEFORE_M, BASELINE_M, MIRROR_LOWER_M = 0.5, 0.10, 0.20, 0.03
# Tangents of half the field of view across and along, less 5 %, for a 3.2 mm lens on a 5:4 sensor about 3.5 mm
# wide.
VIEW_ACROSS, VIEW_ALONG = 0.95 * 0.5 / 0.921, 0.95 * 0.4 / 0.921
# Smallest distance of a mount from the collision shapes of the robot.
MOUNT_MARGIN_M = 0.03
# The search stops once the robot hides at most this fraction of the area from the best mounts found. Improvements by a
# smaller fraction are ignored.
HIDDEN_ENOUGH = 0.01
HIGHEST_M = 1.4
SAMPLES = (10, 12)


@dataclass(frozen=True, slots=True, eq=False)
class FoundMounts:
    """Proposed camera, mirror and scanned area, for the robot in its scan posture.

    Attributes:
        area_x, area_y: limits of the area in base_footprint [m].
        camera: (3,) position of the camera in the base [m].
        camera_pitch: forward tilt of the camera from straight down [rad].
        mirror: (3,) position of the mirror in the base [m].
        hidden: fraction of the area that the robot itself hides from camera or laser, mean of all stances; 1 if no free
            view was found.
    """

    area_x: tuple[float, float]
    area_y: tuple[float, float]
    camera: Float
    camera_pitch: float
    mirror: Float
    hidden: float

    @property
    def transform_camera_to_base(self) -> Float:
        """Pose (4, 4) of the camera in the base; v of the image grows forward and u to the left (the paper's eq. 5)."""
        sine, cosine = np.sin(self.camera_pitch), np.cos(self.camera_pitch)
        transform = np.eye(4)
        transform[:3, :3] = [[0.0, cosine, sine], [1.0, 0.0, 0.0], [0.0, sine, -cosine]]
        transform[:3, 3] = self.camera
        return transform


def find_mounts(
    tree: KinematicTree, posture: FoundPosture, sole: tuple[float, float], others: tuple[Mapping[str, float], ...] = ()
) -> FoundMounts:
    """Propose scanned area, camera and mirror for a standing robot.

    The mounts of the Guará are returned if no candidate is outside the robot with the whole area in view.

    Args:
        tree: the robot, whose shapes may hide the area.
        posture: posture in which the robot scans.
        sole: length and width of a sole [m].
        others: joint positions of further stances, with feet farther ahead or back, to be included in `hidden`.
    """
    soles = np.array(list(posture.soles.values()))
    front, track = float(soles[:, 0].max()), float(np.abs(soles[:, 1]).max())
    half = max(AREA_WIDTH_M / 2.0, float(np.ceil((track + sole[1] / 2.0 + BESIDE_M) * 100.0)) / 100.0)
    near = round(front + AREA_AHEAD_M, 2)
    area_x, area_y = (near, round(near + AREA_DEPTH_M, 2)), (-round(half, 2), round(half, 2))
    everywhere = _samples(area_x, area_y, -posture.base_height)
    stances = [posture.joint_positions, *others]
    filters = [SelfFilter(RobotState(tree, joints), margin=0.01, ignore=()) for joints in stances]
    body = SelfFilter(RobotState(tree, posture.joint_positions), margin=MOUNT_MARGIN_M, ignore=())
    best: FoundMounts | None = None
    for height, camera_x, mirror_x in _candidates(near):
        z = height - posture.base_height
        camera, mirror = np.array([camera_x, 0.0, z]), np.array([mirror_x, 0.0, z - MIRROR_LOWER_M])
        if np.any(body.contains(np.array([camera, mirror]))):
            continue
        pitch = _pitch(area_x, camera_x, height)
        if not _in_view(everywhere, camera, pitch):
            continue
        hidden = np.mean([np.mean(_hidden(robot, (camera, mirror), everywhere)) for robot in filters])
        if best is None or hidden < best.hidden - HIDDEN_ENOUGH:
            best = FoundMounts(area_x, area_y, camera, pitch, mirror, float(hidden))
        if best.hidden <= HIDDEN_ENOUGH:
            break
    if best is None:
        # Fall back to the mounts of the Guará, whose faults `guara robot check` then reports.
        camera = np.array([near - CAMERA_BEFORE_M, 0.0, CAMERA_HEIGHT_M - posture.base_height])
        mirror = camera + (BASELINE_M, 0.0, -MIRROR_LOWER_M)
        pitch = _pitch(area_x, float(camera[0]), CAMERA_HEIGHT_M)
        best = FoundMounts(area_x, area_y, camera, pitch, mirror, 1.0)
    return best


def _candidates(near: float) -> Iterator[tuple[float, float, float]]:
    """Yield (height above the floor, x of the camera, x of the mirror) [m], from low to high."""
    for height in np.arange(CAMERA_HEIGHT_M, HIGHEST_M, 0.05):
        scale = float(height) / CAMERA_HEIGHT_M
        for ahead in (0.0, 0.05, 0.10, 0.15, 0.20, 0.25, 0.30, 0.35):
            camera_x = near - CAMERA_BEFORE_M * scale + ahead
            for baseline in (BASELINE_M * scale, BASELINE_M):
                yield round(float(height), 3), round(camera_x, 3), round(camera_x + baseline, 3)


def _samples(area_x: tuple[float, float], area_y: tuple[float, float], z: float) -> Float:
    x, y = np.meshgrid(np.linspace(*area_x, SAMPLES[0]), np.linspace(*area_y, SAMPLES[1]))
    return np.column_stack((x.ravel(), y.ravel(), np.full(x.size, z)))


def _pitch(area_x: tuple[float, float], camera_x: float, height: float) -> float:
    near, far = (np.arctan2(x - camera_x, height) for x in area_x)
    return round(float(near + far) / 2.0, 3)


def _in_view(points: Float, camera: Float, pitch: float) -> bool:
    """True if all points (n, 3) are in view of a camera that is tilted forward from straight down by `pitch`."""
    directions = points - camera
    ahead = np.array([np.sin(pitch), 0.0, -np.cos(pitch)])
    along = np.array([np.cos(pitch), 0.0, np.sin(pitch)])
    depth = directions @ ahead
    return bool(
        np.all(np.abs(directions[:, 1]) <= VIEW_ACROSS * depth)
        and np.all(np.abs(directions @ along) <= VIEW_ALONG * depth)
    )


def _hidden(robot: SelfFilter, origins: tuple[Float, Float], points: Float) -> Mask:
    hidden = np.zeros(len(points), dtype=bool)
    for origin in origins:
        if np.any(robot.contains(origin[None])):
            return np.ones(len(points), dtype=bool)
        hidden |= robot.blocks(origin, points)
    return hidden
