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
from guara_perception.calibration.mount import FloorPose, pose_of_camera
from kinematics.arrays import FrozenArrays
from kinematics.transforms import inverse

# Scale of the robust loss (soft L1) [standard deviations].
ROBUST_SIGMAS = 3.0
# Lower bound of the estimated standard deviation of a corner's coordinate.
LEAST_SIGMA_PX = 0.01


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
        return _lens_of(self.camera)[: len(self.free)]

    def moved(self) -> Iterator[tuple[float, CameraModel, Float]]:
        """Change each parameter in turn by its sigma; yield sigma, camera and (4, 4) transform_camera_to_footprint."""
        n, sigmas = len(self.free), np.sqrt(np.diag(self.covariance))
        for sigma, change in zip(sigmas.tolist(), np.diag(sigmas), strict=True):
            lens = _lens_of(self.camera)
            lens[:n] += change[:n]
            yield sigma, _camera_of(self.camera.size, lens), pose_of_camera(*np.split(self.pose + change[n:], 2))


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
    sigma = max(intrinsics.rms_px / np.sqrt(2), LEAST_SIGMA_PX) if intrinsics.views else LEAST_SIGMA_PX
    for _ in range(3):
        x = problem.solve(x, sigma)
        residual, jacobian = problem.linearise(x)
        if intrinsics.views:
            sigma = max(1.4826 * float(np.median(np.abs(residual[: problem.n_corner]))), LEAST_SIGMA_PX)
    rows = jacobian * problem.weights(residual, sigma)[:, None]
    kept, pose = problem.pose_columns.stop, x[problem.pose_columns]
    *corner_residuals, mark_residuals = np.split(residual.reshape(-1, 2), problem.ends)
    return CameraFit(
        camera=_camera_of(intrinsics.camera.size, problem.lens(x)),
        free=intrinsics.free,
        transform_camera_to_footprint=pose_of_camera(*np.split(pose, 2)),
        covariance=_covariance(rows.T @ rows, intrinsics)[:kept, :kept],
        pose=pose,
        corner_sigma_px=sigma,
        residuals_px=tuple(corner_residuals),
        mark_residuals_px=mark_residuals,
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

    The ground board, if there is one, has three unknowns (x, y, heading), any other board the six of a pose.
    """

    def __init__(
        self, intrinsics: Intrinsics, board: BoardSpec, ground: str | None, floor: FloorPose, points: Float
    ) -> None:
        self.intrinsics, self.floor = intrinsics, floor
        names = [view.name for view in intrinsics.views]
        self.ground = names.index(ground) if ground in names else None
        # Points and pixels of each view, and of the crosses.
        self.seen = [(view.points(board), view.corners_px) for view in intrinsics.views]
        self.ends = np.cumsum([len(pixels) for _, pixels in self.seen], dtype=np.intp)
        self.n_corner = 2 * sum(len(pixels) for _, pixels in self.seen)
        crosses = np.column_stack((points, np.zeros(len(points))))
        self.seen.append((crosses, np.array([mark.centre_px for mark in floor.marks])))
        self.mark_sigma = np.repeat([mark.sigma_px for mark in floor.marks], 2)
        self.n_lens = len(intrinsics.free)
        self.pose_columns = slice(self.n_lens, self.n_lens + 6)
        first = self.n_lens + (6 if self.ground is None else 9)
        self.ground_columns = slice(self.n_lens + 6, first)
        free_views = [i for i in range(len(names)) if i != self.ground]
        self.view_columns = {i: slice(first + 6 * k, first + 6 * k + 6) for k, i in enumerate(free_views)}
        self.size = first + 6 * len(free_views)
        self.moved = slice(self.n_lens if intrinsics.is_given else 0, self.size)

    def start(self) -> Float:
        x = np.zeros(self.size)
        x[: self.n_lens] = _lens_of(self.intrinsics.camera)[: self.n_lens]
        to_camera = inverse(self.floor.transform_camera_to_footprint)
        x[self.pose_columns] = np.r_[np.ravel(cv2.Rodrigues(to_camera[:3, :3])[0]), to_camera[:3, 3]]
        if self.ground is not None:
            pose = self.intrinsics.poses[self.ground]
            rotation = to_camera[:3, :3].T @ cv2.Rodrigues(pose[:3])[0]
            position = to_camera[:3, :3].T @ (pose[3:] - to_camera[:3, 3])
            x[self.ground_columns] = np.r_[position[:2], np.arctan2(rotation[1, 0], rotation[0, 0])]
            self.flip = np.sign(rotation[2, 2])
        for i, columns in self.view_columns.items():
            x[columns] = self.intrinsics.poses[i]
        return x

    def lens(self, x: Float) -> Float:
        lens = _lens_of(self.intrinsics.camera)
        lens[: self.n_lens] = x[: self.n_lens]
        return lens

    def ground_points(self, x: Float, on_board: Float) -> tuple[Float, Float]:
        """Corners of the ground board in base_footprint, and their derivatives with respect to its heading."""
        px, py, heading = x[self.ground_columns]
        c, s = np.cos(heading), np.sin(heading)
        a, b = on_board[:, 0], self.flip * on_board[:, 1]
        zero = np.zeros(len(a))
        points = np.column_stack((px + c * a - s * b, py + s * a + c * b, zero))
        return points, np.column_stack((-s * a - c * b, c * a - s * b, zero))

    def linearise(self, x: Float) -> tuple[Float, Float]:
        """Residuals (r,) of all views in order and of the crosses, u and v alternating, and Jacobian (r, size)."""
        camera = _camera_of(self.intrinsics.camera.size, self.lens(x))
        residuals, jacobians = [], []
        for i, (points, pixels) in enumerate(self.seen):
            columns = self.view_columns.get(i, self.pose_columns)
            rotation, translation = x[columns][:3], x[columns][3:]
            if i == self.ground:
                points, by_heading = self.ground_points(x, points)
            projected, jacobian = cv2.projectPoints(points, rotation, translation, camera.matrix, camera.distortion)
            rows = np.zeros((2 * len(points), self.size))
            # Six columns of the pose, followed by those of the lens.
            rows[:, : self.n_lens] = jacobian[:, 6 : 6 + self.n_lens]
            rows[:, columns] = jacobian[:, :6]
            if i == self.ground:
                by_point = jacobian[:, 3:6] @ cv2.Rodrigues(rotation)[0]
                turned = (by_point * np.repeat(by_heading, 2, axis=0)).sum(axis=1)
                rows[:, self.ground_columns] = np.column_stack((by_point[:, :2], turned))
            residuals.append(projected.ravel() - pixels.ravel())
            jacobians.append(rows)
        return np.concatenate(residuals), np.vstack(jacobians)

    def weights(self, residual: Float, sigma: float) -> Float:
        """Factors of the residuals: 1 / sigma times the square root of the soft-L1 weight."""
        sigmas = np.concatenate((np.full(self.n_corner, sigma), self.mark_sigma))
        return np.asarray((1 + (residual / sigmas / ROBUST_SIGMAS) ** 2) ** -0.25 / sigmas)

    def solve(self, x: Float, sigma: float) -> Float:
        """Run at most six Gauss-Newton iterations, which suffice if the initial residuals are below a pixel."""
        for _ in range(6):
            residual, jacobian = self.linearise(x)
            weight = self.weights(residual, sigma)
            rows = jacobian[:, self.moved] * weight[:, None]
            scale = np.linalg.norm(rows, axis=0)
            rows = rows / scale
            update = np.linalg.solve(rows.T @ rows, -rows.T @ (residual * weight)) / scale
            x[self.moved] += update
            if float(np.abs(update * scale).max()) < 1e-4:
                break
        return x


def _lens_of(camera: CameraModel) -> Float:
    """Values (9,) of the parameters of a camera, in the order of `intrinsics.LENS`."""
    matrix = camera.matrix
    return np.r_[matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], camera.distortion]


def _camera_of(size: tuple[int, int], lens: Float) -> CameraModel:
    return CameraModel(size, np.array([[lens[0], 0, lens[2]], [0, lens[1], lens[3]], [0, 0, 1.0]]), lens[4:].copy())
