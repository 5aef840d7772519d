"""Boards and heights as they are written on a command line."""

from __future__ import annotations

from guara_perception.calibration.board import CHECKERBOARD, BoardSpec
from guara_perception.exceptions import InvalidInput


def parse_board(size: str, square: float, pattern: str = CHECKERBOARD) -> BoardSpec:
    """A board from "COLUMNSxROWS" of inner corners, the edge of a square [m] and its pattern.

    Raises:
        InvalidInput: not of this form, or a size that no board has.
    """
    columns, between, rows = size.partition("x")
    if not (between and columns.isdigit() and rows.isdigit()):
        raise InvalidInput(f"--board is {size!r}, it must be COLUMNSxROWS of inner corners, such as 9x7")
    board = BoardSpec(int(columns), int(rows), square, pattern)
    if not (3 <= board.columns <= 40 and 3 <= board.rows <= 40 and 0.005 <= square <= 0.1):
        raise InvalidInput(
            f"board has {board.columns}x{board.rows} inner corners of {square:g} m; allowed: 3 ... 40 each way, "
            f"squares of 0.005 ... 0.1 m"
        )
    return board


def parse_heights(text: str) -> tuple[float, ...]:
    """Heights of plates [m] with commas between.

    Raises:
        InvalidInput: no numbers, or not 1 to 20 different ones within 0.5 m of the floor.
    """
    try:
        heights = tuple(float(height) for height in text.split(","))
    except ValueError:
        raise InvalidInput(f"--plates is {text!r}, it must be heights in metres with commas between") from None
    if not 1 <= len(heights) <= 20 or len(set(heights)) < len(heights) or not all(-0.5 <= h <= 0.5 for h in heights):
        raise InvalidInput(f"--plates is {text!r}, allowed: 1 ... 20 different heights of -0.5 ... 0.5 m")
    return heights
