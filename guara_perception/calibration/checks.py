"""Figures that decide the verdict of a calibration, with their limits."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from guara_perception.arrays import Float, Index
from guara_perception.calibration.bundle import CameraFit
from guara_perception.calibration.intrinsics import Intrinsics
from guara_perception.calibration.laser import LaserFit
from guara_perception.calibration.mount import FloorPose
from guara_perception.calibration.quality import Check

if TYPE_CHECKING:
    from kinematics import RobotModel, Stance

LEFT_OUT = "plate left out"
MEASURE_MOUNT = (
    "measure the mount and correct the URDF, or the crosses: crosses misplaced as a whole look like this too: check "
    "their positions, and that the robot stood still"
)
# Meaning of each check, for the report, and advice for one that is not good.
TEXTS = {
    "board views used": (
        "Pictures of the checkerboard in which every corner was found sharply.",
        "take more pictures of the board, at different positions and tilts",
    ),
    "board corner error": (
        "Rms distance of the corners from the projection by the lens model. Small is necessary, not sufficient.",
        "use a flat, stiff board and sharp pictures",
    ),
    "picture covered": (
        "Share of the picture in which the board was seen; elsewhere the lens model extrapolates.",
        "move the board into the corners of the picture",
    ),
    "focal length sigma": (
        "Standard deviation of the focal length as estimated from the boards.",
        "tilt the board more, bring it nearer, take more pictures",
    ),
    "halves disagree by": (
        "Two lenses, each from every other picture, compared at floor distance: reveals a wrong model, hardly noise.",
        "take 10 or more pictures of the board; check that it is flat",
    ),
    "fiducial misfit": (
        "Rms distance of the crosses in the picture from their measured positions, projected.",
        "measure the crosses again; keep them flat on the floor",
    ),
    "square size error": (
        "Size of the board's squares as measured by the fiducials: two rulers that must agree.",
        "measure the board and the fiducials again",
    ),
    "floor point sigma": (
        "Standard deviation of a floor point by camera and mount, at the worst point of the picture.",
        "more pictures of the board, fiducials further apart",
    ),
    "mount off its place": ("Distance of the fitted optical centre from that of the robot's URDF.", MEASURE_MOUNT),
    "mount turned": ("Angle between the fitted mount and the one of the robot's URDF.", MEASURE_MOUNT),
    "plane residual": (
        "Height error of the plates themselves, measured with the planes fitted to them.",
        "check that plates are flat and level and nothing moved between the scans",
    ),
    LEFT_OUT: (
        "Each plate measured with planes fitted to the other plates only: the cross-validated error of height.",
        "scan three or more plates; measure their heights again; nothing may move between the scans",
    ),
    "mirror steps": (
        "Standard deviation of the laser planes' angles from those of an ideal mirror.",
        "check coupling, speed and dwell time of the mirror's motor",
    ),
    "stripes filled in": (
        "Share of stripes without a plane of their own, which take that of the mirror model.",
        "check exposure and that the plates fill the view",
    ),
    "height sigma near": (
        "Predicted error of one height at the near edge of the area, noise and calibration together.",
        "less exposure, a sharper laser line",
    ),
    "height sigma far": (
        "The same at the far edge, where laser plane and line of sight meet at a small angle.",
        "less exposure, a sharper laser line",
    ),
    "mount by joints and gravity": (
        "Angle between the mount that follows from the joint angles and the one that follows from gravity.",
        "level the floor; check that all soles lie flat on it, the zeros of the joints, and how the IMU is mounted",
    ),
}
# Fewer soles make no plane.
LEAST_FEET = 3


def camera_checks(
    intrinsics: Intrinsics,
    fit: CameraFit,
    floor: FloorPose,
    square_ratio: float,
    corners_by_cell: Index,
    halves_px: Float | None,
    floor_sigma: Float,
) -> list[Check]:
    """Figures of camera and mount.

    Args:
        intrinsics: lens and views.
        fit: joint fit.
        floor: pose by the fiducials alone.
        square_ratio: size of the ground board's squares as measured by the fiducials, divided by the given size.
        corners_by_cell: number of corners in each cell of the picture.
        halves_px: (n, 2) differences of the cross-validation, None where there are too few views.
        floor_sigma: (n,) projection uncertainty on the floor [m].
    """
    residual = np.concatenate([r.ravel() for r in fit.residuals_px])
    marks = float(np.sqrt((fit.mark_residuals_px**2).sum(axis=1).mean()))
    focal = 100 * float(intrinsics.sigma[0] / intrinsics.camera.matrix[0, 0])
    halves = float(np.sqrt((halves_px**2).sum(axis=1).mean())) if halves_px is not None else np.nan
    given_by_hand = np.isnan(floor.marks[0].score)
    return [
        _check("board views used", len(intrinsics.views), "views", 8, 5, higher_is_better=True),
        _check("board corner error", float(np.sqrt(2 * np.mean(residual**2))), "px", 0.3, 1.0),
        _check("picture covered", 100 * float((corners_by_cell > 0).mean()), "%", 70, 40, higher_is_better=True),
        _check("focal length sigma", focal, "%", 0.1, 0.5),
        _check("halves disagree by", halves, "px", 0.5, 2.0),
        _check("fiducial misfit", marks, "px", 2.0 if given_by_hand else 0.3, 3.0 if given_by_hand else 1.0),
        _check("square size error", 100 * abs(square_ratio - 1), "%", 0.3, 1.0),
        _check("floor point sigma", 1e3 * float(np.nanmax(floor_sigma)), "mm", 0.5, 2.0),
    ]


def mount_checks(transform_camera_to_base: Float, nominal_camera_to_base: Float, mount: str) -> list[Check]:
    """Distance and angle between the fitted mount and that of the robot's URDF.

    Crosses that are all displaced alike fit perfectly: only the robot's own geometry contradicts them.

    Args:
        transform_camera_to_base: (4, 4) fitted mount.
        nominal_camera_to_base: (4, 4) mount of the URDF.
        mount: "eq5", or "upright" for a camera that is turned by half a turn about its axis.
    """
    nominal = np.array(nominal_camera_to_base)
    if mount == "upright":
        nominal[:3, :2] *= -1
    offset = float(np.linalg.norm(transform_camera_to_base[:3, 3] - nominal[:3, 3]))
    turn = nominal[:3, :3].T @ transform_camera_to_base[:3, :3]
    angle = float(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1.0, 1.0)))
    return [
        _check("mount off its place", 1e3 * offset, "mm", 10.0, 60.0),
        _check("mount turned", float(np.rad2deg(angle)), "degrees", 2.0, 10.0),
    ]


def laser_checks(laser: LaserFit, near: float, far: float, filled: int, stripes: int) -> list[Check]:
    """Figures of the laser.

    Args:
        laser: fit of the planes.
        near, far: sigma of a single height on the floor at both ends of the area [m].
        filled: number of stripes without a plane of their own.
        stripes: number of stripes of the whole pattern.
    """
    errors = laser.line_errors
    left_out = max((one.rms for one in laser.leave_one_out), default=np.nan)
    step_error = np.rad2deg(float(np.std(2 * laser.sweep.step_errors)))
    return [
        _check("plane residual", 1e3 * float(np.sqrt(np.mean(errors**2))), "mm", 0.15, 0.5),
        _check(LEFT_OUT, 1e3 * left_out, "mm", 0.25, 0.5),
        _check("mirror steps", step_error, "degrees", 0.05, 0.2),
        _check("stripes filled in", 100 * filled / max(stripes, 1), "%", 0.0, 20.0),
        _check("height sigma near", 1e3 * near, "mm", 0.5, 2.0),
        _check("height sigma far", 1e3 * far, "mm", 1.0, 4.0),
    ]


def stance_checks(robot: RobotModel, stance: Stance) -> list[Check]:
    """The angle between two mounts: one from the soles as the joint angles put them, one from the measured gravity.

    The pictures give the camera's pose over the floor; the stance gives that of `base_link` over the floor, by the
    soles and by gravity, and on a level floor both agree. The angle between the two floor normals is the angle between
    the two mounts, whatever the camera saw.

    Args:
        robot: the model.
        stance: the stance in which the session's pictures were taken.

    Returns:
        One check; none without gravity or with fewer than three feet.
    """
    if stance.gravity_in_base is None or len(stance.support_feet) < LEAST_FEET:
        return []
    from_gravity, from_joints = (
        np.asarray(robot.stance_pose(stance, attitude=source).transform_base_to_footprint)[:3, :3]
        for source in ("imu", "support_plane")
    )
    # The floor's normal in base_link by each. The arc cosine alone would lose small angles to rounding.
    normal, other = from_gravity[2], from_joints[2]
    angle = float(np.arctan2(np.linalg.norm(np.cross(normal, other)), normal @ other))
    return [_check("mount by joints and gravity", float(np.rad2deg(angle)), "degrees", 0.5, 2.0)]


def _check(
    name: str, value: float, unit: str, usable_from: float, refused_from: float, *, higher_is_better: bool = False
) -> Check:
    return Check(name, value, unit, usable_from, refused_from, *TEXTS[name], higher_is_better)
