"""Finding the board in one picture."""

from pathlib import Path

import cv2
import numpy as np
import pytest

import guara_perception as gp
from guara_perception.app.files.scan_folder import read_picture
from guara_perception.calibration.board import BoardSpec
from guara_perception.calibration.checkerboard import other_size
from guara_perception.calibration.find_board import find_board

BOARD = BoardSpec(9, 7, 0.03)


@pytest.fixture(scope="module")
def picture(data: Path) -> np.ndarray:
    """A tilted board."""
    return read_picture(data / "calibration" / "board_05.jpg")


def test_corners_fit_the_true_lens(picture: np.ndarray, calibration: gp.Calibration) -> None:
    """Corners lie within a few hundredths of a pixel of a board seen through the true lens."""
    corners = find_board(picture, BOARD).corners_px
    matrix, lens = calibration.camera.matrix, calibration.camera.distortion
    _, turn, translation = cv2.solvePnP(BOARD.points, corners.copy(), matrix, lens)
    expected = cv2.projectPoints(BOARD.points, turn, translation, matrix, lens)[0][:, 0]
    assert np.sqrt(np.mean((corners - expected) ** 2)) < 0.05


def test_any_picture_type(picture: np.ndarray) -> None:
    """Colour, grey, one channel in three dimensions and 16 bit give the same corners."""
    grey = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
    expected = find_board(grey, BOARD).corners_px
    assert len(expected) == 63
    for other in (picture, grey[:, :, None], grey.astype(np.uint16) << 8):
        np.testing.assert_allclose(find_board(other, BOARD).corners_px, expected, atol=1e-6)


@pytest.mark.slow
def test_reasons(picture: np.ndarray) -> None:
    """What cannot be used says why: blank, blurred, no board, a part of a larger board."""
    assert find_board(np.full_like(picture, 100), BOARD).reason.startswith("the picture is blank")
    assert find_board(cv2.GaussianBlur(picture, (0, 0), 3), BOARD).reason.startswith("blurred: black-white edges are")
    assert find_board(picture[:200], BOARD).reason.startswith("no board of 9x7 inner corners was found")
    smaller = find_board(picture, BoardSpec(7, 5, 0.03))
    assert smaller.reason == "the detected corners are not a complete grid of 7x5 inner corners: is it another board?"
    assert not smaller.is_usable and smaller.corners_px.shape == (0, 2)


@pytest.mark.slow
def test_true_size_is_suggested(picture: np.ndarray) -> None:
    """The size that the board really has is found; a picture without a board has none."""
    assert other_size(picture, BoardSpec(8, 6, 0.03)) in ((9, 7), (7, 9))
    assert other_size(np.zeros_like(picture[:100, :100]), BoardSpec(8, 6, 0.03)) is None
