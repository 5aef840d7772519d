"""Quality checks of a calibration and their limits."""

from __future__ import annotations

import math

import numpy as np

from guara_perception.arrays import Float, Index
from guara_perception.calibration.bundle import CameraFit
from guara_perception.calibration.intrinsics import Intrinsics
from guara_perception.calibration.laser import LaserFit
from guara_perception.calibration.mount import FloorPose
from guara_perception.calibration.quality import Check
from kinematics import RobotModel, Stance

LEFT_OUT = "plate left out"
MEASURE_MOUNT = (
    "measure the mount and correct the URDF, or correct the positions of the crosses (an offset common to all of them "
    "has the same effect); also check that the robot stood still"
)
# Description of each check for the report, and advice when its result is not good.
TEXTS = {
    "board views used": (
        "Pictures of the board with sharp corners, used to fit the lens model.",
        "take more pictures of the board, at different positions and tilts",
    ),
    "board corner error": (
        "RMS reprojection error of the board corners. A small value is necessary but not sufficient.",
        "use a flat, stiff board and take sharp pictures",
    ),
    "picture covered": (
        "Share of the picture covered by board corners; elsewhere the lens model extrapolates.",
        "move the board into the corners of the picture",
    ),
    "focal length sigma": (
        "Standard deviation of the focal length estimated from the board pictures.",
        "tilt the board more, bring it nearer, or take more pictures",
    ),
    "halves disagree by": (
        "RMS difference of lens models fitted to two halves of the pictures, at floor distance.",
        "take 10 or more pictures of the board; check that it is flat",
    ),
    "fiducial misfit": (
        "RMS reprojection error of the measured positions of the crosses.",
        "measure the crosses again; keep them flat on the floor",
    ),
    "square size error": (
        "Relative difference between the given size of the board's squares and the size measured from the crosses.",
        "measure the board and the crosses again",
    ),
    "floor point sigma": (
        "Standard deviation of a floor point due to camera and mount, at the worst point of the picture.",
        "take more pictures of the board; place the crosses further apart",
    ),
    "mount off its place": (
        "Distance between the fitted optical centre and that in the robot's URDF.",
        MEASURE_MOUNT,
    ),
    "mount turned": ("Angle between the fitted mount and that in the robot's URDF.", MEASURE_MOUNT),
    "plane residual": (
        "RMS height error of the plates, measured with the laser planes that were fitted to them.",
        "check that the plates are flat and level and that nothing moved between the scans",
    ),
    LEFT_OUT: (
        "RMS height error of the worst plate, measured with laser planes that were fitted to the other plates only.",
        "scan three or more plates; measure their heights again; move nothing between the scans",
    ),
    "mirror steps": (
        "Standard deviation of the laser planes' angles relative to an ideal mirror.",
        "check the coupling, the speed and the dwell time of the mirror's motor",
    ),
    "stripes filled in": (
        "Share of stripes whose laser plane was not fitted but computed from the mirror model.",
        "check the exposure, and that the plates fill the view",
    ),
    "height sigma near": (
        "Predicted standard deviation of a single height at the near edge of the area, due to noise and calibration.",
        "reduce the exposure, focus the laser line",
    ),
    "height sigma far": (
        "Predicted standard deviation at the far edge, where laser plane and line of sight meet at a small angle.",
        "reduce the exposure, focus the laser line",
    ),
    "mount by joints and gravity": (
        "Angle between the mount computed with the joint angles and that computed with gravity.",
        "level the floor; check that all soles lie flat on it, and check the joints' zeros and the mount of the IMU",
    ),
}
# Least number of soles that define a plane.
LEAST_FEET = 3


def camera_checks(
    intrinsics: Intrinsics,
    fit: CameraFit,
    floor: FloorPose,
    square_ratio: float | None,
    corners_by_cell: Index,
    halves_px: Float | None,
    floor_sigma: Float,
) -> list[Check]:
    """Checks of camera and mount.

    For a given lens, the checks of its estimation are omitted; without board views, also that of the corner error.

    Args:
        intrinsics: lens and views.
        fit: joint fit of camera and mount.
        floor: camera pose from the fiducials alone.
        square_ratio: size of the ground board's squares measured relative to the fiducials, divided by the given size;
            None without a ground board.
        corners_by_cell: number of corners in each cell of the image.
        halves_px: (n, 2) projection differences between the lenses of the cross-validation [px]; None if not computed.
        floor_sigma: (n,) standard deviations of the floor points seen by pixels all over the image [m]; NaN does not
            count.
    """
    residual = np.concatenate([np.empty(0), *(r.ravel() for r in fit.residuals_px)])
    marks = float(np.sqrt((fit.mark_residuals_px**2).sum(axis=1).mean()))
    focal = 100 * float(intrinsics.sigma[0] / intrinsics.camera.matrix[0, 0])
    halves = float(np.sqrt((halves_px**2).sum(axis=1).mean())) if halves_px is not None else np.nan
    given_by_hand = np.isnan(floor.marks[0].score)
    checks = []
    if intrinsics.views:
        checks.append(_check("board corner error", float(np.sqrt(2 * np.mean(residual**2))), "px", 0.3, 1.0))
    if not intrinsics.is_given:
        checks.insert(0, _check("board views used", len(intrinsics.views), "views", 8, 5, higher_is_better=True))
        covered = 100 * float((corners_by_cell > 0).mean())
        checks += [
            _check("picture covered", covered, "%", 70, 40, higher_is_better=True),
            _check("focal length sigma", focal, "%", 0.1, 0.5),
            _check("halves disagree by", halves, "px", 0.5, 2.0),
        ]
    checks.append(_check("fiducial misfit", marks, "px", 2.0 if given_by_hand else 0.3, 3.0 if given_by_hand else 1.0))
    if square_ratio is not None:
        checks.append(_check("square size error", 100 * abs(square_ratio - 1), "%", 0.3, 1.0))
    worst = max(floor_sigma[~np.isnan(floor_sigma)], default=math.inf)
    return [*checks, _check("floor point sigma", 1e3 * float(worst), "mm", 0.5, 2.0)]


def mount_checks(transform_camera_to_base: Float, nominal_camera_to_base: Float, mount: str) -> list[Check]:
    """Checks of distance and angle between the fitted mount and that of the robot's URDF.

    An error common to the positions of all crosses leaves no residual in the fit; only this comparison reveals it.

    Args:
        transform_camera_to_base: (4, 4) fitted mount.
        nominal_camera_to_base: (4, 4) mount of the URDF.
        mount: "eq5", or "upright" for a camera rotated by 180 degrees about its optical axis.
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
    """Checks of the laser planes and of the heights measured with them.

    Args:
        laser: fit of the planes.
        near, far: sigma of a single height on the floor at the near and the far edge of the area [m].
        filled: number of stripes whose plane comes from the mirror model.
        stripes: number of different stripes in the plate scans.
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
    """Check of the angle between the mount computed with the joint angles and that computed with gravity.

    The mount follows from the pose of the camera over the floor, known from the images, and the pose of `base_link`,
    known either from the plane of the soles or from gravity. On a level floor, both give the same mount. Because the
    camera pose is common to both, the two mounts of a nearly level body differ by the angle between the floor normals
    in `base_link`.

    Args:
        robot: model of the robot.
        stance: stance of the session.

    Returns:
        One check; an empty list without gravity or with fewer than three support feet.
    """
    if stance.gravity_in_base is None or len(stance.support_feet) < LEAST_FEET:
        return []
    from_gravity, from_joints = (
        np.asarray(robot.stance_pose(stance, attitude=source).transform_base_to_footprint)[:3, :3]
        for source in ("imu", "support_plane")
    )
    # Floor normals in base_link. The arc cosine would lose small angles to rounding; the arc tangent does not.
    normal, other = from_gravity[2], from_joints[2]
    angle = float(np.arctan2(np.linalg.norm(np.cross(normal, other)), normal @ other))
    return [_check("mount by joints and gravity", float(np.rad2deg(angle)), "degrees", 0.5, 2.0)]


def _check(
    name: str, value: float, unit: str, usable_from: float, refused_from: float, *, higher_is_better: bool = False
) -> Check:
    return Check(name, value, unit, usable_from, refused_from, *TEXTS[name], higher_is_better)
