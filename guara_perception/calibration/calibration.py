"""Calibration of one rangefinder: camera and lens, mount on the robot, one laser plane per stripe."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from guara_perception.arrays import Float
from guara_perception.exceptions import CalibrationMismatch, InvalidInput
from kinematics.arrays import read_only

VERDICTS = ("good", "usable", "refused", "unknown")
# For k1 = -0.3 and k2 = 0.1, 8 fixed-point iterations leave 0.001 px at the corner; 30 converge to rounding error.
UNDISTORT_STEPS = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 1e-10)
# Least depth of a point in front of the camera.
NEAREST_DEPTH_M = 1e-6
# Number of points projected at once, so that intermediate results stay in the CPU cache.
BLOCK = 2048
# Largest image side, so that a wrong size in a file cannot exhaust the memory.
LARGEST_SIDE_PX = 8192


@dataclass(frozen=True, slots=True)
class StripePlane:
    """One laser plane.

    Attributes:
        index: number in the standard pattern (0 ... 69 for the Guará).
        mirror_angle: commanded mirror angle [rad]; 0 if the laser points straight down, positive if it points forward.
        plane: (4,) float64, n . X + d = 0 in the camera frame [m], n a unit vector.
    """

    index: int
    mirror_angle: float
    plane: Float

    def __post_init__(self) -> None:
        """Check the plane, make it read-only, and normalise its normal, which must have nearly unit length."""
        plane = np.array(self.plane, dtype=np.float64)
        if plane.shape != (4,) or not np.isfinite(plane).all():
            raise InvalidInput(f"plane of stripe {self.index}: {plane.tolist()} must be 4 finite numbers")
        length = float(np.linalg.norm(plane[:3]))
        if abs(length - 1) > 1e-3:
            raise InvalidInput(f"plane of stripe {self.index}: the normal has length {length:.4f}, it must be 1")
        # A unit normal is kept as it is: normalising it again could change the last bit and thereby the content hash.
        object.__setattr__(self, "plane", read_only(plane / length if abs(length - 1) > 1e-9 else plane))


def plane_in_frame(plane_in_camera: Float, transform_camera_to_frame: Float) -> Float:
    """Transform a plane (4,) n . X + d = 0, or planes (s, 4), from the camera frame to another frame."""
    rotation, translation = transform_camera_to_frame[:3, :3], transform_camera_to_frame[:3, 3]
    normal = plane_in_camera[..., :3] @ rotation.T
    return np.concatenate((normal, plane_in_camera[..., 3:] - (normal @ translation)[..., None]), axis=-1)


@dataclass(frozen=True, slots=True)
class Calibration:
    """Calibration of a rangefinder: camera, mount and laser planes (docs/files.md).

    Attributes:
        robot: name of the robot that carries the rangefinder.
        camera: intrinsic model.
        transform_camera_to_base: (4, 4) float64, camera_optical_frame to base_link.
        stripes: laser planes, ascending by index.
        mirror: parameters of the mirror model over all stripes, or None.
        paper: the paper's constants (homography, H, nadir, n, d, k per stripe), or None.
        covariance: covariances of the parameters, or None.
        quality: verdict (`good`, `usable`, `refused`, `unknown`), the reasons for it, and other results of its checks.
        created: time of creation, as ISO 8601 text; "simulated" for a simulated rangefinder; otherwise empty before the
            calibration is saved.
        hash: content hash, hexadecimal; empty before the calibration is saved, except for a simulated rangefinder.
    """

    robot: str
    camera: CameraModel
    transform_camera_to_base: Float
    stripes: tuple[StripePlane, ...]
    mirror: Mapping[str, Any] | None = None
    paper: Mapping[str, Any] | None = None
    covariance: Mapping[str, Any] | None = None
    quality: Mapping[str, Any] = field(default_factory=lambda: {"verdict": "unknown", "reasons": []})
    created: str = ""
    hash: str = ""

    def __post_init__(self) -> None:
        transform = read_only(np.array(self.transform_camera_to_base, dtype=np.float64))
        check_transform(transform, "transform_camera_to_base")
        stripes = tuple(sorted(self.stripes, key=lambda stripe: stripe.index))
        indices = [stripe.index for stripe in stripes]
        if len(indices) < 2:
            raise InvalidInput(f"calibration has {len(indices)} stripes; 2 or more are needed")
        if len(set(indices)) != len(indices):
            twice = sorted({i for i in indices if indices.count(i) > 1})
            raise InvalidInput(f"calibration has stripe index {twice} more than once; each index must be unique")
        if indices[0] < 0:
            raise InvalidInput(f"calibration has stripe index {indices[0]}; indices start at 0")
        if self.quality.get("verdict") not in VERDICTS:
            raise InvalidInput(f"quality verdict is {self.quality.get('verdict')!r}, allowed: {', '.join(VERDICTS)}")
        object.__setattr__(self, "transform_camera_to_base", transform)
        object.__setattr__(self, "stripes", stripes)

    @property
    def indices(self) -> tuple[int, ...]:
        """Indices of the calibrated stripes, ascending."""
        return tuple(stripe.index for stripe in self.stripes)

    def stripe(self, index: int) -> StripePlane:
        """Laser plane of a stripe, by index.

        Raises:
            CalibrationMismatch: the calibration has no stripe with this index.
        """
        for stripe in self.stripes:
            if stripe.index == index:
                return stripe
        raise CalibrationMismatch(
            f"stripe index {index} is not in the calibration, which holds {format_indices(self.indices)}"
        )


def check_identity(found: str, expected: str, what: str) -> None:
    """Reject a camera that is known to differ from the calibrated one.

    Args:
        found: identity of the camera; empty if unknown, which is accepted.
        expected: identity of the calibrated camera; empty if unknown, which is accepted.
        what: beginning of the message, such as the file that names `found`.

    Raises:
        CalibrationMismatch: the identities differ.
    """
    if found and expected and found != expected:
        raise CalibrationMismatch(
            f"{what}: camera {found!r}, but the calibrated camera is {expected!r}: connect the calibrated camera, or "
            "give a calibration of this one (`guara record` and `guara calibrate` make it)"
        )


def check_transform(transform: Float, name: str) -> None:
    """Reject a matrix that is not a rigid 4x4 transform.

    Raises:
        InvalidInput: wrong shape, a value that is not finite, or not a rigid transform.
    """
    if transform.shape != (4, 4) or not np.isfinite(transform).all():
        raise InvalidInput(f"{name} has shape {transform.shape}, it must be 4x4 and finite")
    rotation = transform[:3, :3]
    rigid = np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-4) and np.linalg.det(rotation) > 0
    if not rigid or not np.allclose(transform[3], (0, 0, 0, 1)):
        raise InvalidInput(
            f"{name} is not a rigid transform; its rotation must be orthonormal with det +1, its last row 0 0 0 1"
        )


def format_indices(indices: tuple[int, ...]) -> str:
    """Format indices as a range such as `0 ... 69` or `0, 2 ... 68` if they are evenly spaced, else as a list."""
    strides = set(np.diff(indices).tolist())
    if len(strides) == 1 and len(indices) > 2:
        first = str(indices[0]) if strides == {1} else f"{indices[0]}, {indices[1]}"
        return f"{first} ... {indices[-1]}"
    return ", ".join(map(str, indices))


@dataclass(frozen=True, slots=True)
class CameraModel:
    """Intrinsic calibration, eq. 1 of the paper with the lens model that OpenCV uses.

    Attributes:
        size: image width and height [px].
        matrix: (3, 3) float64, focal lengths and principal point [px].
        distortion: (5,) float64, k1, k2, p1, p2, k3.
        identity: maker, model and serial number as reported by the camera; empty if unknown.
    """

    size: tuple[int, int]
    matrix: Float
    distortion: Float
    identity: str = ""

    def __post_init__(self) -> None:
        matrix = read_only(np.array(self.matrix, dtype=np.float64))
        distortion = read_only(np.array(self.distortion, dtype=np.float64).ravel())
        if len(self.size) != 2 or not all(16 <= n <= LARGEST_SIDE_PX and n == int(n) for n in self.size):
            raise InvalidInput(
                f"camera size is {tuple(int(n) if n % 1 == 0 else n for n in self.size)}, it must be (width, height), "
                f"integers from 16 to {LARGEST_SIDE_PX} px"
            )
        if matrix.shape != (3, 3) or not np.isfinite(matrix).all():
            raise InvalidInput(f"camera matrix has shape {matrix.shape}, it must be 3x3 and finite")
        if matrix[0, 0] <= 0 or matrix[1, 1] <= 0 or not np.allclose(matrix[2], (0, 0, 1)):
            raise InvalidInput("camera matrix must have positive focal lengths and a last row of 0 0 1")
        if matrix[0, 1] != 0 or matrix[1, 0] != 0:
            raise InvalidInput("camera matrix has a skew; the camera model has none, so elements 01 and 10 must be 0")
        if distortion.shape != (5,) or not np.isfinite(distortion).all():
            raise InvalidInput(
                f"camera distortion has {distortion.size} values; 5 finite ones are needed (k1, k2, p1, p2, k3)"
            )
        object.__setattr__(self, "size", (int(self.size[0]), int(self.size[1])))
        object.__setattr__(self, "matrix", matrix)
        object.__setattr__(self, "distortion", distortion)

    def rays(self, points_px: npt.ArrayLike) -> Float:
        """Viewing rays of pixels, (n, 3) float64 in the camera frame with z = 1.

        The point seen by a pixel is its depth (rho in eq. 3) times the ray of the pixel.

        Args:
            points_px: (n, 2) distorted pixel positions (u, v), as delivered by the camera.
        """
        points = np.ascontiguousarray(points_px, dtype=np.float64).reshape(-1, 1, 2)
        if not len(points):
            return np.empty((0, 3))
        flat = cv2.undistortPoints(points, self.matrix, self.distortion, criteria=UNDISTORT_STEPS)[:, 0]
        return np.column_stack((flat, np.ones(len(flat))))

    def project(self, points_in_camera: npt.ArrayLike) -> Float:
        """Distorted pixels (n, 2) of points (n, 3) in the camera frame; NaN behind the camera or beyond `fold_radius`.

        Beyond `fold_radius`, the Brown model folds back: the distorted radius decreases, and a point far outside the
        image would appear inside it.
        """
        points = np.asarray(points_in_camera, dtype=np.float64).reshape(-1, 3)
        pixels = np.empty((len(points), 2))
        for start in range(0, len(points), BLOCK):
            part = slice(start, start + BLOCK)
            pixels[part] = self._project(np.ascontiguousarray(points[part].T)).T
        return pixels

    def _project(self, points: Float) -> Float:
        """Pixels (2, n) of points (3, n); several times as fast as cv2.projectPoints, due to contiguous coordinates."""
        depth = np.where(points[2] > NEAREST_DEPTH_M, points[2], np.nan)
        x, y = points[:2] / depth
        radius = x * x + y * y
        k1, k2, p1, p2, k3 = self.distortion
        with np.errstate(over="ignore", invalid="ignore"):
            stretch = 1 + radius * (k1 + radius * (k2 + radius * k3))
            twist = 2 * x * y
            u = x * stretch + p1 * twist + p2 * (radius + 2 * x * x)
            v = y * stretch + p1 * (radius + 2 * y * y) + p2 * twist
            is_folded = ~(radius < self.fold_radius() ** 2)
        pixels = np.empty((2, depth.size))
        pixels[0] = self.matrix[0, 0] * u + self.matrix[0, 2]
        pixels[1] = self.matrix[1, 1] * v + self.matrix[1, 2]
        pixels[:, is_folded] = np.nan
        return pixels

    def fold_radius(self) -> float:
        """Undistorted radius (tangent of the field angle) above which the radial model is not monotonic.

        Infinite if the model is monotonic up to a radius of 4.
        """
        k1, k2, _, _, k3 = self.distortion.tolist()
        return _fold_radius(k1, k2, k3)


@lru_cache(maxsize=16)
def _fold_radius(k1: float, k2: float, k3: float) -> float:
    radius = np.linspace(0.0, 4.0, 2001)
    growth = 1 + 3 * k1 * radius**2 + 5 * k2 * radius**4 + 7 * k3 * radius**6
    falling = np.flatnonzero(growth <= 0)
    return float(radius[falling[0]]) if falling.size else np.inf


def floor_pixels(
    camera: CameraModel, transform_camera_to_footprint: Float, points: Float, height: float = 0.0
) -> Float:
    """Pixels (n, 2) of points (n, 2), x and y in base_footprint [m], on the plane z = `height` [m].

    NaN as in `CameraModel.project`.
    """
    rotation, translation = transform_camera_to_footprint[:3, :3], transform_camera_to_footprint[:3, 3]
    in_footprint = np.column_stack((points, np.full(len(points), height)))
    return camera.project((in_footprint - translation) @ rotation)


def to_floor(camera: CameraModel, transform_camera_to_footprint: Float, pixels: Float, height: float = 0.0) -> Float:
    """Points (n, 2), x and y in base_footprint [m], at which rays of pixels (n, 2) meet the plane z = `height` [m]."""
    rotation, translation = transform_camera_to_footprint[:3, :3], transform_camera_to_footprint[:3, 3]
    rays = camera.rays(pixels) @ rotation.T
    depth = (height - translation[2]) / rays[:, 2]
    return translation[:2] + rays[:, :2] * depth[:, None]
