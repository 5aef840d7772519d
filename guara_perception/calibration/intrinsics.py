"""Intrinsic calibration from board views: camera model with standard deviations, corner errors, outliers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from guara_perception.arrays import Float
from guara_perception.calibration.board import BoardSpec, BoardView
from guara_perception.calibration.calibration import CameraModel
from guara_perception.exceptions import CalibrationRefused
from kinematics.arrays import FrozenArrays

MIN_VIEWS = 5
# The board normals of at least two views must differ by this angle; otherwise focal length and distance cannot be
# separated.
MIN_TILT = float(np.deg2rad(12.0))
# A view (for instance of a bent board) is an outlier if its error exceeds both this multiple of the median error and
# this many pixels.
OUTLIER_OF_MEDIAN = 3.0
OUTLIER_PX = 0.15
# Parameters of a camera in the order of OpenCV. Each distortion model estimates the first of them.
LENS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
DISTORTIONS = ("k1k2", "k1k2p1p2", "k1k2p1p2k3")
# Assumed standard deviations of a given lens, whose file states none: focal lengths (relative), principal point
# (relative to the image width), k1 and k2. The values are from a calibration with fourteen images (the recorded
# session).
GIVEN_FOCAL, GIVEN_CENTRE, GIVEN_DISTORTION = 4e-4, 3e-4, (5e-4, 1.1e-3)


@dataclass(frozen=True, slots=True)
class Intrinsics(FrozenArrays):
    """Camera model with its uncertainty, and the board views to which it was fitted or with which it was verified.

    Attributes:
        camera: camera model.
        free: names of the parameters with an uncertainty, in the order of `sigma`.
        sigma: standard deviations of fx, fy, cx, cy [px] and of the distortion coefficients; assumed if the model was
            given.
        views: views that were used.
        poses: (n, 6) transforms from board to camera in these views: rotation vector [rad] and translation [m].
        errors_px: (n,) rms corner error of each of these views [px].
        outliers: names of the omitted views, with the reasons.
        is_given: True if the model was given and the views only verify it.
    """

    camera: CameraModel
    free: tuple[str, ...]
    sigma: Float
    views: tuple[BoardView, ...]
    poses: Float
    errors_px: Float
    outliers: tuple[tuple[str, str], ...]
    is_given: bool = False

    @property
    def rms_px(self) -> float:
        """Root mean square of `errors_px` [px]."""
        return float(np.sqrt(np.mean(self.errors_px**2)))

    @property
    def tilt(self) -> float:
        """Largest angle between the board normals of two views [rad]."""
        normals = np.array([cv2.Rodrigues(pose[:3])[0][:, 2] for pose in self.poses])
        return float(np.arccos(np.clip(np.abs(normals @ normals.T), 0, 1).min()))


def free_parameters(distortion: str) -> tuple[str, ...]:
    """Names of the parameters that are estimated with a distortion model, one of DISTORTIONS."""
    return LENS[: 4 + len(distortion) // 2]


def calibrate_intrinsics(
    views: Sequence[BoardView],
    board: BoardSpec,
    size: tuple[int, int],
    distortion: str = "k1k2",
    keep: Sequence[str] = (),
) -> Intrinsics:
    """Estimate the lens; omit views that do not fit the others, and list them as outliers.

    Args:
        views: usable views.
        board: board in these views.
        size: image width and height [px].
        distortion: coefficients to estimate, one of DISTORTIONS; the others stay zero.
        keep: names of views that are never omitted (the board on the floor).

    Raises:
        CalibrationRefused: fewer than MIN_VIEWS views remain, or all boards are nearly parallel.
    """
    used = list(views)
    outliers: list[tuple[str, str]] = []
    while True:
        if len(used) < MIN_VIEWS:
            raise CalibrationRefused(
                f"{len(used)} usable board views; {MIN_VIEWS} or more are needed: take pictures of the board at "
                f"different positions, distances and tilts{_named(outliers)}"
            )
        result = calibrate_views(used, board, size, distortion, outliers)
        if result.tilt < MIN_TILT:
            raise CalibrationRefused(
                f"all {len(used)} board views are nearly parallel (largest tilt between two of them "
                f"{np.rad2deg(result.tilt):.1f} degrees, {np.rad2deg(MIN_TILT):.0f} needed): focal length and distance "
                "cannot be separated; tilt the board"
            )
        limit = max(OUTLIER_OF_MEDIAN * float(np.median(result.errors_px)), OUTLIER_PX)
        errors = np.where([view.name in keep for view in used], 0.0, result.errors_px)
        worst = int(np.argmax(errors))
        if errors[worst] <= limit:
            return result
        outliers.append((used[worst].name, f"corner error {errors[worst]:.2f} px (limit {limit:.2f} px)"))
        del used[worst]


def given_intrinsics(camera: CameraModel, views: Sequence[BoardView], board: BoardSpec) -> Intrinsics:
    """Intrinsics of a known lens, with the poses and corner errors of the board in the views, if any."""
    poses, errors = np.empty((len(views), 6)), np.empty(len(views))
    for i, view in enumerate(views):
        points = view.points(board)
        _, turn, shift = cv2.solvePnP(points, view.corners_px, camera.matrix, camera.distortion)
        seen, _ = cv2.projectPoints(points, turn, shift, camera.matrix, camera.distortion)
        poses[i] = np.r_[turn.ravel(), shift.ravel()]
        errors[i] = np.sqrt(((seen.reshape(-1, 2) - view.corners_px) ** 2).sum(axis=1).mean())
    focal = camera.matrix[[0, 1], [0, 1]] * GIVEN_FOCAL
    centre = [camera.size[0] * GIVEN_CENTRE] * 2
    return Intrinsics(
        camera=camera,
        free=free_parameters(DISTORTIONS[0]),
        sigma=np.r_[focal, centre, GIVEN_DISTORTION],
        views=tuple(views),
        poses=poses,
        errors_px=errors,
        outliers=(),
        is_given=True,
    )


def calibrate_views(
    views: Sequence[BoardView],
    board: BoardSpec,
    size: tuple[int, int],
    distortion: str,
    outliers: Sequence[tuple[str, str]] = (),
) -> Intrinsics:
    """Fit the lens to all given views; `outliers` are only copied to the result."""
    points = [np.asarray(view.points(board), dtype=np.float32) for view in views]
    corners = [np.asarray(view.corners_px, dtype=np.float32).reshape(-1, 1, 2) for view in views]
    free = free_parameters(distortion)
    flags = (0 if "p1" in free else cv2.CALIB_ZERO_TANGENT_DIST) | (0 if "k3" in free else cv2.CALIB_FIX_K3)
    guess, none = np.eye(3), np.zeros(5)
    _, matrix, lens, rotations, translations, sigma, _, errors = cv2.calibrateCameraExtended(
        points, corners, size, guess, none, flags=flags
    )
    return Intrinsics(
        camera=CameraModel(size, np.asarray(matrix, np.float64), np.ravel(lens)[:5].astype(np.float64)),
        free=free,
        sigma=np.ravel(sigma)[: len(free)].astype(np.float64),
        views=tuple(views),
        poses=np.hstack([np.reshape(rotations, (-1, 3)), np.reshape(translations, (-1, 3))]).astype(np.float64),
        errors_px=np.ravel(errors).astype(np.float64),
        outliers=tuple(outliers),
    )


def _named(outliers: Sequence[tuple[str, str]]) -> str:
    return "; left out: " + ", ".join(f"{name} ({reason})" for name, reason in outliers) if outliers else ""
