"""Detection of a complete checkerboard in a greyscale image."""

from __future__ import annotations

import cv2
import numpy as np

from guara_perception.arrays import Float, Grey, Image
from guara_perception.calibration.board import BLACK, MIRRORED, BoardSpec, BoardView
from guara_perception.images import to_grey

# Width of a border added to the image, without which the sector-based detector misses boards at the edge.
BORDER_PX = 40
# A slight blur before the sub-pixel refinement nearly halves the error at sharp, aliased edges (from 0.07 to 0.04 px).
BLUR_SIGMA_PX = 0.8
# Half width of the window of the sub-pixel refinement, relative to the smallest square: large, but too small to
# contain a second corner.
WINDOW_OF_SQUARE = 0.35
# Points beside the detected corners count as corners if their median contrast exceeds this share of the median
# contrast of the corners.
CROSSING_SHARE = 0.5
# Largest misfit of a homography, relative to a square. Lens distortion bends a board by a few per cent of a square,
# whereas the markers of another board are displaced by a whole square.
MAX_GRID_MISFIT = 0.2
# Smallest number of inner corners along each side that OpenCV accepts.
SMALLEST_PATTERN = (3, 3)


def find_checkerboard(grey: Grey, board: BoardSpec, name: str = "") -> BoardView:
    """Find the inner corners of a complete board to a few hundredths of a pixel.

    The fast classic detector is tried first, then the sector-based one, which tolerates uneven light. A board with
    other numbers of inner corners is rejected.

    Args:
        grey: (h, w) image.
        board: inner corners and squares of the board.
        name: name of the image, for messages.

    Returns:
        View of the board; its sharpness is measured but not judged here.
    """
    size = (board.columns, board.rows)
    corners = _detect(grey, size)
    if corners is None:
        return BoardView.unusable(
            name,
            f"no board of {board.columns}x{board.rows} inner corners was found (hidden, blurred, cut off, or another "
            "board?)",
        )
    if wrong_grid(grey, corners, size):
        return BoardView.unusable(
            name,
            f"the detected corners are not a complete grid of {board.columns}x{board.rows} inner corners: is it "
            "another board?",
        )
    if board.shows_handedness and is_mirrored(grey, corners, board):
        return BoardView.unusable(name, MIRRORED)
    width = edge_width(grey, corners, size)
    return BoardView(name, refine_corners(grey, corners, size), np.arange(len(corners)), width)


def is_mirrored(grey: Grey, corners: Float, board: BoardSpec) -> bool:
    """Test whether the image of a board is mirrored, by the colours of the squares between its corners (n, 2).

    The board must satisfy `BoardSpec.shows_handedness`. The detectors number the corners from any of the four outer
    ones, clockwise or counterclockwise.
    """
    grid = corners.reshape(board.rows, board.columns, 2)
    centres = ((grid[1:, 1:] + grid[:-1, :-1] + grid[1:, :-1] + grid[:-1, 1:]) / 4).astype(np.float32)
    levels = cv2.remap(grey, centres[..., 0], centres[..., 1], cv2.INTER_LINEAR).astype(np.float64)
    # The inner square at the first corner has the colour of the outer square diagonally opposite that corner.
    is_first = np.indices(levels.shape).sum(axis=0) % 2 == 0
    starts_black = bool(levels[is_first].mean() < levels[~is_first].mean())
    across, down = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
    is_clockwise = bool(across[0] * down[1] > across[1] * down[0])
    return (starts_black == (board.first_square == BLACK)) != is_clockwise


def refine_corners(grey: Image, corners: Float, size: tuple[int, int]) -> Float:
    """Refine corners (n, 2) to sub-pixel accuracy, with a window proportional to the squares."""
    grid = corners.reshape(size[1], size[0], 2)
    smallest = min(np.linalg.norm(np.diff(grid, axis=axis), axis=2).min() for axis in (0, 1))
    half = int(np.clip(WINDOW_OF_SQUARE * smallest, 3, 40))
    smooth = cv2.GaussianBlur(grey, (0, 0), BLUR_SIGMA_PX)
    return sub_pixel(np.asarray(smooth), corners, half)


def sub_pixel(grey: Image, corners: Float, half: int) -> Float:
    """Refine corners (n, 2) with `cv2.cornerSubPix`, in windows of half width `half` [px]."""
    start = np.ascontiguousarray(corners, dtype=np.float32).reshape(-1, 1, 2)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-4)
    found = cv2.cornerSubPix(grey, start, (half, half), (-1, -1), criteria)
    return np.asarray(found, dtype=np.float64).reshape(-1, 2)


def wrong_grid(grey: Image, corners: Float, size: tuple[int, int]) -> bool:
    """Test whether the corners are only a part of the board's corners, or do not form a regular grid.

    If asked for too few corners, both detectors return a part of the board, or every other line of it. The grid is
    therefore projected into the image by a homography; the points halfway between its lines, and those one line
    outside, must not look like corners.
    """
    grid = np.mgrid[0 : size[0], 0 : size[1]].T.reshape(-1, 2).astype(np.float64)
    homography = np.asarray(cv2.findHomography(grid, corners)[0], dtype=np.float64)
    laid = cv2.perspectiveTransform(grid.reshape(-1, 1, 2), homography).reshape(-1, 2)
    spacing = float(np.linalg.norm(np.diff(corners.reshape(size[1], size[0], 2), axis=1), axis=2).min())
    if float(np.abs(laid - corners).max()) > MAX_GRID_MISFIT * spacing:
        return True
    columns, rows = np.arange(size[0], dtype=np.float64), np.arange(size[1], dtype=np.float64)
    outside = [np.column_stack((columns, np.full(size[0], row))) for row in (-1.0, float(size[1]))]
    outside += [np.column_stack((np.full(size[1], column), rows)) for column in (-1.0, float(size[0]))]
    between = [grid[grid[:, axis] < size[axis] - 1] + 0.5 * np.eye(2)[axis] for axis in (0, 1)]
    for points_on_board, radius in [*((line, 0.35) for line in outside), *((line, 0.2) for line in between)]:
        usual = float(np.median(_crossing(grey, homography, grid, radius)))
        strength = _crossing(grey, homography, points_on_board, radius)
        seen = strength[np.isfinite(strength)]
        if len(seen) >= len(points_on_board) / 2 and float(np.median(seen)) > CROSSING_SHARE * usual:
            return True
    return False


def _crossing(grey: Image, homography: Float, points_on_board: Float, radius: float) -> Float:
    """Contrast (n,) of the pattern black, white, black, white on a ring around points (n, 2); NaN outside the image."""
    angle = np.deg2rad(np.arange(0, 360, 15) + 7.5)
    ring = radius * np.column_stack((np.cos(angle), np.sin(angle)))
    points = (points_on_board[:, None] + ring[None]).reshape(-1, 1, 2)
    pixels = (
        cv2.perspectiveTransform(points, homography).astype(np.float32).reshape(len(points_on_board), len(angle), 2)
    )
    levels = cv2.remap(grey.astype(np.float32), pixels[:, :, 0], pixels[:, :, 1], cv2.INTER_LINEAR, borderValue=np.nan)
    quarter = len(angle) // 4
    rotated = np.abs(levels - np.roll(levels, quarter, axis=1)).mean(axis=1)
    opposite = np.abs(levels - np.roll(levels, 2 * quarter, axis=1)).mean(axis=1)
    return np.asarray(rotated - opposite, dtype=np.float64)


def edge_width(grey: Image, corners: Float, size: tuple[int, int]) -> float:
    """Mean width of the edges between black and white squares [px]."""
    points = np.ascontiguousarray(corners, dtype=np.float32).reshape(-1, 1, 2)
    return float(np.ravel(cv2.estimateChessboardSharpness(grey, size, points)[0])[0])


def other_size(picture: Image, board: BoardSpec) -> tuple[int, int] | None:
    """Numbers (columns, rows) of inner corners of a board of another size in an image; None if there is none.

    OpenCV extends the smallest pattern to all adjacent corners, so all sizes take the same time.
    """
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_LARGER
    found, _, kinds = cv2.findChessboardCornersSBWithMeta(to_grey(picture), SMALLEST_PATTERN, flags)
    if not found:
        return None
    rows, columns = kinds.shape[:2]
    return None if (columns, rows) == (board.columns, board.rows) else (columns, rows)


def _detect(grey: Grey, size: tuple[int, int]) -> Float | None:
    flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
    found, corners = cv2.findChessboardCorners(grey, size, flags=flags)
    if not found:
        padded = np.pad(grey, BORDER_PX, mode="edge")
        found, corners = cv2.findChessboardCornersSB(padded, size, flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
        if found:
            corners = corners - BORDER_PX
    if not found or corners is None or len(corners) != size[0] * size[1]:
        return None
    return np.asarray(corners, dtype=np.float64).reshape(-1, 2)
