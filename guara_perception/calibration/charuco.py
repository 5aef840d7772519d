"""ChArUco pattern: printed cells, dictionary of markers, and detection of the corners of a whole or partial board.

The layout is that of OpenCV 4.6 and later: a black square at the corner where the markers begin, and one marker in each
white square, numbered row by row (S. Garrido-Jurado et al., "Automatic generation and detection of highly reliable
fiducial markers under occlusion", Pattern Recognition 47, 2014).
"""

from __future__ import annotations

from functools import lru_cache
from typing import Final

import cv2
import numpy as np

from guara_perception.arrays import Float, Float32, Grey, Index, Index32, Mask
from guara_perception.calibration.board import MIRRORED, BoardSpec, BoardView
from guara_perception.calibration.checkerboard import MAX_GRID_MISFIT, sub_pixel
from guara_perception.exceptions import InvalidInput

# A marker of 4 x 4 bits with its border is 6 cells wide, three quarters of a square of 8 cells. Markers are as large as
# possible, so that their bits are visible in a small image.
CELLS_PER_SQUARE: Final = 8
CELLS_PER_MARKER: Final = 6
# Dictionaries by number of markers. Each contains all smaller ones; the markers of a smaller one differ more from each
# other.
DICTIONARIES: Final = {
    50: cv2.aruco.DICT_4X4_50,
    100: cv2.aruco.DICT_4X4_100,
    250: cv2.aruco.DICT_4X4_250,
    1000: cv2.aruco.DICT_4X4_1000,
}
# Least number of visible corners, and of rows and columns that contain them.
MIN_CORNERS: Final = 12
MIN_LINES: Final = 3
# Half width of the window of the sub-pixel refinement, relative to the smallest square. Markers begin an eighth of a
# square from the corners and disturb the refinement: the rms error is 0.04 px with 0.1 and 0.07 px with 0.2 (rendered
# boards with squares of 20 to 80 px).
WINDOW_OF_SQUARE: Final = 0.1
SMALLEST_WINDOW_PX: Final = 3
# Least distance of a window from the border of the image.
RIM_PX: Final = 3
# Smallest share of the detected markers that must be at their positions on the board; otherwise it is another board.
BELONGING_SHARE: Final = 0.5
# Positions along and across an edge between two corners at which grey levels are sampled, in units of the edge length.
# They are near the middle of the edge and do not reach the markers.
ALONG: Final = np.linspace(0.3, 0.7, 9)
ACROSS: Final = np.linspace(-0.12, 0.12, 25)
# Width (10 to 90 %) of an edge with Gaussian blur, as a multiple of its contrast divided by its steepest slope.
WIDTH_OF_SLOPE: Final = 2 * 1.2816 / np.sqrt(2 * np.pi)


def ink_of_charuco(board: BoardSpec) -> Mask:
    """Cells (rows, columns) of the printed pattern, True where there is ink, CELLS_PER_SQUARE to a square.

    Raises:
        InvalidInput: the board needs more markers than the largest dictionary has.
    """
    size = ((board.columns + 1) * CELLS_PER_SQUARE, (board.rows + 1) * CELLS_PER_SQUARE)
    return np.asarray(_layout(board).generateImage(size, marginSize=0) == 0)


def find_charuco(grey: Grey, board: BoardSpec, name: str = "") -> BoardView:
    """Find the visible inner corners of a ChArUco board in an image.

    Args:
        grey: (h, w) image.
        board: inner corners and squares of the board.
        name: name of the image, for messages.

    Returns:
        View of all or part of the board; its sharpness is measured but not judged here.

    Raises:
        InvalidInput: the board needs more markers than the largest dictionary has.
    """
    layout = _layout(board)
    marks, ids = _markers(grey, layout)
    size = f"{board.columns}x{board.rows} inner corners"
    belong = _on_board(layout, marks, ids)
    seen = f"{len(ids)} marker{'s' if len(ids) > 1 else ''} found"
    if belong.sum() < max(BELONGING_SHARE * len(ids), 1):
        mirrored = _on_board(layout, *_markers(np.ascontiguousarray(grey[:, ::-1]), layout))
        if mirrored.sum() > max(2, belong.sum()):
            return BoardView.unusable(name, MIRRORED)
        if not len(ids):
            return BoardView.unusable(
                name, f"no marker of a ChArUco board of {size} was found (hidden, blurred, or another board?)"
            )
        return BoardView.unusable(name, f"{seen}, but not where a board of {size} has them: another board?")
    found, numbers, _, _ = cv2.aruco.CharucoDetector(layout).detectBoard(
        grey, markerCorners=list(marks[belong]), markerIds=ids[belong]
    )
    if numbers is None:
        return BoardView.unusable(name, f"{seen}, but no corner between them: show more of the board")
    order = np.argsort(np.ravel(numbers))
    corners, which = np.asarray(found, np.float64).reshape(-1, 2)[order], np.ravel(numbers)[order].astype(np.intp)
    corners, which = _refined(grey, corners, which, board)
    width = _edge_width(grey, corners, which, board)
    rows, columns = which // board.columns, which % board.columns
    if len(which) < MIN_CORNERS or min(len(set(rows.tolist())), len(set(columns.tolist()))) < MIN_LINES:
        return BoardView.unusable(
            name,
            f"{len(which)} of {board.columns * board.rows} corners are visible; {MIN_CORNERS} or more in {MIN_LINES} "
            f"rows and {MIN_LINES} columns are needed: show more of the board",
            width,
        )
    return BoardView(name, corners, which, width)


def marker_dictionary(board: BoardSpec) -> int:
    """OpenCV's code of the smallest dictionary with a marker for each white square.

    Raises:
        InvalidInput: the board needs more markers than the largest dictionary has.
    """
    needed = (board.columns + 1) * (board.rows + 1) // 2
    if needed > max(DICTIONARIES):
        raise InvalidInput(
            f"a ChArUco board of {board.columns}x{board.rows} inner corners needs {needed} markers; allowed: up to "
            f"{max(DICTIONARIES)}: use fewer and larger squares"
        )
    return min((count, code) for count, code in DICTIONARIES.items() if count >= needed)[1]


@lru_cache(maxsize=4)
def _layout(board: BoardSpec) -> cv2.aruco.CharucoBoard:
    """Board as an object of OpenCV, with lengths in cells."""
    markers = cv2.aruco.getPredefinedDictionary(marker_dictionary(board))
    size = (board.columns + 1, board.rows + 1)
    return cv2.aruco.CharucoBoard(size, float(CELLS_PER_SQUARE), float(CELLS_PER_MARKER), markers)


def _markers(grey: Grey, layout: cv2.aruco.CharucoBoard) -> tuple[Float32, Index32]:
    """Corners (n, 1, 4, 2) [px] of the board's markers in an image, and their numbers (n,)."""
    marks, ids, _ = cv2.aruco.ArucoDetector(layout.getDictionary()).detectMarkers(grey)
    if ids is None:
        return np.empty((0, 1, 4, 2), np.float32), np.empty(0, np.int32)
    numbers = np.ravel(ids).astype(np.int32)
    is_on_board = np.isin(numbers, layout.getIds())
    return np.asarray(marks, np.float32)[is_on_board], numbers[is_on_board]


def _on_board(layout: cv2.aruco.CharucoBoard, marks: Float32, ids: Index32) -> Mask:
    """Mask (n,) of the markers that are arranged as on the board; corners are sought only between such markers."""
    if not len(ids):
        return np.zeros(0, np.bool_)
    by_id = dict(zip(np.ravel(layout.getIds()).tolist(), layout.getObjPoints(), strict=True))
    on_board = np.array([np.asarray(by_id[number])[:, :2] for number in ids.tolist()], np.float64)
    _, fits = cv2.findHomography(
        marks.reshape(-1, 2).astype(np.float64), on_board.reshape(-1, 2), cv2.RANSAC, MAX_GRID_MISFIT * CELLS_PER_SQUARE
    )
    if fits is None:
        return np.zeros(len(ids), np.bool_)
    return np.asarray(np.reshape(fits, (-1, 4)).astype(bool).all(axis=1))


def _refined(grey: Grey, corners: Float, which: Index, board: BoardSpec) -> tuple[Float, Index]:
    """Refine corners to sub-pixel accuracy, and drop those at the border of the image.

    If no two corners are neighbours, all are returned unchanged, since their spacing is unknown.
    """
    first, second = _neighbours(which, board)
    if not len(first):
        return corners, which
    smallest = float(np.linalg.norm(corners[first] - corners[second], axis=1).min())
    half = int(np.clip(WINDOW_OF_SQUARE * smallest, SMALLEST_WINDOW_PX, 40))
    height, width = grey.shape
    rim = half + RIM_PX
    inside = ((corners > rim) & (corners < np.array([width, height]) - 1 - rim)).all(axis=1)
    if inside.any():
        corners[inside] = sub_pixel(grey, corners[inside], half)
    return corners[inside], which[inside]


def _neighbours(which: Index, board: BoardSpec) -> tuple[Index, Index]:
    """Positions in `which` of the two corners of each edge between neighbouring corners."""
    entry_of = np.full(board.columns * board.rows + board.columns, -1)
    entry_of[which] = np.arange(len(which))
    across = which[which % board.columns < board.columns - 1]
    first = np.concatenate((entry_of[across], entry_of[which]))
    second = np.concatenate((entry_of[across + 1], entry_of[which + board.columns]))
    both = second >= 0
    return first[both], second[both]


def _edge_width(grey: Grey, corners: Float, which: Index, board: BoardSpec) -> float:
    """Mean width of the black-white edges [px], from their steepest slope; NaN without neighbouring corners.

    OpenCV's own measure samples lines from the centre of one square to that of the next, which markers disturb.
    """
    first, second = _neighbours(which, board)
    if not len(first):
        return float("nan")
    edge = corners[second] - corners[first]
    length = np.linalg.norm(edge, axis=1)
    normal = np.column_stack((-edge[:, 1], edge[:, 0]))
    points = (
        corners[first][:, None, None]
        + ALONG[:, None, None] * edge[:, None, None]
        + ACROSS[:, None] * normal[:, None, None]
    )
    pixels = points.reshape(-1, len(ACROSS), 2).astype(np.float32)
    levels = cv2.remap(grey.astype(np.float32), pixels[..., 0], pixels[..., 1], cv2.INTER_LINEAR)
    mean_levels = np.asarray(levels, np.float64).reshape(len(edge), len(ALONG), len(ACROSS)).mean(axis=1)
    slope = np.abs(np.diff(mean_levels, axis=1)).max(axis=1) / (np.diff(ACROSS)[0] * length)
    low, high = corners.min(axis=0).astype(int), corners.max(axis=0).astype(int) + 1
    dark, bright = np.percentile(grey[low[1] : high[1], low[0] : high[0]], (5, 95))
    return float(np.mean(WIDTH_OF_SLOPE * (bright - dark) / np.maximum(slope, 1e-6)))
