"""Both methods on photographs of a laser line on a board: the plane of 11 board poses, judged on the twelfth.

The folder holds calib0 ... 11.jpg with the laser off, and light0 ... 11.jpg.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

import guara_perception as gp
from guara_perception.arrays import Float, Image

POSES = 12
DOTS = (7, 7)
PITCH_MM = 37.5
FIT_ROUNDS = 6


@dataclass(frozen=True)
class Board:
    """Camera model, and of each photograph the board's rotation (3, 3), shift (3,) [mm] and dots (n, 2) [px]."""

    matrix: Float
    distortion: Float
    rotations: list[Float]
    shifts: list[Float]
    dots: list[Float]


def read(folder: Path, name: str) -> Image:
    """One photograph."""
    picture = cv2.imread(str(folder / name))
    if picture is None:
        raise SystemExit(f"{folder}: {name} is missing")
    return np.asarray(picture, np.uint8)


def calibrate(folder: Path) -> Board:
    """Calibrate the camera from the photographs without laser."""
    parameters = cv2.SimpleBlobDetector.Params()
    parameters.maxArea = 20000
    parameters.minDistBetweenBlobs = 5
    detector = cv2.SimpleBlobDetector.create(parameters)
    grid = np.zeros((DOTS[0] * DOTS[1], 3), np.float32)
    grid[:, :2] = np.mgrid[: DOTS[0], : DOTS[1]].T.reshape(-1, 2) * PITCH_MM
    dots, size = [], (0, 0)
    for i in range(POSES):
        picture = cv2.cvtColor(read(folder, f"calib{i}.jpg"), cv2.COLOR_BGR2GRAY)
        size = (picture.shape[1], picture.shape[0])
        found, centres = cv2.findCirclesGrid(picture, DOTS, flags=cv2.CALIB_CB_SYMMETRIC_GRID, blobDetector=detector)
        if not found:
            raise SystemExit(f"{folder}: no {DOTS[0]}x{DOTS[1]} dots in calib{i}.jpg")
        dots.append(centres)
    rms, matrix, distortion, turns, shifts = cv2.calibrateCamera(
        [grid] * POSES, dots, size, np.eye(3), np.zeros(5), flags=cv2.CALIB_FIX_K3
    )
    print(f"camera: rms {rms:.3f} px, f {matrix[0, 0]:.1f} {matrix[1, 1]:.1f}")
    return Board(
        np.asarray(matrix, np.float64),
        np.asarray(distortion, np.float64),
        [np.asarray(cv2.Rodrigues(turn)[0], np.float64) for turn in turns],
        [np.asarray(shift, np.float64).ravel() for shift in shifts],
        [np.asarray(each, np.float64).reshape(-1, 2) for each in dots],
    )


def mask_of(dots: Float, shape: tuple[int, int]) -> npt.NDArray[np.bool_]:
    """Picture mask: hull of the dots, grown by half a pitch."""
    hull = cv2.convexHull(dots.astype(np.float32)).reshape(-1, 2)
    mask = np.zeros(shape, np.uint8)
    cv2.fillConvexPoly(mask, np.rint(hull).astype(np.int32), 1)
    side = 2 * int(round(np.linalg.norm(dots[1] - dots[0]) / 2)) + 1
    return np.asarray(cv2.dilate(mask, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side)))) > 0


def points_on_board(folder: Path, board: Board, i: int, method: str) -> tuple[Float, int, int]:
    """Stripe points (n, 3) on the board's plane in the camera frame [mm], columns that cross the mask, known ones."""
    on, off = read(folder, f"light{i}.jpg"), read(folder, f"calib{i}.jpg")
    rows = gp.extract_stripe(on, off, method=method).position_px.astype(np.float64)
    mask, columns, height = mask_of(board.dots[i], on.shape[:2]), np.arange(on.shape[1]), on.shape[0]

    def is_on_board(at: Float) -> npt.NDArray[np.bool_]:
        row = np.nan_to_num(np.rint(at), nan=-1).astype(int)
        return (row >= 0) & (row < height) & mask[np.clip(row, 0, height - 1), columns]

    inside = is_on_board(rows)
    line = robust_line(columns[inside].astype(np.float64), rows[inside])
    expected = is_on_board(np.asarray(np.polyval(line, columns), np.float64))
    if not inside.any():
        return np.empty((0, 3)), int(expected.sum()), 0
    pixels = np.column_stack((columns[inside], rows[inside])).astype(np.float64)
    rays = cv2.undistortPoints(pixels.reshape(-1, 1, 2), board.matrix, board.distortion).reshape(-1, 2)
    rays = np.column_stack((rays, np.ones(len(rays))))
    normal = board.rotations[i][:, 2]
    points = rays * ((normal @ board.shifts[i]) / (rays @ normal))[:, None]
    return points, int(expected.sum()), int((inside & expected).sum())


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


def report(folder: Path, methods: tuple[str, ...] = ("precise", "paper")) -> None:
    """Print distances of each pose's points from the plane of all the others."""
    board = calibrate(folder)
    print("method    bias mm   rms mm   p95 mm  > 1 mm %  worst mm  coverage")
    for method in methods:
        points, columns, known = zip(*(points_on_board(folder, board, i, method) for i in range(POSES)), strict=True)
        distances = []
        for i in range(POSES):
            normal, distance = robust_plane(np.concatenate(points[:i] + points[i + 1 :]))
            distances.append(points[i] @ normal - distance)
        error = np.abs(np.concatenate(distances))
        bias = np.mean([abs(each.mean()) for each in distances if each.size])
        print(
            f"{method:<8} {bias:8.4f} {np.sqrt((error**2).mean()):8.3f} {np.percentile(error, 95):8.3f} "
            f"{100 * (error > 1).mean():9.2f} {error.max():9.2f} {sum(known) / max(sum(columns), 1):9.3f}"
        )
