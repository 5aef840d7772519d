"""Every fault of a session is refused with its reason; each test breaks a good session in one way."""

import dataclasses
from collections.abc import Callable

import cv2
import numpy as np
import pytest

from guara_perception.calibration.calibrate_session import calibrate_session
from guara_perception.calibration.calibration_input import CalibrationSession, Fiducials
from guara_perception.calibration.result import CalibrationResult
from guara_perception.exceptions import CalibrationMismatch, CalibrationRefused, InvalidInput
from kinematics import RobotModel
from tests.guara_perception.calibration.breaking import (
    Picture,
    missed_step,
    with_frames,
    with_pictures,
    with_plate,
)

Break = Callable[[CalibrationSession], CalibrationSession]


def boards_only(change: Callable[[Picture], Picture]) -> Callable[[str, Picture], Picture]:
    """A change of the board pictures that leaves the others alone."""
    return lambda name, picture: change(picture) if name.startswith("board") else picture


def blank(session: CalibrationSession) -> CalibrationSession:
    """The shutter stayed closed."""
    return with_pictures(session, boards_only(np.zeros_like))


def blurred(session: CalibrationSession) -> CalibrationSession:
    """The lens is out of focus."""
    return with_pictures(session, boards_only(lambda picture: cv2.GaussianBlur(picture, (0, 0), 3)))


def parallel(session: CalibrationSession) -> CalibrationSession:
    """The board was only shifted, never tilted."""
    flat = session.read_picture("board_00.jpg")
    shift = {name: 3 * index for index, name in enumerate(session.board_images)}
    return with_pictures(
        session, lambda name, picture: np.roll(flat, shift[name], axis=1) if name in shift else picture
    )


def square(session: CalibrationSession) -> CalibrationSession:
    """The session gives squares of 25 mm for a board of 30 mm."""
    return dataclasses.replace(session, board=dataclasses.replace(session.board, square=0.025))


def board_of(columns: int, rows: int) -> Break:
    """The session gives another number of corners."""
    return lambda session: dataclasses.replace(
        session,
        board=dataclasses.replace(session.board, columns=columns, rows=rows),
        board_images=session.board_images[:2],
    )


def few(session: CalibrationSession) -> CalibrationSession:
    """Four views, the board on the floor among them."""
    return dataclasses.replace(session, board_images=session.board_images[:4])


def fiducial_points(change: Callable[[np.ndarray], np.ndarray]) -> Break:
    """The positions of the fiducials were measured wrongly."""

    def broken(session: CalibrationSession) -> CalibrationSession:
        points = change(session.fiducials.points_in_footprint.copy())
        return dataclasses.replace(session, fiducials=Fiducials(session.fiducials.image, points))

    return broken


def swapped(session: CalibrationSession) -> CalibrationSession:
    """The heights of two plates are exchanged."""
    heights = [session.plates[2].height, session.plates[1].height, session.plates[0].height]
    plates = [dataclasses.replace(plate, height=h) for plate, h in zip(session.plates, heights, strict=True)]
    return dataclasses.replace(session, plates=tuple(plates))


def dark_laser(session: CalibrationSession) -> CalibrationSession:
    """The laser was off during one plate scan."""
    scan = session.plates[1].scan
    return with_plate(session, 1, read_frame=lambda name: scan.read_frame(str(scan.stripes[0].off)))


REFUSED = [
    (blank, r"0 of 14 board views are usable; 5 or more.*board_00.jpg: the picture is blank"),
    (blurred, r"0 of 14 board views are usable.*blurred: black-white edges are \d+\.\d px wide; allowed: up to 5 px"),
    (few, r"4 of 4 board views are usable; 5 or more are needed: take more pictures"),
    (parallel, r"all 14 board views are nearly parallel .* tilt the board"),
    (square, r"wrong square size: .* measure 30\.\d\d mm, but the session states 25\.00 mm"),
    (board_of(8, 6), r"wrong corner count: board_00.jpg shows 9x7 inner corners, but the session states 8x6"),
    (fiducial_points(lambda p: np.column_stack((p[:, 0], np.zeros(4)))), r"the points are collinear"),
    (fiducial_points(lambda p: p + [[0.02, 0], [0, 0], [0, 0], [0, 0]]), r"are not at points_in_footprint \(misfit"),
    (fiducial_points(lambda p: p + [0.2, 0.0]), r"of 4 crosses were found near where the nominal mount predicts them"),
    (lambda s: dataclasses.replace(s, plates=s.plates[:1]), r"two or more heights, .* heights in the session: 0 mm"),
    (lambda s: dataclasses.replace(s, plates=()), r"heights in the session: none"),
]
# Found only once the camera is calibrated, or after many tries; and cases that resemble one above.
REFUSED_LATE = [
    (board_of(7, 5), r"wrong corner count: board_00.jpg shows 9x7 inner corners, but the session states 7x5"),
    (board_of(10, 8), r"wrong corner count: board_00.jpg shows 9x7 inner corners, but the session states 10x8"),
    (swapped, r"plate heights look swapped: plate_00 \(80 mm\) and plate_40 \(40 mm\)"),
    (lambda s: missed_step(s, 1, 18), r"missed a step.*plate plate_40: after stripe index 34 .* -1\.50 degrees"),
    (dark_laser, r"plate plate_40: 0 of 35 stripes were found \(80 % needed\); for example stripe index 0"),
]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("breaks", "reason"), [*REFUSED, *(pytest.param(*late, marks=pytest.mark.heavy) for late in REFUSED_LATE)]
)
def test_fault_is_refused(session: CalibrationSession, robot: RobotModel, breaks: Break, reason: str) -> None:
    """A session with this fault is refused, and the message says what is wrong."""
    with pytest.raises(CalibrationRefused, match=reason):
        calibrate_session(breaks(session), robot)


def resized(name: str) -> Break:
    """One still picture has another size."""
    return lambda session: with_pictures(
        session, lambda other, picture: cv2.resize(picture, (320, 256)) if other == name else picture
    )


MISMATCHES = [
    (resized("board_05.jpg"), r"board_05.jpg has 320x256 px instead of 640x512"),
    (resized("fiducials.jpg"), r"fiducials.jpg has 320x256 px instead of 640x512"),
    (
        lambda s: with_frames(s, 0, lambda picture: cv2.resize(picture, (320, 256))),
        r"frame on_000.jpg has 320x256 px instead of 640x512",
    ),
]


@pytest.mark.slow
@pytest.mark.parametrize(("breaks", "reason"), MISMATCHES)
def test_pictures_of_another_size(session: CalibrationSession, robot: RobotModel, breaks: Break, reason: str) -> None:
    """A picture of another size is refused by name, whatever it shows."""
    with pytest.raises(CalibrationMismatch, match=reason):
        calibrate_session(breaks(session), robot)


ORDERS = [([1, 0, 2, 3], "1, 2"), ([2, 3, 0, 1], "1, 2, 3, 4"), ([1, 0, 3, 2], "1, 2, 3, 4")]


@pytest.mark.parametrize(("order", "named"), ORDERS)
def test_permuted_and_mirrored_pixels(
    session: CalibrationSession, robot: RobotModel, result: CalibrationResult, order: list[int], named: str
) -> None:
    """Pixels given in another order than the points are refused; the message names which, even for half a turn."""
    pixels = np.array([mark.centre_px for mark in result.floor.marks])[order]
    fiducials = dataclasses.replace(session.fiducials, points_px=pixels)
    with pytest.raises(CalibrationRefused, match=f"numbers {named} are permuted or mirrored; the order"):
        calibrate_session(dataclasses.replace(session, fiducials=fiducials), robot)


def test_pixels_of_other_points(session: CalibrationSession, robot: RobotModel, result: CalibrationResult) -> None:
    """Pixels that fit the points in no order are refused as such."""
    pixels = np.array([mark.centre_px for mark in result.floor.marks]) + [[90, 0], [0, 70], [0, 0], [0, 0]]
    fiducials = dataclasses.replace(session.fiducials, points_px=pixels)
    with pytest.raises(CalibrationRefused, match="do not match in any order"):
        calibrate_session(dataclasses.replace(session, fiducials=fiducials), robot)


def test_session_of_another_robot(session: CalibrationSession, robot: RobotModel) -> None:
    """A session is calibrated with the model of its own robot only."""
    plates = tuple(
        dataclasses.replace(plate, scan=dataclasses.replace(plate.scan, robot="baru")) for plate in session.plates
    )
    other = dataclasses.replace(session, robot="baru", plates=plates)
    with pytest.raises(CalibrationMismatch, match="session of robot 'baru', but robot 'guara' was given"):
        calibrate_session(other, robot)
    with pytest.raises(InvalidInput, match="plate_00 was scanned by robot 'baru', but the session is from 'guara'"):
        dataclasses.replace(session, plates=plates)


def test_plate_scanned_from_another_stance(session: CalibrationSession) -> None:
    """A plate whose stance differs by more than 0.1 degrees in a joint is refused, naming joint and angle."""
    stance = session.stance
    moved = {**stance.joint_positions, "lh_kfe_joint": stance.joint_positions["lh_kfe_joint"] + np.deg2rad(0.2)}
    with pytest.raises(InvalidInput, match=r"plate plate_40 was scanned with lh_kfe_joint 0\.20 degrees away"):
        with_plate(session, 1, stance=dataclasses.replace(stance, joint_positions=moved))
    slightly = {**stance.joint_positions, "lh_kfe_joint": stance.joint_positions["lh_kfe_joint"] + np.deg2rad(0.05)}
    with_plate(session, 1, stance=dataclasses.replace(stance, joint_positions=slightly))


def test_unknown_distortion(session: CalibrationSession, robot: RobotModel) -> None:
    """A lens model that does not exist is refused with the list of those that do."""
    with pytest.raises(InvalidInput, match="distortion is 'fisheye', allowed: k1k2, k1k2p1p2, k1k2p1p2k3"):
        calibrate_session(session, robot, distortion="fisheye")


def test_the_plate_that_is_named_twice_is_told(session: CalibrationSession) -> None:
    """The message names only this plate."""
    first, second, *_ = session.plates
    with pytest.raises(InvalidInput, match=f"plates name the same scan twice: {second.name}$"):
        dataclasses.replace(session, plates=(first, second, second))


@pytest.mark.parametrize(
    ("points", "given"),
    [
        (np.zeros((4, 3)), r"shape \(4, 3\) given"),
        (np.zeros(8), r"shape \(8,\) given"),
        (0.5, r"shape \(\) given"),
        (np.zeros((3, 2)), "3 points given"),
    ],
)
def test_crosses_that_are_no_list_of_points_are_refused(points: object, given: str) -> None:
    """The message states the number of points only if they are points."""
    with pytest.raises(InvalidInput, match=rf"points_in_footprint: {given}; 4 or more \[x, y\] are needed"):
        Fiducials("crosses", points)
