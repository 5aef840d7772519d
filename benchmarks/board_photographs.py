"""Both methods on photographs of a laser line on a board: the plane of 11 board poses, judged on the twelfth.

The folder holds calib0 ... 11.jpg with the laser off, and light0 ... 11.jpg.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

import guara_perception as gp
from guara_perception.arrays import Float

POSES = 12
DOTS = (7, 7)
PITCH_MM = 37.5
FIT_ROUNDS = 6


@dataclass(frozen=True)
class Pose:
    """What one pair of photographs gives.

    Attributes:
        points_mm: (n, 3) stripe points on the board, in the camera frame.
        columns: number of columns in which the stripe's line crosses the mask.
        known: number of these in which the stripe has a position.
    """

    points_mm: Float
    columns: int
    known: int


@dataclass(frozen=True)
class Board:
    """Camera model and board poses of the photographs."""

    matrix: Float
    distortion: Float
    poses: list[tuple[Float, Float]]
    dots: list[Float]


def calibrate(folder: Path) -> Board:
    """Calibrate the camera from the photographs without laser."""
    parameters = cv2.SimpleBlobDetector.Params()
    parameters.maxArea = 20000
    parameters.minDistBetweenBlobs = 5
    detector = cv2.SimpleBlobDetector.create(parameters)
    grid = np.zeros((DOTS[0] * DOTS[1], 3), np.float32)
    grid[:, :2] = np.mgrid[: DOTS[0], : DOTS[1]].T.reshape(-1, 2) * PITCH_MM
    dots = []
    size = (0, 0)
    for i in range(POSES):
        picture = cv2.imread(str(folder / f"calib{i}.jpg"), cv2.IMREAD_GRAYSCALE)
        if picture is None:
            raise SystemExit(f"{folder}: calib{i}.jpg is missing")
        size = (picture.shape[1], picture.shape[0])
        found, centres = cv2.findCirclesGrid(picture, DOTS, flags=cv2.CALIB_CB_SYMMETRIC_GRID, blobDetector=detector)
        if not found:
            raise SystemExit(f"{folder}: no {DOTS[0]}x{DOTS[1]} dots in calib{i}.jpg")
        dots.append(centres.reshape(-1, 2))
    rms, matrix, distortion, turns, shifts = cv2.calibrateCamera(
        [grid] * POSES, [d.reshape(-1, 1, 2) for d in dots], size, np.eye(3), np.zeros(5), flags=cv2.CALIB_FIX_K3
    )
    print(f"camera: rms {rms:.3f} px, f {matrix[0, 0]:.1f} {matrix[1, 1]:.1f}")
    poses = [
        (np.asarray(cv2.Rodrigues(turn)[0], np.float64), np.asarray(shift, np.float64).ravel())
        for turn, shift in zip(turns, shifts, strict=True)
    ]
    camera, lens = np.asarray(matrix, np.float64), np.asarray(distortion, np.float64).ravel()
    return Board(camera, lens, poses, [np.asarray(d, np.float64) for d in dots])


def mask_of(dots: Float, shape: tuple[int, int]) -> npt.NDArray[np.uint8]:
    """Picture mask: hull of the dots, grown by half a pitch."""
    hull = cv2.convexHull(dots.astype(np.float32)).reshape(-1, 2)
    spacing = np.linalg.norm(dots[1] - dots[0])
    mask = np.zeros(shape, np.uint8)
    cv2.fillConvexPoly(mask, np.rint(hull).astype(np.int32), 1)
    radius = int(round(spacing / 2))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
    return np.asarray(cv2.dilate(mask, disc), np.uint8)


def points_on_board(folder: Path, board: Board, i: int, method: str) -> Pose:
    """Extract one stripe and put its points on the board's plane."""
    on, off = (cv2.imread(str(folder / f"{name}{i}.jpg")) for name in ("light", "calib"))
    if on is None or off is None:
        raise SystemExit(f"{folder}: light{i}.jpg or calib{i}.jpg is missing")
    profile = gp.extract_stripe(on, off, method=method)
    mask = mask_of(board.dots[i], on.shape[:2])
    columns = np.arange(on.shape[1])
    rows = profile.position_px.astype(np.float64)
    known = np.isfinite(rows)
    inside = known.copy()
    inside[known] = mask[np.clip(np.rint(rows[known]).astype(int), 0, on.shape[0] - 1), columns[known]] > 0
    line = robust_line(columns[inside].astype(np.float64), rows[inside])
    expected_row = np.rint(np.polyval(line, columns)).astype(int)
    expected = (expected_row >= 0) & (expected_row < on.shape[0])
    expected[expected] = mask[expected_row[expected], columns[expected]] > 0
    if not inside.any():
        return Pose(np.empty((0, 3)), int(expected.sum()), 0)
    pixels = np.column_stack((columns[inside], rows[inside])).astype(np.float64)
    rays = cv2.undistortPoints(pixels.reshape(-1, 1, 2), board.matrix, board.distortion).reshape(-1, 2)
    rays = np.column_stack((rays, np.ones(len(rays))))
    rotation, shift = board.poses[i]
    normal = rotation[:, 2]
    points = rays * ((normal @ shift) / (rays @ normal))[:, None]
    return Pose(points, int(expected.sum()), int((inside & expected).sum()))


def robust_line(x: Float, y: Float) -> Float:
    """Straight line through points with outliers."""
    use = np.ones(len(x), bool)
    line = np.array([0.0, float(np.median(y)) if len(y) else 0.0])
    for _ in range(FIT_ROUNDS):
        if use.sum() < 2:
            break
        line = np.polyfit(x[use], y[use], 1)
        use = _without_outliers(np.abs(y - np.polyval(line, x)), 2.0)
    return line


def robust_plane(points: Float) -> tuple[Float, float]:
    """Plane n . X = d through points with outliers."""
    use = np.ones(len(points), bool)
    for _ in range(FIT_ROUNDS):
        mean = points[use].mean(axis=0)
        normal = np.linalg.svd(points[use] - mean, full_matrices=False)[2][-1]
        use = _without_outliers(np.abs((points - mean) @ normal), 0.05)
    return normal, float(normal @ mean)


def _without_outliers(error: Float, least: float) -> npt.NDArray[np.bool_]:
    return error < max(3 * 1.4826 * float(np.median(error)), least)


def leave_one_out(poses: list[Pose]) -> dict[str, float]:
    """Distances of each pose's points from the plane of all the others, as figures by name."""
    means, distances = [], []
    for i, pose in enumerate(poses):
        if not len(pose.points_mm):
            continue
        normal, distance = robust_plane(np.concatenate([p.points_mm for j, p in enumerate(poses) if j != i]))
        error = pose.points_mm @ normal - distance
        means.append(abs(float(error.mean())))
        distances.append(error)
    error = np.abs(np.concatenate(distances))
    return {
        "bias": float(np.mean(means)),
        "rms": float(np.sqrt((error**2).mean())),
        "p95": float(np.percentile(error, 95)),
        "over_1mm": 100 * float((error > 1).mean()),
        "worst": float(error.max()),
        "coverage": sum(p.known for p in poses) / max(sum(p.columns for p in poses), 1),
    }


def report(folder: Path, methods: Sequence[str] = ("precise", "paper")) -> None:
    """Print the table."""
    board = calibrate(folder)
    print("method    bias mm   rms mm   p95 mm  > 1 mm %  worst mm  coverage")
    for method in methods:
        f = leave_one_out([points_on_board(folder, board, i, method) for i in range(POSES)])
        print(
            f"{method:<8} {f['bias']:8.4f} {f['rms']:8.3f} {f['p95']:8.3f} {f['over_1mm']:9.2f} "
            f"{f['worst']:9.2f} {f['coverage']:9.3f}"
        )
