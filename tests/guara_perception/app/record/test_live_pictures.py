"""Images of the live page while the operator is busy: they are updated, and show what is detected."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from guara_perception.app.record.live_pictures import area_look, board_look, crosses_look, plain, show_while
from guara_perception.app.record.record import RecordingFailed, _record_floor
from guara_perception.app.record.session_writer import SessionPlan, SessionWriter
from guara_perception.app.record.simulated import SimulatedWorkshop
from guara_perception.app.targets.drawings import cross_points
from guara_perception.calibration.board import BoardSpec
from guara_perception.calibration.calibration import floor_pixels
from guara_perception.calibration.find_board import find_board
from guara_perception.settings import Settings
from guara_perception.simulation.target_pictures import TargetCamera

BOARD = BoardSpec(9, 7, 0.03)
GREEN, RED = (0, 220, 0), (0, 0, 255)


@pytest.fixture(scope="module")
def workshop() -> SimulatedWorkshop:
    """Robot and true camera; each test shows its own scene."""
    return SimulatedWorkshop()


def near(picture: np.ndarray, pixel: np.ndarray, colour: tuple[int, int, int]) -> bool:
    """True if this colour is drawn within 20 px of a pixel."""
    row, column = np.nonzero(np.all(picture == colour, axis=2))
    return bool(np.any(np.hypot(column - pixel[0], row - pixel[1]) < 20))


def test_pictures_go_on_until_the_operator_has_answered():
    """Three images are shown before the key is pressed; an exception of the operator is raised."""
    pressed, shown = threading.Event(), []

    def watch(picture: np.ndarray, text: str) -> None:
        shown.append((int(picture[0, 0]), text))
        if len(shown) == 3:
            pressed.set()

    show_while(lambda: assert_waited(pressed), lambda: np.full((4, 4), len(shown), np.uint32), plain, watch)
    assert shown[:3] == [(0, ""), (1, ""), (2, "")]
    with pytest.raises(KeyboardInterrupt):
        show_while(interrupt, lambda: np.zeros((4, 4), np.uint8), plain, watch)


def assert_waited(pressed: threading.Event) -> None:
    """Wait for the key."""
    assert pressed.wait(60)


def interrupt() -> None:
    """Simulate Ctrl-C."""
    raise KeyboardInterrupt


@pytest.mark.slow
def test_crosses_that_are_seen_are_green_and_the_place_of_another_is_red(workshop: SimulatedWorkshop):
    """The text counts the crosses, and names the missing one."""
    points, camera, to_footprint = cross_points(workshop.robot), workshop.truth.camera, workshop._camera_to_footprint
    look = crosses_look(camera, points, (to_footprint,))
    targets = TargetCamera.of(camera, seed=1)
    drawn, text = look(targets.crosses(points, to_footprint))
    pixels = floor_pixels(camera, to_footprint, points)
    assert text == "all 5 crosses found" and all(near(drawn, pixel, GREEN) for pixel in pixels)
    drawn, text = look(targets.crosses(points[1:], to_footprint))
    assert text == "cross 1 not found (expected at the red circles)"
    assert near(drawn, pixels[0], RED) and not near(drawn, pixels[0], GREEN) and near(drawn, pixels[1], GREEN)


@pytest.mark.slow
def test_corners_of_the_board_and_the_scanned_area_are_drawn(workshop: SimulatedWorkshop):
    """Without a board the reason is shown; the outline on a plate is above that on the floor."""
    look = board_look(BOARD)
    workshop.lay_board(BOARD, "")
    with workshop.rangefinder as rangefinder:
        seen = np.asarray(rangefinder.camera.grab(60.0).image)
    drawn, text = look(seen)
    assert text == "board found" and np.all(drawn == GREEN, axis=2).sum() > 500
    drawn, text = look(np.zeros((300, 400), np.uint16))
    assert (
        text == find_board(np.zeros((300, 400), np.uint8), BOARD).reason
        and drawn.shape == (300, 400, 3)
        and not drawn.any()
    )
    settings, camera = Settings.of(workshop.robot), workshop.truth.camera
    rows = []
    for height in (0.0, 0.08):
        drawn, text = area_look(camera, workshop._camera_to_footprint, settings, height)(np.zeros((512, 640), np.uint8))
        rows.append(np.nonzero(np.all(drawn == GREEN, axis=2))[0])
    assert text == "the scanned area is outlined" and all(len(row) > 300 for row in rows)
    assert abs(rows[0].mean() - rows[1].mean()) > 3


@pytest.mark.slow
def test_a_board_that_is_not_on_the_floor_is_asked_for_again_with_the_reason(
    workshop: SimulatedWorkshop, tmp_path, monkeypatch: pytest.MonkeyPatch
):
    """Without a reason first, then with that of the last image, which is also in the final error."""
    asked, shown = [], []

    class Forgetful:
        def lay_board(self, board: BoardSpec, why_again: str) -> None:
            asked.append(why_again)
            workshop.clear()

    monkeypatch.setattr("guara_perception.app.record.record.MOST_TRIES", 2)
    plan = SessionPlan("guara", BOARD, cross_points(workshop.robot), (0.0, 0.04), workshop.stance)
    writer = SessionWriter(tmp_path / "session", plan)
    with workshop.rangefinder as rangefinder, pytest.raises(RecordingFailed, match="floor was not found: .+"):
        _record_floor(writer, rangefinder, Forgetful(), lambda picture, text: shown.append(text))
    assert asked[0] == "" and asked[1] in shown and asked[1] != ""
