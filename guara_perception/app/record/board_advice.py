"""Advice on the next image of the board: position in the image, tilt, stillness and exposure."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import cv2
import numpy as np

from guara_perception.arrays import Float, Image
from guara_perception.calibration.board import BoardSpec, BoardView
from guara_perception.calibration.find_board import find_board
from guara_perception.images import to_grey

ZONES: Final = 3
WANTED_PICTURES: Final = 12
# [rad] Below this tilt, focal length and distance of the board cannot be estimated separately.
TILT: Final = float(np.deg2rad(15))
# A board counts as still if no corner moves by more than STILL_PX in x or y between two frames. Two views count as the
# same if the mean absolute difference of their corners in x and y is less than SAME_OF_WIDTH of the image width.
STILL_PX: Final = 0.5
SAME_OF_WIDTH: Final = 0.04
# Largest fraction of clipped pixels in a usable image.
CLIPPED_SHARE: Final = 0.02
# Focal length of a typical lens as a fraction of the image width, for estimating tilts before the actual lens is known.
FOCAL_OF_WIDTH: Final = 0.92
# The exposure cannot be changed: it was metered on the stripe, and must be the same for all images of a session.
TOO_BRIGHT: Final = "shade the scene or close the iris, or begin a new session, which meters the exposure in this light"
SIDES: Final = ("left", "right", "top", "bottom")


@dataclass
class BoardAdvice:
    """Coverage by the board images accepted so far, and advice on the next image.

    Attributes:
        board: the board.
        views: accepted views.
    """

    board: BoardSpec
    views: list[BoardView] = field(default_factory=list)
    _zones: set[tuple[int, int]] = field(default_factory=set)
    _tilts: set[str] = field(default_factory=set)

    def judge(self, picture: Image, before: Image | None = None, name: str = "") -> tuple[BoardView, str]:
        """Find the board in an image; return the view and the reason for rejecting it, "" if it is accepted.

        `before` is the previous frame, for checking that the board is still; None = no check.
        """
        grey = to_grey(picture)
        if float(np.mean(grey >= 254)) > CLIPPED_SHARE:
            reason = f"too bright: {100 * float(np.mean(grey >= 254)):.0f} % of the picture is clipped; {TOO_BRIGHT}"
            return BoardView.unusable(name, reason), reason
        view = find_board(picture, self.board, name)
        if not view.is_usable:
            return view, view.reason
        if before is not None:
            earlier = find_board(before, self.board, name)
            moved = _moved(view, earlier)
            if not earlier.is_usable or not moved.size or moved.max() > STILL_PX:
                return view, "hold the board still"
        width = grey.shape[1]
        for other in self.views:
            moved = _moved(view, other)
            if moved.size and moved.mean() < SAME_OF_WIDTH * width:
                return view, f"shown before; {self.missing()}"
        return view, ""

    def take(self, view: BoardView, shape: tuple[int, ...]) -> None:
        """Add an accepted view to the coverage; `shape` is that of its image."""
        self.views.append(view)
        height, width = shape[:2]
        zone = np.clip((view.corners_px / np.array([width, height]) * ZONES).astype(int), 0, ZONES - 1)
        self._zones.update((int(row), int(column)) for column, row in zone)
        self._tilts.update(tilted_sides(view, self.board, (height, width)))

    def is_complete(self) -> bool:
        """True if there are enough views, and they cover every zone and every tilt."""
        return len(self.views) >= WANTED_PICTURES and len(self._zones) == ZONES**2 and len(self._tilts) == len(SIDES)

    def missing(self) -> str:
        """Request to the operator for the next image."""
        advice = []
        empty = [(r, c) for r in range(ZONES) for c in range(ZONES) if (r, c) not in self._zones]
        if empty:
            row, column = empty[0]
            zone = f"{('top', 'middle', 'bottom')[row]} {('left', 'centre', 'right')[column]}"
            advice.append(f"move the board to the {zone} of the view ({len(empty)} of {ZONES**2} zones still empty)")
        sides = [side for side in SIDES if side not in self._tilts]
        if sides:
            advice.append(f"tilt the {sides[0]} side of the board away from the camera")
        if not advice:
            advice.append("show the board in another position or at another tilt")
        return f"{len(self.views)} of {WANTED_PICTURES} pictures: " + ", and ".join(advice)


def _moved(view: BoardView, other: BoardView) -> Float:
    """Absolute differences (n, 2) in x and y of the corners that are in both views [px]."""
    _, here, there = np.intersect1d(view.corners, other.corners, return_indices=True)
    return np.abs(view.corners_px[here] - other.corners_px[there])


def tilted_sides(view: BoardView, board: BoardSpec, shape: tuple[int, int]) -> set[str]:
    """Sides of the image at which the board is tilted away from the camera by more than TILT, for a typical lens."""
    height, width = shape
    focal = FOCAL_OF_WIDTH * width
    matrix = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    found, turn, _ = cv2.solvePnP(view.points(board), view.corners_px.reshape(-1, 1, 2), matrix, None)
    if not found:
        return set()
    normal: Float = np.asarray(cv2.Rodrigues(turn)[0][:, 2], dtype=np.float64)
    normal = normal if normal[2] > 0 else -normal
    # The normal points away from the camera: if it leans to the right, the left side of the board is farther away.
    lean_x, lean_y = np.arctan2(-normal[0], normal[2]), np.arctan2(-normal[1], normal[2])
    tests = {"right": lean_x > TILT, "left": lean_x < -TILT, "bottom": lean_y > TILT, "top": lean_y < -TILT}
    return {side for side, holds in tests.items() if holds}
