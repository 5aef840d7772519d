"""Detection of a calibration board in an image, and the printed cells of a board."""

from __future__ import annotations

import numpy as np

from guara_perception.arrays import Image, Mask
from guara_perception.calibration.board import CHARUCO, BoardSpec, BoardView
from guara_perception.calibration.charuco import find_charuco, ink_of_charuco
from guara_perception.calibration.checkerboard import find_checkerboard
from guara_perception.images import to_grey

# Contrast below which an image counts as blank [grey levels].
BLANK_CONTRAST = 12
# Largest width of an edge between black and white (10 to 90 %). A sharp lens gives 2 to 3 px; edges wider than
# the limit displace the corners.
MAX_EDGE_WIDTH_PX = 5.0


def find_board(picture: Image, board: BoardSpec, name: str = "") -> BoardView:
    """Find the inner corners of a board in an image, to a few hundredths of a pixel.

    The view is unusable, with a reason, if the image is blank, blurred or mirrored, if too little of the board was
    found, or if the image shows a different board.

    Args:
        picture: (h, w) or (h, w, 3) image, uint8 or uint16.
        board: inner corners, squares and pattern of the board.
        name: name of the image, for messages.
    """
    grey = to_grey(picture)
    contrast = float(np.percentile(grey[::4, ::4], 99.5)) - float(np.percentile(grey[::4, ::4], 0.5))
    if contrast < BLANK_CONTRAST:
        reason = f"the picture is blank ({contrast:.0f} grey levels between dark and bright)"
        return BoardView.unusable(name, reason)
    view = (find_charuco if board.pattern == CHARUCO else find_checkerboard)(grey, board, name)
    if view.edge_width_px > MAX_EDGE_WIDTH_PX:
        width = view.edge_width_px
        reason = f"blurred: black-white edges are {width:.1f} px wide; allowed: up to {MAX_EDGE_WIDTH_PX:.0f} px"
        return BoardView.unusable(name, reason, width)
    return view


def board_ink(board: BoardSpec) -> Mask:
    """Cells (rows, columns) of the whole board, True where there is ink.

    Row 0 and column 0 are at the corner from which the inner corners of the board are counted. A square of a
    checkerboard is one cell; a square of a ChArUco board consists of several cells, each as large as a bit of a marker.

    Raises:
        InvalidInput: a ChArUco board needs more markers than the largest dictionary has.
    """
    if board.pattern == CHARUCO:
        return ink_of_charuco(board)
    row, column = np.mgrid[0 : board.rows + 1, 0 : board.columns + 1]
    return np.asarray((row + column) % 2 == 0)
