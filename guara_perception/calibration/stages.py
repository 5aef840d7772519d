"""Stages of a calibration that read pictures: boards, and laser lines on plates, with their refusals."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from guara_perception.arrays import Image
from guara_perception.calibration.board import CHECKERBOARD, BoardView
from guara_perception.calibration.bundle import CameraFit
from guara_perception.calibration.checkerboard import other_size
from guara_perception.calibration.faults import check_lines, check_order, find_jumps, refuse_jumps
from guara_perception.calibration.find_board import find_board
from guara_perception.calibration.intrinsics import MIN_VIEWS, Intrinsics, calibrate_intrinsics
from guara_perception.calibration.mirror_model import MirrorModel
from guara_perception.calibration.plates import LostLine, PlateLine, plate_lines
from guara_perception.calibration.session import CalibrationSession
from guara_perception.calibration.sweep import line_points
from guara_perception.exceptions import CalibrationMismatch, CalibrationRefused


def find_boards(session: CalibrationSession, advance: Callable[[], None]) -> tuple[list[BoardView], tuple[int, int]]:
    """Find the board in every picture of it; return the views and the size of the pictures.

    Raises:
        CalibrationMismatch: pictures of different sizes.
        CalibrationRefused: no pictures at all.
    """
    views: list[BoardView] = []
    size: tuple[int, int] | None = None
    for name in session.board_images:
        picture = session.read_picture(name)
        if size is None:
            size = (picture.shape[1], picture.shape[0])
        check_size(picture, size, name, session.source)
        views.append(find_board(picture, session.board, name))
        advance()
    if size is None:
        raise CalibrationRefused(f"{session.source}: board_images is empty, {MIN_VIEWS} or more pictures are needed")
    return views, size


def check_size(picture: Image, size: tuple[int, int], name: str, source: str) -> None:
    """Refuse a picture of another size than the first board picture.

    Raises:
        CalibrationMismatch: the sizes differ.
    """
    if (picture.shape[1], picture.shape[0]) != size:
        raise CalibrationMismatch(
            f"{source}: {name} is {picture.shape[1]}x{picture.shape[0]} px, the boards are {size[0]}x{size[1]}: all "
            "pictures of a session come from one camera at one setting"
        )


def calibrate_boards(
    session: CalibrationSession, views: Sequence[BoardView], size: tuple[int, int], distortion: str
) -> Intrinsics:
    """Lens from the usable views.

    Raises:
        CalibrationRefused: too few usable views, all parallel, or the board on the floor cannot be used.
    """
    usable = [view for view in views if view.is_usable]
    if len(usable) < MIN_VIEWS:
        raise CalibrationRefused(
            f"{len(usable)} of {len(views)} board views are usable, {MIN_VIEWS} or more are needed"
            f"{_hint(session, views)}{_faults(views)}"
        )
    ground = next(view for view in views if view.name == session.ground_board_image)
    if not ground.is_usable:
        raise CalibrationRefused(f"the board on the floor cannot be used: {ground.name}: {ground.reason}")
    return calibrate_intrinsics(usable, session.board, size, distortion, keep=(ground.name,))


def find_lines(
    session: CalibrationSession, fit: CameraFit, mirror: MirrorModel, advance: Callable[[], None]
) -> tuple[list[PlateLine], list[LostLine]]:
    """Laser lines on all plates, checked for swapped heights and missed steps.

    Raises:
        CalibrationRefused: too few stripes on a plate, a missed step, swapped heights.
        CalibrationMismatch: frames of another size.
    """
    lines: list[PlateLine] = []
    lost: list[LostLine] = []
    for number, plate in enumerate(session.plates):
        found, gone = plate_lines(plate, number, fit.camera, fit.transform_camera_to_footprint, mirror, advance)
        check_lines(found, plate, number, [f"stripe index {one.index}: {one.reason}" for one in gone])
        lines += found
        lost += gone
    check_lines_and_plates(session, lines, fit, mirror)
    return lines, lost


def check_lines_and_plates(
    session: CalibrationSession, lines: Sequence[PlateLine], fit: CameraFit, mirror: MirrorModel
) -> None:
    """Refuse lines that contradict the heights of their plates or the commanded mirror angles.

    Raises:
        CalibrationRefused: a missed step, swapped heights.
    """
    points = [line_points(fit.camera, fit.transform_camera_to_footprint, line) for line in lines]
    check_order(lines, session.plates)
    refuse_jumps(find_jumps(lines, points, mirror.point), session.plates)


def _hint(session: CalibrationSession, views: Sequence[BoardView]) -> str:
    """Whether the first picture without a board shows one of another size."""
    if session.board.pattern != CHECKERBOARD:
        return ""
    for view in views:
        if "inner corners" in view.reason:
            size = other_size(session.read_picture(view.name), session.board)
            if size is None:
                return ""
            given = f"{session.board.columns}x{session.board.rows}"
            return (
                f"; wrong corner count: {view.name} shows {size[0]}x{size[1]} inner corners, the session says {given}"
            )
    return ""


def _faults(views: Sequence[BoardView]) -> str:
    """The first few views that cannot be used, with their reasons."""
    bad = [f"{view.name}: {view.reason}" for view in views if not view.is_usable]
    more = f"; and {len(bad) - 3} more" if len(bad) > 3 else ""
    return f"; {'; '.join(bad[:3])}{more}" if bad else ": take more pictures of the board"
