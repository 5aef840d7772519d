"""Which cells of a board are printed in black."""

from __future__ import annotations

import numpy as np

from guara_perception.arrays import Mask
from guara_perception.calibration.board import CHARUCO, BoardSpec
from guara_perception.calibration.charuco import ink_of_charuco


def board_ink(board: BoardSpec) -> Mask:
    """Cells (rows, columns) of the whole board, True where there is ink.

    Row 0 and column 0 are at the corner of the board from which its corners are counted. A square of a checkerboard is
    one cell; a square of a ChArUco board has several each way, since it holds the bits of a marker.

    Raises:
        InvalidInput: a ChArUco board with more squares than there are markers for.
    """
    if board.pattern == CHARUCO:
        return ink_of_charuco(board)
    row, column = np.mgrid[0 : board.rows + 1, 0 : board.columns + 1]
    return np.asarray((row + column) % 2 == 0)
