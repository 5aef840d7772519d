"""Bundle adjustment of lens, board poses and camera mount over all board corners and crosses, with covariance."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from guara_perception.arrays import Float
from guara_perception.calibration.board import BoardSpec
from guara_perception.calibration.calibration import CameraModel
from guara_perception.calibration.intrinsics import Intrinsics
from guara_perception.calibration.mount import FloorPose
from kinematics.arrays import FrozenArrays

# Scale of the robust loss (soft L1) [standard deviations].
ROBUST_SIGMAS = 3.0
# Lower bound of the estimated standard deviation of a corner's coordinate.
LEAST_SIGMA_PX = 0.01
# Column of each lens parameter in the Jacobian of cv2.projectPoints, after the six columns of the pose.
LENS_COLUMNS = {"fx": 6, "fy": 7, "cx": 8, "cy": 9, "k1": 10, "k2": 11, "p1": 12, "p2": 13, "k3": 14}


@dataclass(frozen=True, slots=True)
class CameraFit(FrozenArrays):
    """Result of the bundle adjustment: camera and mount with their joint covariance.

    Attributes:
        camera: intrinsic model.
        free: names of the estimated lens parameters; for a given lens, of those with an assumed error.
        transform_camera_to_footprint: (4, 4) pose of the camera.
        covariance: (n + 6, n + 6) covariance of the lens parameters in the order of `free` ([px] and [-]), followed by
            `pose`.
        pose: (6,) transform from footprint to camera: rotation vector [rad] and translation [m].
        corner_sigma_px: standard deviation of one corner coordinate [px].
        residuals_px: corner residuals (n, 2) of each view used, in the order of the views.
        mark_residuals_px: (m, 2) residuals of the crosses.
    """

    camera: CameraModel
    free: tuple[str, ...]
    transform_camera_to_footprint: Float
    covariance: Float
    pose: Float
    corner_sigma_px: float
    residuals_px: tuple[Float, ...]
    mark_residuals_px: Float

    @property
    def lens(self) -> Float:
        """Values of the lens parameters `free`, in their order."""
        return _lens_of(self.camera)[[LENS_COLUMNS[name] - 6 for name in self.free]]

    def moved(self) -> Iterator[tuple[float, CameraModel, Float]]:
        """Change each parameter in turn by its sigma; yield sigma, camera and (4, 4) transform_camera_to_footprint."""
        n, sigmas = len(self.free), np.sqrt(np.diag(self.covariance))
        for sigma, change in zip(sigmas.tolist(), np.diag(sigmas), strict=True):
            lens = _lens_of(self.camera)
            lens[[LENS_COLUMNS[name] - 6 for name in self.free]] += change[:n]
            yield sigma, _camera_of(self.camera.size, lens), _inverse_of(self.pose + change[n:])


def fit_camera(
    intrinsics: Intrinsics, board: BoardSpec, ground: str | None, floor: FloorPose, points: Float
) -> CameraFit:
    """Fit lens, board poses and mount jointly to all images of boards and crosses.

    The ground board lies in the plane z = 0 and thereby couples lens and mount; its position and heading on the floor
    are estimated. A given lens is not changed, but its assumed errors are propagated to the mount.

    Args:
        intrinsics: initial estimate, with the views.
        board: the board.
        ground: name of the view that shows the board on the floor; None or a name that is not among the views = no
            ground board.
        floor: initial estimate of the mount, and the crosses found in the image.
        points: (m, 2) positions of the crosses in base_footprint [m].
    """
    problem = _Problem(intrinsics, board, ground, floor, points)
    x = problem.start()
    has_views = bool(intrinsics.views)
    sigma = max(intrinsics.rms_px / np.sqrt(2), LEAST_SIGMA_PX) if has_views else LEAST_SIGMA_PX
    for _ in range(3):
        x = problem.solve(x, sigma)
        if has_views:
            corner_residuals = np.concatenate([r.ravel() for r in problem.view_residuals(x)])
            sigma = max(1.4826 * float(np.median(np.abs(corner_residuals))), LEAST_SIGMA_PX)
    jacobian = problem.jacobian(x) * problem.weights(x, sigma)[:, None]
    covariance = _covariance(jacobian.T @ jacobian, intrinsics)
    kept = np.r_[0 : problem.n_lens, problem.pose_columns]
    lens = problem.lens(x)
    return CameraFit(
        camera=_camera_of(intrinsics.camera.size, lens),
        free=intrinsics.free,
        transform_camera_to_footprint=_inverse_of(x[problem.pose_columns]),
        covariance=covariance[np.ix_(kept, kept)],
        pose=x[problem.pose_columns].copy(),
        corner_sigma_px=sigma,
        residuals_px=tuple(problem.view_residuals(x)),
        mark_residuals_px=problem.mark_residuals(x),
    )


def _covariance(normal: Float, intrinsics: Intrinsics) -> Float:
    """Covariance of all parameters from their normal matrix.

    An error e of a given lens changes the other parameters, which are fitted to the images, by -G e (G: `gain`).
    """
    if not intrinsics.is_given:
        return np.asarray(np.linalg.inv(normal), dtype=np.float64)
    n = len(intrinsics.free)
    lens, rest = np.diag(intrinsics.sigma**2), np.linalg.inv(normal[n:, n:])
    gain = rest @ normal[n:, :n]
    return np.block([[lens, -lens @ gain.T], [-gain @ lens, rest + gain @ lens @ gain.T]])


class _Problem:
    """Least-squares problem with the unknowns x: lens, pose of footprint in camera, ground board, other boards.

    The ground board has three unknowns (x, y, heading), any other board the six of a pose.
    """

    def __init__(
        self, intrinsics: Intrinsics, board: BoardSpec, ground: str | None, floor: FloorPose, points: Float
    ) -> None:
        self.intrinsics = intrinsics
        self.objects = [view.points(board) for view in intrinsics.views]
        self.floor = floor
        self.points = np.column_stack((points, np.zeros(len(points))))
        self.pixels = np.array([mark.centre_px for mark in floor.marks])
        self.mark_sigma = np.array([mark.sigma_px for mark in floor.marks])
        names = [view.name for view in intrinsics.views]
        self.ground = names.index(ground) if ground in names else None
        self.n_lens = len(intrinsics.free)
        self.lens_columns = np.array([LENS_COLUMNS[name] for name in intrinsics.free])
        self.pose_columns = slice(self.n_lens, self.n_lens + 6)
        self.ground_columns = slice(self.n_lens + 6, self.n_lens + 9)
        self.free_views = [i for i in range(len(names)) if i != self.ground]
        self.size = self.n_lens + 9 + 6 * len(self.free_views)
        self.moved = slice(self.n_lens if intrinsics.is_given else 0, self.size)

    def start(self) -> Float:
        x = np.zeros(self.size)
        x[: self.n_lens] = _lens_of(self.intrinsics.camera)[self.lens_columns - 6]
        to_camera = np.linalg.inv(self.floor.transform_camera_to_footprint)
        x[self.pose_columns] = np.r_[np.ravel(cv2.Rodrigues(to_camera[:3, :3])[0]), to_camera[:3, 3]]
        if self.ground is not None:
            pose = self.intrinsics.poses[self.ground]
            rotation = to_camera[:3, :3].T @ cv2.Rodrigues(pose[:3])[0]
            position = to_camera[:3, :3].T @ (pose[3:] - to_camera[:3, 3])
            x[self.ground_columns] = np.r_[position[:2], np.arctan2(rotation[1, 0], rotation[0, 0])]
            self.flip = np.sign(rotation[2, 2])
        for k, i in enumerate(self.free_views):
            x[self.view_columns(k)] = self.intrinsics.poses[i]
        return x

    def view_columns(self, k: int) -> slice:
        first = self.n_lens + 9 + 6 * k
        return slice(first, first + 6)

    def lens(self, x: Float) -> Float:
        lens = _lens_of(self.intrinsics.camera)
        lens[self.lens_columns - 6] = x[: self.n_lens]
        return lens

    def ground_points(self, x: Float) -> tuple[Float, Float]:
        """Visible corners of the ground board in base_footprint, and their derivatives with respect to its heading."""
        assert self.ground is not None
        on_board = self.objects[self.ground]
        px, py, heading = x[self.ground_columns]
        c, s = np.cos(heading), np.sin(heading)
        a, b = on_board[:, 0], self.flip * on_board[:, 1]
        zero = np.zeros(len(a))
        return np.column_stack((px + c * a - s * b, py + s * a + c * b, zero)), np.column_stack(
            (-s * a - c * b, c * a - s * b, zero)
        )

    def project(self, x: Float, points: Float, pose: Float) -> tuple[Float, Float]:
        camera = _camera_of(self.intrinsics.camera.size, self.lens(x))
        pixels, jacobian = cv2.projectPoints(points, pose[:3], pose[3:], camera.matrix, camera.distortion)
        return np.asarray(pixels, np.float64).reshape(-1, 2), np.asarray(jacobian, np.float64)

    def blocks(self, x: Float) -> list[tuple[Float, Float]]:
        """Residuals (n, 2) and Jacobian (2 n, size) of every view in order, then those of the crosses."""
        result = []
        views = self.intrinsics.views
        for i, view in enumerate(views):
            rows = np.zeros((2 * len(self.objects[i]), self.size))
            if i == self.ground:
                points, by_heading = self.ground_points(x)
                columns, pose = self.pose_columns, x[self.pose_columns]
            else:
                points, columns = self.objects[i], self.view_columns(self.free_views.index(i))
                pose = x[columns]
            pixels, jacobian = self.project(x, points, pose)
            rows[:, : self.n_lens] = jacobian[:, self.lens_columns]
            rows[:, columns] = jacobian[:, :6]
            if i == self.ground:
                by_point = jacobian[:, 3:6] @ cv2.Rodrigues(pose[:3])[0]
                rows[:, self.ground_columns.start : self.ground_columns.start + 2] = by_point[:, :2]
                rows[:, self.ground_columns.stop - 1] = (by_point * np.repeat(by_heading, 2, axis=0)).sum(axis=1)
            result.append((pixels - view.corners_px, rows))
        pixels, jacobian = self.project(x, self.points, x[self.pose_columns])
        rows = np.zeros((2 * len(self.points), self.size))
        rows[:, : self.n_lens] = jacobian[:, self.lens_columns]
        rows[:, self.pose_columns] = jacobian[:, :6]
        result.append((pixels - self.pixels, rows))
        return result

    def view_residuals(self, x: Float) -> list[Float]:
        return [residual for residual, _ in self.blocks(x)[:-1]]

    def mark_residuals(self, x: Float) -> Float:
        return self.blocks(x)[-1][0]

    def jacobian(self, x: Float) -> Float:
        rows = np.vstack([jacobian for _, jacobian in self.blocks(x)])
        if self.ground is None:
            # Without a view of the ground board, its three unknowns are pinned to zero.
            pins = np.zeros((3, self.size))
            pins[:, self.ground_columns] = np.eye(3)
            rows = np.vstack((rows, pins))
        return rows

    def weights(self, x: Float, sigma: float) -> Float:
        """Factors of the residuals: 1 / sigma times the square root of the soft-L1 weight."""
        corners = np.concatenate([np.empty(0), *(r.ravel() for r in self.view_residuals(x))]) / sigma
        marks = self.mark_residuals(x).ravel() / np.repeat(self.mark_sigma, 2)
        loss = [(1 + (r / ROBUST_SIGMAS) ** 2) ** -0.25 for r in (corners, marks)]
        pins = [] if self.ground is not None else [np.ones(3)]
        return np.concatenate([loss[0] / sigma, loss[1] / np.repeat(self.mark_sigma, 2), *pins])

    def residual(self, x: Float) -> Float:
        pins = [] if self.ground is not None else [x[self.ground_columns]]
        return np.concatenate([r.ravel() for r, _ in self.blocks(x)] + pins)

    def solve(self, x: Float, sigma: float) -> Float:
        """Run at most six Gauss-Newton iterations, which suffice if the initial residuals are below a pixel."""
        for _ in range(6):
            weight = self.weights(x, sigma)
            rows = self.jacobian(x)[:, self.moved] * weight[:, None]
            scale = np.linalg.norm(rows, axis=0)
            rows = rows / scale
            update = np.linalg.solve(rows.T @ rows, -rows.T @ (self.residual(x) * weight)) / scale
            x[self.moved] += update
            if float(np.abs(update * scale).max()) < 1e-4:
                break
        return x


def _lens_of(camera: CameraModel) -> Float:
    """Lens parameters (9,): fx, fy, cx, cy, k1, k2, p1, p2, k3."""
    matrix = camera.matrix
    return np.r_[matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], camera.distortion]


def _camera_of(size: tuple[int, int], lens: Float) -> CameraModel:
    return CameraModel(size, np.array([[lens[0], 0, lens[2]], [0, lens[1], lens[3]], [0, 0, 1.0]]), lens[4:].copy())


def _inverse_of(pose: Float) -> Float:
    """Transform (4, 4) from camera to footprint, the inverse of a pose (6,) from footprint to camera."""
    transform = np.eye(4)
    rotation = cv2.Rodrigues(np.asarray(pose[:3], dtype=np.float64))[0]
    transform[:3, :3] = rotation.T
    transform[:3, 3] = -rotation.T @ pose[3:]
    return transform
