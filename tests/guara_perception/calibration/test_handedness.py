"""Mirrored pictures: targets that reveal them, and sessions whose targets cannot."""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

from guara_perception.app.record.simulated import SimulatedWorkshop
from guara_perception.app.targets.drawings import cross_points, parse_board
from guara_perception.calibration.board import MIRRORED, BoardSpec
from guara_perception.calibration.calibrate_session import calibrate_session
from guara_perception.calibration.calibration import CameraModel
from guara_perception.calibration.calibration_input import CalibrationSession, Fiducials
from guara_perception.calibration.find_board import find_board
from guara_perception.calibration.mount import locate_camera, looks_mirrored
from guara_perception.exceptions import CalibrationRefused
from guara_perception.images import to_grey
from guara_perception.simulation.specimen import specimen
from guara_perception.simulation.target_pictures import TargetCamera
from kinematics import RobotModel, Stance
from tests.guara_perception.calibration.breaking import Picture, with_frames, with_pictures

Flip = Callable[[Picture], Picture]
LEFT_RIGHT, UP_DOWN = (lambda p: np.ascontiguousarray(p[:, ::-1])), (lambda p: np.ascontiguousarray(p[::-1]))
HALF_TURN, QUARTER = (lambda p: np.ascontiguousarray(p[::-1, ::-1])), (lambda p: np.ascontiguousarray(np.rot90(p)))


def flipped(session: CalibrationSession, flip: Flip) -> CalibrationSession:
    """Session recorded with a driver that flips all pictures."""
    for number in range(len(session.plates)):
        session = with_frames(session, number, flip)
    return with_pictures(session, lambda name, picture: flip(picture))


def undeclared(session: CalibrationSession) -> CalibrationSession:
    """Session without the colour of its board's first square, so that nothing reveals a mirrored picture."""
    return dataclasses.replace(session, board=dataclasses.replace(session.board, first_square=None))


@pytest.mark.parametrize("columns", [9, 7])
def test_the_printed_board_tells_mirrored_pictures(columns: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """The board that `guara targets` prints is found in all rotations, and refused in all mirror images."""
    workshop = SimulatedWorkshop()
    seen: list[Picture] = []
    board = parse_board(f"{columns}x{16 - columns}", 0.03)
    workshop.use_board(board)
    monkeypatch.setattr(workshop, "_still", seen.append)
    workshop.show_board("")
    for turns in range(4):
        turned = np.ascontiguousarray(np.rot90(seen[0], turns))
        assert find_board(turned, board).is_usable
        assert find_board(LEFT_RIGHT(turned), board).reason == MIRRORED
        other = dataclasses.replace(board, first_square="white")
        assert find_board(turned, other).reason == MIRRORED and find_board(LEFT_RIGHT(turned), other).is_usable


@pytest.mark.parametrize(("columns", "rows", "tells"), [(9, 7, True), (7, 9, True), (8, 7, False), (7, 7, False)])
def test_boards_that_look_like_their_mirror_image_tell_nothing(columns: int, rows: int, tells: bool) -> None:
    """Both numbers of squares must be even and unequal, and the colours must be known."""
    assert parse_board(f"{columns}x{rows}", 0.03).shows_handedness is tells
    assert not BoardSpec(columns, rows, 0.03).shows_handedness
    assert parse_board(f"{columns}x{rows}", 0.03, "charuco").shows_handedness


def test_five_crosses_tell_mirrored_pictures(session: CalibrationSession, robot: RobotModel) -> None:
    """The crosses that are printed differ from their mirror image; four in the corners of a rectangle do not."""
    assert not looks_mirrored(cross_points(robot))
    assert looks_mirrored(session.fiducials.points_in_footprint)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("flip", "name"),
    [
        (LEFT_RIGHT, "mirrored"),
        (UP_DOWN, "mirrored"),
        (QUARTER, "turned by 90 degrees"),
        (lambda p: np.ascontiguousarray(p.swapaxes(0, 1)), "mirrored and turned by 90 degrees"),
    ],
)
def test_changed_pictures_of_five_crosses_are_named(robot: RobotModel, flip: Flip, name: str) -> None:
    """The crosses fit once the change is undone, with the lens of such pictures."""
    truth = specimen(robot, (640, 512), None)
    stance = Stance(robot.posture(robot.config.scan_posture), robot.legs, None)
    to_footprint = robot.stance_pose(stance).transform_base_to_footprint
    points = cross_points(robot)
    picture = flip(TargetCamera.of(truth.camera).crosses(points, to_footprint @ truth.transform_camera_to_base))
    # The nominal lens is centred and its pixels are square: turned, only its sides are exchanged.
    (focal, *_), _, _ = truth.camera.matrix
    height, width = picture.shape[:2]
    matrix = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]])
    camera = CameraModel((width, height), matrix, truth.camera.distortion)
    with pytest.raises(CalibrationRefused, match=f"fiducials: the picture of the crosses is {name}: switch this off"):
        locate_camera(to_grey(picture), camera, Fiducials("", points), to_footprint @ robot.transform_camera_to_base)


@pytest.mark.parametrize("flip", [LEFT_RIGHT, UP_DOWN])
def test_a_mirrored_session_is_refused(session: CalibrationSession, robot: RobotModel, flip: Flip) -> None:
    """The message names a picture and the remedy."""
    with pytest.raises(CalibrationRefused, match=r"14 of 14 board pictures are mirrored \(board_00.jpg\): switch"):
        calibrate_session(flipped(session, flip), robot)


@pytest.mark.slow
def test_a_session_that_cannot_tell_is_usable(few_stripes: CalibrationSession, robot: RobotModel) -> None:
    """At most, mirrored or not, with one line of advice; a statement of the user makes it good."""
    old = undeclared(few_stripes)
    for told in (old, flipped(old, LEFT_RIGHT)):
        found = calibrate_session(told, robot)
        assert found.verdict == "usable" and found.calibration.quality["handedness"] is None
        (reason,) = found.reasons
        assert reason.startswith("the targets look the same in mirrored pictures: lay down the five crosses")
    vouched = calibrate_session(few_stripes, robot, not_mirrored=True)
    assert (vouched.verdict, vouched.calibration.quality["handedness"]) == ("good", "the user")


@pytest.mark.slow
def test_a_rolled_camera_is_told(few_stripes: CalibrationSession, robot: RobotModel) -> None:
    """Bottom-up pictures are refused if the targets are ambiguous; otherwise a turn by 180 degrees is usable."""
    rolled = (
        "the camera is rolled by 180 degrees relative to its mount in the URDF: the driver delivers bottom-up pictures"
    )
    for flip in (UP_DOWN, HALF_TURN):
        with pytest.raises(CalibrationRefused, match=rolled):
            calibrate_session(flipped(undeclared(few_stripes), flip), robot)
    found = calibrate_session(flipped(few_stripes, HALF_TURN), robot)
    assert found.verdict == "usable" and found.reasons[0].startswith(rolled)
    assert calibrate_session(flipped(few_stripes, HALF_TURN), robot, not_mirrored=True).verdict == "good"
