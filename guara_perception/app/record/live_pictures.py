"""Pictures for the live page while the operator lays something down, with what is found drawn into them."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future

import cv2
import numpy as np

from guara_perception.arrays import Float, Image
from guara_perception.calibration.board import BoardSpec, to_grey
from guara_perception.calibration.calibration import CameraModel
from guara_perception.calibration.crosses import find_crosses
from guara_perception.calibration.find_board import find_board
from guara_perception.calibration.floor_lines import floor_pixels
from guara_perception.calibration.plates import level_pixels
from guara_perception.settings import Settings
from guara_perception.shown import eight_bits
from transport.supervision import supervised

# A picture with what was found drawn into it, and a sentence about it.
Look = Callable[[Image], tuple[Image, str]]
# Called with a picture and a sentence about it, or the request for the next one.
Watch = Callable[[Image, str], None]
GREEN, RED = (0, 220, 0), (0, 0, 255)
# [px] Radius of the circles; points of an outline on each side, since a lens bends it.
RADIUS = 8
SIDE_POINTS = 20


def show_while(ask: Callable[[], None], grab: Callable[[], Image], look: Look, watch: Watch) -> None:
    """Show one picture after the other until `ask`, on a thread of its own, has its answer."""
    answer: Future[None] = Future()

    def wait_for_answer() -> None:
        try:
            ask()
            answer.set_result(None)
        except BaseException as error:  # raised where the answer is awaited
            answer.set_exception(error)

    thread = supervised("operator", wait_for_answer, restarts=None)
    thread.start()
    try:
        while True:
            watch(*look(grab()))
            if answer.done():
                break
    finally:
        thread.join()
    answer.result()


def plain(picture: Image) -> tuple[Image, str]:
    """The picture as it is."""
    return picture, ""


def board_look(board: BoardSpec) -> Look:
    """Look for a board; its corners are drawn."""

    def look(picture: Image) -> tuple[Image, str]:
        view = find_board(picture, board)
        drawn = _colour(picture)
        for corner in view.corners_px if view.is_usable else ():
            _circle(drawn, corner, GREEN)
        return drawn, view.reason or "the board is seen"

    return look


def crosses_look(camera: CameraModel, points: Float, nominals: tuple[Float, ...]) -> Look:
    """Look for crosses near where one of the mounts expects them: found in green, places of the others in red."""

    def look(picture: Image) -> tuple[Image, str]:
        grey, drawn = to_grey(picture), _colour(picture)
        seen = [(find_crosses(grey, camera, nominal, points), nominal) for nominal in nominals]
        marks, nominal = min(seen, key=lambda one: one[0].count(None))
        for mark, expected in zip(marks, floor_pixels(camera, nominal, points), strict=True):
            _circle(drawn, expected if mark is None else mark.centre_px, RED if mark is None else GREEN)
        lost = ", ".join(str(number) for number, mark in enumerate(marks, start=1) if mark is None)
        return drawn, f"not seen: cross {lost}, near the red circles" if lost else f"all {len(marks)} crosses are seen"

    return look


def area_look(camera: CameraModel, transform_camera_to_footprint: Float, settings: Settings, height: float) -> Look:
    """Outline of the scanned area on a plate of this height [m]."""
    (x0, x1), (y0, y1) = settings.footprint_x, settings.footprint_y
    corners = np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0)])
    share = np.linspace(0, 4, 4 * SIDE_POINTS + 1)
    outline = np.column_stack([np.interp(share, np.arange(5), corners[:, axis]) for axis in (0, 1)])
    pixels = np.rint(level_pixels(camera, transform_camera_to_footprint, outline, height)).astype(np.int32)

    def look(picture: Image) -> tuple[Image, str]:
        drawn = _colour(picture)
        cv2.polylines(drawn, [pixels], isClosed=False, color=GREEN, thickness=2)
        return drawn, "the scanned area is outlined"

    return look


def _colour(picture: Image) -> Image:
    """A copy of 8 bits and three colours."""
    picture = eight_bits(picture)
    return cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR) if picture.ndim == 2 else picture.copy()


def _circle(picture: Image, centre: Float, colour: tuple[int, int, int]) -> None:
    if np.all(np.isfinite(centre)) and np.all(np.abs(centre) < 1e5):
        cv2.circle(picture, [round(float(value)) for value in centre], RADIUS, colour, 2)
