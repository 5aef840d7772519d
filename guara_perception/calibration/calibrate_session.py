"""Calibration of a rangefinder from a session, stage by stage, with a verdict."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from guara_perception.calibration.board import CHECKERBOARD, MIRRORED, BoardView
from guara_perception.calibration.bundle import CameraFit, fit_camera
from guara_perception.calibration.calibration import Calibration, CameraModel
from guara_perception.calibration.calibration_input import CalibrationSession, check_size
from guara_perception.calibration.checkerboard import other_size
from guara_perception.calibration.checks import LEFT_OUT, camera_checks, laser_checks, mount_checks, stance_checks
from guara_perception.calibration.faults import (
    check_covered,
    check_heights,
    check_lines,
    check_mirror,
    check_order,
    find_jumps,
    is_bare_floor,
    lines_at_borders,
    refuse_jumps,
    suspect_plate,
)
from guara_perception.calibration.find_board import find_board
from guara_perception.calibration.intrinsics import (
    DISTORTIONS,
    MIN_VIEWS,
    Intrinsics,
    calibrate_intrinsics,
    given_intrinsics,
)
from guara_perception.calibration.laser import fit_laser, height_sigmas
from guara_perception.calibration.mirror_model import MirrorModel, nominal_mirror
from guara_perception.calibration.mount import (
    HANDEDNESS_ADVICE,
    ROLLED,
    ROLLED_CAMERA,
    check_ground_board,
    handedness_evidence,
    locate_camera,
)
from guara_perception.calibration.plates import BESIDE, LostLine, PlateLine, plate_lines
from guara_perception.calibration.quality import (
    GOOD,
    coverage,
    cross_validation,
    projection_uncertainty,
    quality_record,
    verdict_of,
)
from guara_perception.calibration.result import (
    CalibrationResult,
    covariance_record,
    mirror_record,
    paper_record,
    stripe_records,
    undistorted,
    warnings,
)
from guara_perception.calibration.surface_map import surface_map
from guara_perception.calibration.sweep import line_points
from guara_perception.exceptions import CalibrationMismatch, CalibrationRefused, InvalidInput
from guara_perception.images import to_grey
from guara_perception.progress import Progress
from guara_perception.settings import Settings
from kinematics import RobotModel
from kinematics.transforms import inverse


def calibrate_session(
    session: CalibrationSession,
    robot: RobotModel,
    *,
    distortion: str = "k1k2",
    camera: CameraModel | None = None,
    not_mirrored: bool = False,
    progress: Progress | None = None,
) -> CalibrationResult:
    """Calibrate the rangefinder of a session and judge the result.

    A poor calibration is returned too, with the verdict `refused`; `CalibrationRefused` means that there is none.

    Args:
        session: images and the geometry of their targets.
        robot: model of the robot, with nominal mounts.
        distortion: lens coefficients to estimate, one of `DISTORTIONS`.
        camera: known camera, which is then only verified with the images of the board; None = estimate the camera from
            these images.
        not_mirrored: True if the user states that the images are not mirrored; the colours of the board's squares are
            then not checked.
        progress: called with the number of processed images and the total.

    Raises:
        CalibrationRefused: a fault prevents the calibration; the message names it.
        CalibrationMismatch: the session belongs to another robot, or the images differ in size from each other or from
            those of the known camera.
        InvalidInput: unknown distortion model.
        MissingFile, FileFormatError: an image cannot be read.
        kinematics.KinematicsError: the stance does not fit the robot.
    """
    if distortion not in DISTORTIONS:
        raise InvalidInput(f"distortion is {distortion!r}, allowed: {', '.join(DISTORTIONS)}")
    if robot.name != session.robot:
        raise CalibrationMismatch(
            f"{session.source} is a session of robot {session.robot!r}, but robot {robot.name!r} was given: calibrate "
            "each robot from its own pictures"
        )
    check_heights(session.plates)
    if not_mirrored:
        session = replace(session, board=replace(session.board, first_square=None))
    laser_frames = sum(len(plate.scan.stripes) for plate in session.plates)
    total, done = len(session.board_images) + 1 + laser_frames, itertools.count(1)

    def advance() -> None:
        if progress is not None:
            progress(next(done), total)

    pose = robot.stance_pose(session.stance)
    to_footprint = np.asarray(pose.transform_base_to_footprint, dtype=np.float64)
    to_base = inverse(to_footprint)

    floor_picture = session.read_picture(session.fiducials.image)
    given, height, width = camera and camera.size, *floor_picture.shape[:2]
    if given and given != (width, height):
        raise CalibrationMismatch(
            f"{session.source}: the lens was calibrated at {given[0]}x{given[1]} px, but {session.fiducials.image} has "
            f"{width}x{height} px: give camera info for this picture size"
        )
    views, size = find_boards(session, advance, camera)
    intrinsics = calibrate_boards(session, views, size, distortion, camera)

    check_size(floor_picture, size, session.fiducials.image, session.source)
    camera_nominal = to_footprint @ robot.transform_camera_to_base
    floor = locate_camera(to_grey(floor_picture), intrinsics.camera, session.fiducials, camera_nominal)
    advance()
    ground = next((view for view in intrinsics.views if view.name == session.ground_board_image), None)
    handedness = handedness_evidence(session, not_mirrored)
    if floor.mount == ROLLED and not handedness:
        raise CalibrationRefused(f"{ROLLED_CAMERA}; these targets cannot tell which: {HANDEDNESS_ADVICE}")
    square = None
    if ground is not None:
        square = check_ground_board(intrinsics.camera, floor.transform_camera_to_footprint, ground, session.board)
    points = session.fiducials.points_in_footprint
    fit = fit_camera(intrinsics, session.board, session.ground_board_image, floor, points)

    mirror = nominal_mirror((to_footprint @ robot.transform_laser_to_base)[:3, 3])
    lines, lost = find_lines(session, fit, mirror, advance)
    laser = fit_laser(lines, session.plates, fit, mirror, to_base)
    check_mirror(laser.sweep)

    cells = coverage(intrinsics.views, size)
    distance = float(fit.transform_camera_to_footprint[2, 3])
    halves = None
    if not intrinsics.is_given:
        halves = cross_validation(intrinsics.views, session.board, size, distortion, distance)
    settings = Settings.of(robot)
    floor_sigma = projection_uncertainty(fit, settings.footprint_x[1])
    wanted = {stripe.index for plate in session.plates for stripe in plate.scan.stripes}
    missing = sorted(wanted - set(laser.stripes.indices))
    near, far = height_sigmas(fit, laser, lines, to_footprint, settings.footprint_x)
    checks = camera_checks(intrinsics, fit, floor, square, cells, halves[1] if halves else None, floor_sigma[1])
    camera_to_base = to_base @ fit.transform_camera_to_footprint
    checks += mount_checks(camera_to_base, robot.transform_camera_to_base, floor.mount)
    checks += stance_checks(robot, session.stance)
    checks += laser_checks(laser, near, far, len(missing), len(wanted))
    faults = warnings(session, views, intrinsics, lost, missing)
    if not handedness:
        faults.append(f"the targets look the same in mirrored pictures: {HANDEDNESS_ADVICE}")
    elif floor.mount == ROLLED and not not_mirrored:
        faults.append(f"{ROLLED_CAMERA}: rotate the mount in the URDF, or switch off the rotation in the driver")
    verdict, reasons = verdict_of(checks, faults)
    if laser.leave_one_out and any(check.name == LEFT_OUT and check.verdict != GOOD for check in checks):
        reasons = (suspect_plate(laser.leave_one_out, session.plates), *reasons)
    surface = surface_map(undistorted(fit.camera, np.array([mark.centre_px for mark in floor.marks])), points)
    mirror_in_camera = laser.sweep.mirror.in_frame(inverse(fit.transform_camera_to_footprint))
    calibration = Calibration(
        robot=session.robot,
        camera=replace(fit.camera, identity=session.camera_identity),
        transform_camera_to_base=camera_to_base,
        stripes=stripe_records(laser, session, missing, mirror_in_camera),
        mirror=mirror_record(laser, mirror_in_camera, floor, missing),
        paper=paper_record(surface, fit, lines),
        covariance=covariance_record(fit, laser),
        quality={**quality_record(checks, verdict, reasons), "handedness": handedness or None},
    )
    return CalibrationResult(
        calibration=calibration,
        session=session,
        transform_base_to_footprint=to_footprint,
        intrinsics=intrinsics,
        floor=floor,
        fit=fit,
        surface=surface,
        lines=tuple(lines),
        lost=tuple(lost),
        laser=laser,
        checks=tuple(checks),
        coverage=cells,
        cross_validation=halves,
        floor_sigma=floor_sigma,
        area=(settings.footprint_x, settings.footprint_y),
    )


def find_boards(
    session: CalibrationSession, advance: Callable[[], None], camera: CameraModel | None
) -> tuple[list[BoardView], tuple[int, int]]:
    """Find the board in all board images; return the views and the image size.

    Raises:
        CalibrationMismatch: an image differs in size from the others or from the known camera.
        CalibrationRefused: no camera is known, and the session has no board images or none of the board on the floor.
        MissingFile, FileFormatError: an image cannot be read.
    """
    views: list[BoardView] = []
    size = None if camera is None else camera.size
    if camera is None and not (session.board_images and session.ground_board_image):
        lacking = "ground_board_image" if session.board_images else "board_images"
        raise CalibrationRefused(
            f"{session.source} has no {lacking}: {MIN_VIEWS} or more pictures of the board are needed, one of them "
            "with the board on the floor, or a known lens (--camera-info)"
        )
    for name in session.board_images:
        picture = session.read_picture(name)
        if size is None:
            size = (picture.shape[1], picture.shape[0])
        check_size(picture, size, name, session.source)
        views.append(find_board(picture, session.board, name))
        advance()
    assert size is not None
    return views, size


def calibrate_boards(
    session: CalibrationSession,
    views: Sequence[BoardView],
    size: tuple[int, int],
    distortion: str,
    camera: CameraModel | None,
) -> Intrinsics:
    """Intrinsics estimated from the usable views, or those of the known camera.

    Raises:
        CalibrationRefused: a view is mirrored; the view of the board on the floor is not usable; or, without a known
            camera, too few usable views remain or all are nearly parallel.
    """
    mirrored = [view.name for view in views if view.reason == MIRRORED]
    if mirrored:
        raise CalibrationRefused(
            f"{session.source}: {len(mirrored)} of {len(views)} board pictures are mirrored ({mirrored[0]}): switch "
            "off the flip in the camera's driver and record the session again, or pass --not-mirrored if black and "
            "white are swapped relative to the board printed by `guara targets`"
        )
    usable = [view for view in views if view.is_usable]
    if camera is None and len(usable) < MIN_VIEWS:
        raise CalibrationRefused(
            f"{len(usable)} of {len(views)} board views are usable; {MIN_VIEWS} or more are needed"
            f"{_hint(session, views)}{_faults(views)}"
        )
    ground = next((view for view in views if view.name == session.ground_board_image), None)
    if ground is not None and not ground.is_usable:
        raise CalibrationRefused(f"the board on the floor cannot be used: {ground.name}: {ground.reason}")
    if camera is not None or ground is None:
        assert camera is not None
        return given_intrinsics(camera, usable, session.board)
    return calibrate_intrinsics(usable, session.board, size, distortion, keep=(ground.name,))


def find_lines(
    session: CalibrationSession, fit: CameraFit, mirror: MirrorModel, advance: Callable[[], None]
) -> tuple[list[PlateLine], list[LostLine]]:
    """Find the laser lines on all plates, and check them for swapped heights and missed steps.

    Raises:
        CalibrationRefused: a plate is met by no stripe, or too few of those that meet it were found; too few stripes
            were found at two heights; plate heights are swapped; or the laser lines jump, for instance because the
            mirror missed a step.
        CalibrationMismatch: the size of a frame differs from that of the camera.
        MissingFile, FileFormatError: a frame cannot be read.
    """
    camera, transform = fit.camera, fit.transform_camera_to_footprint
    lines: list[PlateLine] = []
    lost: list[LostLine] = []
    on_floor: dict[int, PlateLine] = {}
    # The bare floor comes first, because its lines show which stripes of the other scans miss their plate.
    for number in sorted(range(len(session.plates)), key=lambda number: abs(session.plates[number].height)):
        plate = session.plates[number]
        found, gone = plate_lines(plate, number, camera, transform, mirror, on_floor, advance)
        check_lines(plate, len(found), gone)
        if is_bare_floor(plate) and not on_floor:
            on_floor = {line.index: line for line in found}
        lines += found
        lost += gone
    lines.sort(key=lambda line: line.plate)
    check_order(lines, session.plates)
    has_floor = bool(on_floor)
    while True:
        points = [line_points(camera, transform, line) for line in lines]
        jumps = find_jumps(lines, points, mirror.point)
        at_borders = {(line.plate, line.index) for line in lines_at_borders(jumps, lines, lost)}
        if not at_borders:
            break
        lines = [line for line in lines if (line.plate, line.index) not in at_borders]
        lost += [LostLine(index, plate, BESIDE) for plate, index in at_borders]
    refuse_jumps(jumps, session.plates, has_floor)
    check_covered(lines, session.plates)
    return lines, lost


def _hint(session: CalibrationSession, views: Sequence[BoardView]) -> str:
    """Hint at the board's true corner count, from the first image without a board of the stated size; may be empty."""
    view = next((view for view in views if "inner corners" in view.reason), None)
    if view is None or session.board.pattern != CHECKERBOARD:
        return ""
    size = other_size(session.read_picture(view.name), session.board)
    if size is None:
        return ""
    given = f"{session.board.columns}x{session.board.rows}"
    return f"; wrong corner count: {view.name} shows {size[0]}x{size[1]} inner corners, but the session states {given}"


def _faults(views: Sequence[BoardView]) -> str:
    """First three unusable views with their reasons; if all are usable, the advice to take more pictures."""
    bad = [f"{view.name}: {view.reason}" for view in views if not view.is_usable]
    more = f"; and {len(bad) - 3} more" if len(bad) > 3 else ""
    return f"; {'; '.join(bad[:3])}{more}" if bad else ": take more pictures of the board"
