"""Camera images with overlaid detections for the live page, while the operator lays out board, crosses or plates."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future

import cv2
import numpy as np

from guara_perception.arrays import Float, Image
from guara_perception.calibration.board import BoardSpec
from guara_perception.calibration.calibration import CameraModel, floor_pixels
from guara_perception.calibration.crosses import find_crosses
from guara_perception.calibration.find_board import find_board
from guara_perception.images import eight_bits, to_grey
from guara_perception.settings import Settings
from transport.supervision import supervised

# Function that annotates a camera image: returns the image to show, and a text about it or "".
Look = Callable[[Image], tuple[Image, str]]
# Function that is called with each image to show and a text, which describes the image or is a request to the operator.
Watch = Callable[[Image, str], None]
GREEN, RED = (0, 220, 0), (0, 0, 255)
# Radius of the circles [px].
RADIUS = 8
# Number of points on each side of an outline, whose sides are curved by the distortion of the lens.
SIDE_POINTS = 20


def show_while(ask: Callable[[], None], grab: Callable[[], Image], look: Look, watch: Watch) -> None:
    """Run `ask` on its own thread, and show camera images until it returns. Exceptions of `ask` are raised here."""
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
    """Return the image unchanged, without a text."""
    return picture, ""


def board_look(board: BoardSpec) -> Look:
    """Make a function that finds a board and draws its corners."""

    def look(picture: Image) -> tuple[Image, str]:
        view = find_board(picture, board)
        drawn = _colour(picture)
        for corner in view.corners_px if view.is_usable else ():
            _circle(drawn, corner, GREEN)
        return drawn, view.reason or "board found"

    return look


def crosses_look(camera: CameraModel, points: Float, nominals: tuple[Float, ...]) -> Look:
    """Make a function that finds crosses, and draws found ones green and the expected positions of missing ones red.

    Of the camera poses `nominals`, the one at which the most crosses are found gives the expected positions.
    """

    def look(picture: Image) -> tuple[Image, str]:
        grey, drawn = to_grey(picture), _colour(picture)
        seen = [(find_crosses(grey, camera, nominal, points), nominal) for nominal in nominals]
        marks, nominal = min(seen, key=lambda one: one[0].count(None))
        for mark, expected in zip(marks, floor_pixels(camera, nominal, points), strict=True):
            _circle(drawn, expected if mark is None else mark.centre_px, RED if mark is None else GREEN)
        lost = ", ".join(str(number) for number, mark in enumerate(marks, start=1) if mark is None)
        missing = f"cross {lost} not found (expected at the red circles)"
        return drawn, missing if lost else f"all {len(marks)} crosses found"

    return look


def area_look(camera: CameraModel, transform_camera_to_footprint: Float, settings: Settings, height: float) -> Look:
    """Make a function that draws the outline of the scanned area at the height of a plate [m]."""
    (x0, x1), (y0, y1) = settings.footprint_x, settings.footprint_y
    corners = np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0)])
    share = np.linspace(0, 4, 4 * SIDE_POINTS + 1)
    outline = np.column_stack([np.interp(share, np.arange(5), corners[:, axis]) for axis in (0, 1)])
    pixels = np.rint(floor_pixels(camera, transform_camera_to_footprint, outline, height)).astype(np.int32)

    def look(picture: Image) -> tuple[Image, str]:
        drawn = _colour(picture)
        cv2.polylines(drawn, [pixels], isClosed=False, color=GREEN, thickness=2)
        return drawn, "the scanned area is outlined"

    return look


def _colour(picture: Image) -> Image:
    """Copy an image as 8-bit BGR."""
    picture = eight_bits(picture)
    return cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR) if picture.ndim == 2 else picture.copy()


def _circle(picture: Image, centre: Float, colour: tuple[int, int, int]) -> None:
    # This also excludes NaN.
    if np.all(np.abs(centre) < 1e5):
        cv2.circle(picture, [round(float(value)) for value in centre], RADIUS, colour, 2)
