"""Advice on images of the board: zones, tilts, sharpness, light and stillness."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from guara_perception.app.record.board_advice import TILT, BoardAdvice, tilted_sides
from guara_perception.app.record.simulated import BOARD_POSES
from guara_perception.calibration.board import BoardSpec
from guara_perception.calibration.find_board import find_board
from guara_perception.simulation.specimen import rotation, specimen
from guara_perception.simulation.target_pictures import TargetCamera

BOARD = BoardSpec(9, 7, 0.03)


@pytest.fixture(scope="module")
def show(robot):
    """Image of a board with a given position (fractions of width and height), distance, tilts and rotation."""
    camera = specimen(robot, (640, 512), 3).camera
    targets = TargetCamera.of(camera)

    def picture(u, v, distance, about_x=0.0, about_y=0.0, turn=0.0):
        ray = camera.rays(np.array([[u * 640, v * 512]]))[0]
        lean = rotation([about_x, 0, 0]) @ rotation([0, about_y, 0]) @ rotation([0, 0, turn])
        pose = np.eye(4)
        pose[:3, :3] = lean
        pose[:3, 3] = ray / ray[2] * distance - lean @ np.array([0.12, 0.09, 0])
        return targets.board(BOARD, pose)

    return picture


@pytest.mark.slow
@pytest.mark.parametrize(
    ("about_x", "about_y", "side"), [(0.5, 0, "bottom"), (-0.5, 0, "top"), (0, 0.5, "left"), (0, -0.5, "right")]
)
def test_the_side_that_leans_away_is_named(show, about_x, about_y, side):
    """The side whose corners are farther from the camera, where the squares look smaller."""
    view = find_board(show(0.5, 0.5, 0.5, about_x, about_y), BOARD)
    assert tilted_sides(view, BOARD, (512, 640)) == {side}
    grid = view.corners_px.reshape(7, 9, 2)
    across = np.linalg.norm(np.diff(grid, axis=1), axis=2)
    down = np.linalg.norm(np.diff(grid, axis=0), axis=2)
    ends = {"top": down[0], "bottom": down[-1], "left": across[:, 0], "right": across[:, -1]}
    opposite = {"top": "bottom", "bottom": "top", "left": "right", "right": "left"}[side]
    smaller, larger = (ends[side].mean(), ends[opposite].mean())
    if view.corners_px[0, 0] > view.corners_px[-1, 0]:
        smaller, larger = larger, smaller
    assert smaller < larger


def test_a_flat_view_leans_nowhere(show):
    """Tilts below TILT do not count."""
    view = find_board(show(0.5, 0.5, 0.5, 0.6 * TILT, 0.0), BOARD)
    assert tilted_sides(view, BOARD, (512, 640)) == set()


@pytest.mark.slow
def test_the_poses_of_the_workshop_complete_the_advice(show):
    """All poses are needed: after three images the advice names what is missing."""
    advice = BoardAdvice(BOARD)
    for count, pose in enumerate(BOARD_POSES, start=1):
        picture = show(*pose)
        view, problem = advice.judge(picture, picture)
        assert not problem, problem
        advice.take(view, picture.shape)
        if count == 3:
            assert not advice.is_complete() and advice.missing().startswith("3 of 12 pictures: ")
        if advice.is_complete():
            break
    assert advice.is_complete() and len(advice.views) >= 12


@pytest.mark.slow
def test_what_is_wrong_with_a_picture_is_reported(show):
    """Blank, clipped, blurred, moving, and shown before."""
    advice = BoardAdvice(BOARD)
    good = show(0.5, 0.5, 0.45)
    assert "blank" in advice.judge(np.full_like(good, 90))[1]
    assert "no board of 9x7 inner corners" in advice.judge(good[:200])[1]
    assert advice.judge(np.where(good > 100, 255, good).astype(np.uint8))[1].startswith("too bright: ")
    assert "blurred" in advice.judge(cv2.GaussianBlur(good, (0, 0), 3.0))[1]
    moved = np.roll(good, 2, axis=1)
    assert advice.judge(good, moved)[1] == "hold the board still"
    view, problem = advice.judge(good, good)
    assert problem == ""
    advice.take(view, good.shape)
    assert advice.judge(good, good)[1].startswith("shown before; 1 of 12 pictures: ")


def test_a_picture_that_is_clipped_says_what_to_do():
    """The same remedy as `guara scan` gives in this light."""
    _, reason = BoardAdvice(BOARD).judge(np.full((512, 640), 255, np.uint8))
    assert reason.startswith("too bright: 100 % of the picture is clipped; shade the scene or close the iris")
