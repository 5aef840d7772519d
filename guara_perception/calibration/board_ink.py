"""What of a board is printed in black."""

from __future__ import annotations

import numpy as np

from guara_perception.arrays import Mask
from guara_perception.calibration.board import CHARUCO, BoardSpec
from guara_perception.calibration.charuco import ink_of_charuco


def board_ink(board: BoardSpec) -> Mask:
    """Cells (rows, columns) of the whole board, True where there is ink.

    Row 0 and column 0 are at the corner of the board from which its corners are counted; a square has one cell each
    way, or as many as tell the bits of its marker.

    Raises:
        InvalidInput: a ChArUco board with more squares than there are markers for.
    """
    if board.pattern == CHARUCO:
        return ink_of_charuco(board)
    row, column = np.mgrid[0 : board.rows + 1, 0 : board.columns + 1]
    return np.asarray((row + column) % 2 == 0)
