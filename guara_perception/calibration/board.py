"""Calibration board, and its corners in one image."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Self

import numpy as np

from guara_perception.arrays import Float, Index
from kinematics.arrays import FrozenArrays

CHECKERBOARD: Final = "checkerboard"
CHARUCO: Final = "charuco"
PATTERNS: Final = (CHECKERBOARD, CHARUCO)
BLACK: Final = "black"
COLOURS: Final = (BLACK, "white")
# `BoardView.reason` of a mirrored board.
MIRRORED: Final = "the board is mirrored: the camera or its driver flips its pictures"


@dataclass(frozen=True, slots=True)
class BoardSpec:
    """Calibration board.

    Attributes:
        columns, rows: numbers of inner corners along the two sides.
        square: edge length of a square [m].
        pattern: "checkerboard", which must be completely visible, or "charuco", which may be partly visible, because
            markers in the white squares identify the corners.
        first_square: colour of a checkerboard's upper left square when `columns` run across, "black" or "white";
            `guara targets` prints boards with "black". None = unknown.
    """

    columns: int
    rows: int
    square: float
    pattern: str = CHECKERBOARD
    first_square: str | None = None

    @property
    def shows_handedness(self) -> bool:
        """True if a mirrored image of the board differs from all rotations of the board.

        This requires a ChArUco board, or a checkerboard with even and unequal numbers of squares and a first square of
        known colour.
        """
        is_unlike = self.columns % 2 == 1 and self.rows % 2 == 1 and self.columns != self.rows
        return self.pattern == CHARUCO or (is_unlike and self.first_square is not None)

    @property
    def points(self) -> Float:
        """Corners (n, 3) in the frame of the board [m], row by row, z = 0."""
        grid = np.mgrid[0 : self.columns, 0 : self.rows].T.reshape(-1, 2) * self.square
        return np.column_stack((grid, np.zeros(len(grid))))


@dataclass(frozen=True, slots=True)
class BoardView(FrozenArrays):
    """Board as seen in one image.

    Attributes:
        name: name of the image.
        corners_px: (n, 2) float64 positions of corners; empty for an unusable view.
        corners: (n,) indices of these corners in `BoardSpec.points`, ascending.
        edge_width_px: mean width of the edges between black and white; NaN if it was not measured.
        reason: reason why the view is unusable; empty for a usable view.
    """

    name: str
    corners_px: Float
    corners: Index
    edge_width_px: float
    reason: str = ""

    @classmethod
    def unusable(cls, name: str, reason: str, edge_width_px: float = np.nan) -> Self:
        """Create an unusable view, without corners, for a given reason."""
        return cls(name, np.empty((0, 2)), np.empty(0, np.intp), edge_width_px, reason)

    @property
    def is_usable(self) -> bool:
        """True if the view is usable."""
        return not self.reason

    def points(self, board: BoardSpec) -> Float:
        """Visible corners (n, 3) in the frame of the board [m], in the order of `corners_px`."""
        return np.asarray(board.points[self.corners])
