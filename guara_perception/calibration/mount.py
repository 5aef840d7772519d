"""Pose of the camera over the floor from fiducials, and checks of the fiducials and the ground board."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations

import cv2
import numpy as np

from guara_perception.arrays import Float, Grey
from guara_perception.calibration.board import BoardSpec, BoardView
from guara_perception.calibration.calibration import CameraModel, floor_pixels, to_floor
from guara_perception.calibration.calibration_input import CalibrationSession, Fiducials
from guara_perception.calibration.crosses import SEARCH_M, Mark, find_crosses
from guara_perception.exceptions import CalibrationRefused
from kinematics.arrays import FrozenArrays
from kinematics.transforms import inverse

# Half a turn about the optical axis, which converts the mount of eq. 5 to that of an upright camera, and back.
HALF_TURN = np.diag([-1.0, -1.0, 1.0, 1.0])
ROLLED = "upright"
MOUNTS = {"eq5": np.eye(4), ROLLED: HALF_TURN}
ROLLED_CAMERA = (
    "the camera is rolled by 180 degrees relative to its mount in the URDF: the driver delivers bottom-up pictures, "
    "or the camera is mounted upside down"
)
# Transforms of the axes of the camera or the scene: quarter turn of the image, reflection along x, reflection along y.
_QUARTER = np.eye(4)[[1, 0, 2, 3]] * [1.0, -1.0, 1.0, 1.0]
_MIRROR_X, _MIRROR_Y = np.diag([-1.0, 1.0, 1.0, 1.0]), np.diag([1.0, -1.0, 1.0, 1.0])
HANDEDNESS_ADVICE = (
    "lay down the five crosses of `guara targets` and take their picture again, give the board's first_square in "
    "session.json, or pass --not-mirrored if the driver does not flip pictures"
)
# Largest accepted rms misfit. Correct points fit within 0.1 px if detected, and within 1 or 2 px if given by hand.
MAX_RESIDUAL_PX = {"found": 1.0, "given": 3.0}
GIVEN_SIGMA_PX = 0.5
# Any three crosses fit some pose, so a wrong cross can be identified only among five or more. It is named if the others
# fit without it, and their misfit is CLEARER times smaller than when any other cross is left out instead.
LEAST_OTHERS = 4
CLEARER = 2.0
# Correlation below which a match may be a spot of the floor. Crosses reach 0.8 or more, floor texture rarely 0.6.
SURE_SCORE = 0.7
# Largest deviation from the nominal mount. Usual causes of a larger one are another robot, points measured from another
# origin, and swapped marks.
MAX_SHIFT_M = 0.050
MAX_TURN = float(np.deg2rad(8.0))
# Marks are collinear if the ratio of their extents across and along their longest direction is below this.
MIN_EXTENT_RATIO = 0.15
# Largest relative difference between the ground board's square size measured with the fiducials and that of the
# session.
MAX_SQUARE_ERROR = 0.01
# Largest rms distance of the ground board's corners from a flat grid on the floor.
MAX_BOARD_LIFT_M = 0.004


@dataclass(frozen=True, slots=True)
class FloorPose(FrozenArrays):
    """Pose of the camera over the floor from the fiducials alone.

    Attributes:
        mount: "eq5" or "upright".
        transform_camera_to_footprint: (4, 4) pose of the camera.
        marks: fiducials in the image, in the order of the session.
        residual_px: (n, 2) found minus predicted positions.
    """

    mount: str
    transform_camera_to_footprint: Float
    marks: tuple[Mark, ...]
    residual_px: Float

    @property
    def rms_px(self) -> float:
        """Root mean square distance of the marks from their predicted positions [px]."""
        return float(np.sqrt((self.residual_px**2).sum(axis=1).mean()))


def locate_camera(
    grey: Grey, camera: CameraModel, fiducials: Fiducials, nominal_camera_to_footprint: Float
) -> FloorPose:
    """Find the marks and the pose of the camera, trying the mount of eq. 5 and an upright camera.

    Args:
        grey: greyscale image of the fiducials.
        camera: intrinsic model.
        fiducials: positions of the marks on the floor, and their pixels if given.
        nominal_camera_to_footprint: (4, 4) pose from the robot model and the session's stance.

    Raises:
        CalibrationRefused: the marks are collinear, not found, permuted, or not at the positions that the session
            states; the image is mirrored or turned; or the camera is too far from its nominal mount.
    """
    check_extent(fiducials.points_in_footprint)
    if fiducials.points_px is not None:
        return _from_given(camera, fiducials, nominal_camera_to_footprint)
    points = fiducials.points_in_footprint
    best, lost = _find(grey, camera, points, nominal_camera_to_footprint)
    if best is None or best.rms_px > MAX_RESIDUAL_PX["found"]:
        _refuse_changed(grey, camera, points, nominal_camera_to_footprint)
    if best is None:
        raise CalibrationRefused(
            f"fiducials: {len(points) - len(lost)} of {len(points)} crosses were found near where the nominal mount "
            f"predicts them, but not {_named(points, lost)}: check that all are in view, dark on a bright floor and at "
            "the points_in_footprint given, or give points_px"
        )
    if best.rms_px > MAX_RESIDUAL_PX["found"]:
        raise CalibrationRefused(
            f"fiducials: the crosses found are not at points_in_footprint (misfit {best.rms_px:.1f} px, limit "
            f"{MAX_RESIDUAL_PX['found']:.1f} px): {_misplaced(camera, points, best, nominal_camera_to_footprint)}"
        )
    if excess := _excess(best, nominal_camera_to_footprint):
        raise CalibrationRefused(
            f"the camera would be {excess} away from its nominal mount "
            f"({MAX_SHIFT_M * 1e3:.0f} mm and {np.rad2deg(MAX_TURN):.0f} degrees are allowed): check the robot, the "
            "stance, and the origin from which the fiducials were measured"
        )
    return best


def _named(points: Float, numbers: list[int]) -> str:
    """List of crosses by number and position, for a message."""
    return ", ".join(f"cross {i + 1} at ({points[i, 0]:.3f}, {points[i, 1]:.3f})" for i in numbers)


def _misplaced(camera: CameraModel, points: Float, pose: FloorPose, nominal: Float) -> str:
    """Advice for a message: lay down missing crosses, or measure one cross or all crosses again.

    One cross is named if the others contradict it, which is tested by leaving out each cross in turn.
    """
    missing = [i for i, mark in enumerate(pose.marks) if mark.score < SURE_SCORE]
    if missing:
        return (
            f"only a weak match was found for {_named(points, missing)}, perhaps a spot of the floor: lay down a dark, "
            "flat and whole cross"
        )
    fits = []
    for i in range(len(points) if len(points) > LEAST_OTHERS else 0):
        others = [k for k in range(len(points)) if k != i]
        marks = [pose.marks[k] for k in others]
        fits.append(_fit(camera, points[others], marks, nominal @ MOUNTS[pose.mount], pose.mount))
    order = sorted(range(len(fits)), key=lambda i: fits[i].rms_px)
    if not fits or fits[order[0]].rms_px > min(MAX_RESIDUAL_PX["found"], fits[order[1]].rms_px / CLEARER):
        return "measure the points again"
    wrong = order[0]
    found = to_floor(camera, fits[wrong].transform_camera_to_footprint, pose.marks[wrong].centre_px[None])[0]
    apart = 1e3 * float(np.linalg.norm(found - points[wrong]))
    return (
        f"according to the others, {_named(points, [wrong])} is {apart:.0f} mm off: it is at ({found[0]:.3f}, "
        f"{found[1]:.3f}); measure it again"
    )


def _find(grey: Grey, camera: CameraModel, points: Float, nominal: Float) -> tuple[FloorPose | None, list[int]]:
    """Best-fitting pose, or None if some crosses were not found; and the indices of the crosses that were not found."""
    poses: list[FloorPose] = []
    fewest = list(range(len(points)))
    for mount, turn in MOUNTS.items():
        marks = find_crosses(grey, camera, nominal @ turn, points)
        found = [mark for mark in marks if mark is not None]
        fewest = min(fewest, [i for i, mark in enumerate(marks) if mark is None], key=len)
        if len(found) == len(marks):
            poses.append(_fit(camera, points, found, nominal @ turn, mount))
    return min(poses, key=lambda pose: pose.rms_px, default=None), fewest


def _refuse_changed(grey: Grey, camera: CameraModel, points: Float, nominal: Float) -> None:
    """Refuse an image that shows the crosses mirrored or turned by 90 degrees.

    Raises:
        CalibrationRefused: the image is changed in this way.
    """
    # A mirrored image shows the scene reflected in the plane y = 0.
    mirrored = points * (1.0, -1.0), _MIRROR_Y @ nominal @ _MIRROR_X
    changes = {
        "mirrored": mirrored,
        "turned by 90 degrees": (points, nominal @ _QUARTER),
        "mirrored and turned by 90 degrees": (mirrored[0], mirrored[1] @ _QUARTER),
    }
    for change, (seen_points, seen_nominal) in changes.items():
        pose, _ = _find(grey, camera, seen_points, seen_nominal)
        if pose is not None and pose.rms_px <= MAX_RESIDUAL_PX["found"]:
            raise CalibrationRefused(
                f"fiducials: the picture of the crosses is {change}: switch this off in the camera's driver and record "
                "the session again"
            )


def check_extent(points: Float) -> None:
    """Refuse collinear marks.

    Raises:
        CalibrationRefused: the marks are nearly on one line.
    """
    extent = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if extent[1] < MIN_EXTENT_RATIO * extent[0]:
        raise CalibrationRefused(
            f"fiducials: the points are collinear (their spread across the line is {extent[1] / extent[0]:.0%} of that "
            f"along it, allowed: {MIN_EXTENT_RATIO:.0%} or more): put them at the corners of the area"
        )


def handedness_evidence(session: CalibrationSession, not_mirrored: bool) -> str:
    """Name of the evidence that the images of a session are not mirrored; empty if there is none.

    Args:
        session: session whose marks, and board if there is one, were found.
        not_mirrored: True if the user states that the images are not mirrored.
    """
    evidence = {
        "the user": not_mirrored,
        "board": bool(session.board_images) and session.board.shows_handedness,
        "points_px": session.fiducials.points_px is not None,
        "crosses": not looks_mirrored(session.fiducials.points_in_footprint),
    }
    return next((name for name, holds in evidence.items() if holds), "")


def looks_mirrored(points: Float) -> bool:
    """Test whether the marks (n, 2) are so similar to their mirror image that the search could confuse the two."""
    centred = points - points.mean(axis=0)
    apart = [np.linalg.norm(centred[:, None] * flip - centred, axis=2) for flip in ((1.0, -1.0), (-1.0, 1.0))]
    return min(float(distance.min(axis=1).max()) for distance in apart) < SEARCH_M


def check_ground_board(
    camera: CameraModel, transform_camera_to_footprint: Float, ground: BoardView, board: BoardSpec
) -> float:
    """Refuse a ground board that contradicts the fiducials.

    The corners are projected onto the floor and compared with a flat grid of any scale.

    Returns:
        Size of the squares measured relative to the fiducials, divided by that of the session.

    Raises:
        CalibrationRefused: the size of the squares differs from that of the session, or the board does not lie flat.
    """
    a, b = ground.points(board)[:, :2], to_floor(camera, transform_camera_to_footprint, ground.corners_px)
    a, b = a - a.mean(axis=0), b - b.mean(axis=0)
    fits = []
    for hand in (1.0, -1.0):
        ca, cb = a[:, 0] + 1j * hand * a[:, 1], b[:, 0] + 1j * b[:, 1]
        gain = np.vdot(ca, cb) / np.vdot(ca, ca)
        fits.append((float(np.sqrt(np.mean(np.abs(cb - gain * ca) ** 2))), float(np.abs(gain))))
    misfit, ratio = min(fits)
    if abs(ratio - 1) > MAX_SQUARE_ERROR:
        raise CalibrationRefused(
            f"wrong square size: relative to the fiducials, the squares of the ground board measure "
            f"{ratio * board.square * 1e3:.2f} mm, but the session states {board.square * 1e3:.2f} mm: measure the "
            "board and the fiducials again"
        )
    if misfit > MAX_BOARD_LIFT_M:
        raise CalibrationRefused(
            f"the ground board does not lie flat on the floor of the fiducials: its corners are off by "
            f"{misfit * 1e3:.1f} mm (limit {MAX_BOARD_LIFT_M * 1e3:.0f} mm)"
        )
    return ratio


def pose_of_camera(rotation: Float, translation: Float) -> Float:
    """Transform (4, 4) from camera to scene, given OpenCV's rotation vector and translation from scene to camera."""
    to_camera = np.eye(4)
    to_camera[:3, :3], to_camera[:3, 3] = cv2.Rodrigues(rotation)[0], np.ravel(translation)
    return inverse(to_camera)


def _fit(camera: CameraModel, points: Float, marks: list[Mark], start: Float, mount: str) -> FloorPose:
    """Pose that minimises the reprojection error of the marks, starting from a nominal mount."""
    from_footprint = inverse(start)
    floor = np.column_stack((points, np.zeros(len(points))))
    pixels = np.array([mark.centre_px for mark in marks])
    _, rotation, translation = cv2.solvePnP(
        floor,
        pixels,
        camera.matrix,
        camera.distortion,
        cv2.Rodrigues(from_footprint[:3, :3])[0],
        from_footprint[:3, 3:].copy(),
        useExtrinsicGuess=True,
        flags=cv2.SOLVEPNP_ITERATIVE,
    )
    transform = pose_of_camera(np.asarray(rotation, np.float64), np.asarray(translation, np.float64))
    residual = pixels - floor_pixels(camera, transform, points)
    return FloorPose(mount, transform, tuple(marks), np.nan_to_num(residual, nan=1e3))


def _from_given(camera: CameraModel, fiducials: Fiducials, nominal: Float) -> FloorPose:
    """Pose from the pixels that the user gave. If up to six marks do not fit, other orders are tried to explain why."""
    points = fiducials.points_in_footprint
    given = [Mark(pixel, GIVEN_SIGMA_PX, np.nan) for pixel in np.asarray(fiducials.points_px, dtype=np.float64)]
    best = _best_mount(camera, points, given, nominal)
    if best is not None:
        return best
    if len(points) <= 6:
        for order in permutations(range(len(points))):
            shuffled = [given[i] for i in order]
            if _best_mount(camera, points, shuffled, nominal) is not None:
                wrong = ", ".join(str(number + 1) for number, i in enumerate(order) if number != i)
                raise CalibrationRefused(
                    f"fiducials: points_px are not in the order of points_in_footprint: numbers {wrong} are permuted "
                    f"or mirrored; the order {', '.join(str(i + 1) for i in order)} fits"
                )
    ordered = " in any order" if len(points) <= 6 else ""
    raise CalibrationRefused(
        f"fiducials: points_px and points_in_footprint do not match{ordered} (permuted, mirrored or wrong points): "
        f"no mount within {MAX_SHIFT_M * 1e3:.0f} mm and {np.rad2deg(MAX_TURN):.0f} degrees of the nominal one fits "
        f"them within {MAX_RESIDUAL_PX['given']:.0f} px"
    )


def _best_mount(camera: CameraModel, points: Float, marks: list[Mark], nominal: Float) -> FloorPose | None:
    poses = [_fit(camera, points, marks, nominal @ turn, mount) for mount, turn in MOUNTS.items()]
    fitting = [pose for pose in poses if pose.rms_px <= MAX_RESIDUAL_PX["given"] and not _excess(pose, nominal)]
    return min(fitting, key=lambda pose: pose.rms_px, default=None)


def _excess(pose: FloorPose, nominal: Float) -> str:
    """Shift and rotation of a pose relative to the nominal mount of the same kind, as text; empty if within limits."""
    expected = nominal @ MOUNTS[pose.mount]
    change = inverse(expected) @ pose.transform_camera_to_footprint
    shift, turn = float(np.linalg.norm(change[:3, 3])), float(np.linalg.norm(cv2.Rodrigues(change[:3, :3])[0]))
    is_within = shift <= MAX_SHIFT_M and turn <= MAX_TURN
    return "" if is_within else f"{shift * 1e3:.0f} mm and {np.rad2deg(turn):.1f} degrees"
