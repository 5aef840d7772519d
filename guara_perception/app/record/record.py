"""Recording of a calibration session, in which an operator is guided through all parts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

from guara_perception.app.devices_file import Devices, load_devices, save_devices
from guara_perception.app.node.rangefinder import Rangefinder
from guara_perception.app.record.board_advice import BoardAdvice
from guara_perception.app.record.live_pictures import Watch, area_look, board_look, crosses_look, plain, show_while
from guara_perception.app.record.operator import Operator
from guara_perception.app.record.plate_scan import nominal_order, scan_uncalibrated
from guara_perception.app.record.session_writer import CROSSES_PICTURE, FLOOR_PICTURE, SessionWriter
from guara_perception.app.targets.drawings import cross_points
from guara_perception.arrays import Float, Image
from guara_perception.calibration.calibration import CameraModel, check_identity
from guara_perception.calibration.calibration_input import Fiducials
from guara_perception.calibration.find_board import find_board
from guara_perception.calibration.intrinsics import calibrate_intrinsics
from guara_perception.calibration.mount import MOUNTS, check_extent, locate_camera
from guara_perception.exceptions import CalibrationRefused, InvalidInput, PerceptionError, errors_as
from guara_perception.fields import read_json
from guara_perception.images import to_grey
from guara_perception.settings import Settings
from kinematics import RobotModel

DEVICES_FILE: Final = "devices.toml"
FIRST_EXPOSURE_S: Final = 0.008
GRAB_SECONDS: Final = 2.0
# Number of judged images of the board after which the recording fails. Three frames are taken for each, so this is half
# an hour at 30 frames per second.
MOST_PICTURES: Final = 18_000
MOST_TRIES: Final = 20
# Largest plausible coordinate of a cross [m]: a robot's camera does not see the floor farther away.
FARTHEST_CROSS_M: Final = 5.0


class RecordingFailed(PerceptionError, RuntimeError):
    """Session that could not be completed. Its images are kept, and the same command resumes it."""


def record_session(
    writer: SessionWriter,
    robot: RobotModel,
    rangefinder: Rangefinder,
    devices: Devices,
    operator: Operator,
    *,
    report: Callable[[str], None],
    watch: Watch = lambda picture, request: None,
) -> Path:
    """Record the missing parts of a session and finish it.

    Args:
        writer: writer of the session's folder; parts that the folder already has are not recorded again.
        robot: model of the robot.
        rangefinder: open board and camera.
        devices: devices chosen by the user, written to the folder with the metered exposure and the measured lag. A
            resumed session uses those of its folder.
        operator: person or program that places board, crosses and plates in front of the camera.
        report: called with a line of text for each task, with the number of board images, and with each problem of a
            scan.
        watch: called with each camera image and a text, either a remark on the image or a request to the operator; for
            a live page.

    Returns:
        Path of `session.json`.

    Raises:
        RecordingFailed: after many attempts, the board was not shown as needed, or board or crosses on the floor were
            not found.
        CalibrationRefused: the camera cannot be calibrated or located with the recorded images.
        PlateScanFailed, MirrorSlipped: the scan of a plate failed, as in `scan_uncalibrated`.
        CalibrationMismatch: the connected camera is not that of the interrupted session.
        FileFormatError: a file of the interrupted session cannot be read.
        drivers.DriverError: a device failed; another call with the same folder resumes the session.
    """
    plan = writer.plan
    if writer.has(DEVICES_FILE):
        _as_before(rangefinder, load_devices(writer.folder / DEVICES_FILE))
    else:
        report("the bare floor")
        show_while(operator.clear, lambda: _picture(rangefinder), plain, watch)
        report("metering the exposure and measuring the camera's lag")
        save_devices(measured_devices(robot, rangefinder, devices), writer.folder / DEVICES_FILE)
    report("views of the hand-held board")
    _record_boards(writer, rangefinder, operator, report, watch)
    if not writer.has(FLOOR_PICTURE):
        report("the board on the floor")
        _record_floor(writer, rangefinder, operator, watch)
    if not writer.has(CROSSES_PICTURE):
        report("the crosses")
        _record_crosses(writer, robot, rangefinder, operator, watch)
    if all(writer.has(name) for name in writer.plate_names):
        return writer.finish()
    lens, crosses = _lens(writer), Fiducials(CROSSES_PICTURE, plan.crosses)
    floor = locate_camera(to_grey(writer.read(CROSSES_PICTURE)), lens, crosses, _nominal(writer, robot))
    to_footprint, settings = floor.transform_camera_to_footprint, Settings.of(robot)

    def progress(picture: Image, done: int, total: int) -> None:
        watch(picture, f"stripe {done} of {total}")

    for name, plate in zip(writer.plate_names, plan.plates, strict=True):
        if not writer.has(name):
            task = f"the plate of {1e3 * plate:g} mm" if plate else "the bare floor"
            report(task)
            look = area_look(lens, to_footprint, settings, plate)
            show_while(partial(operator.lay_plate, plate), lambda: _picture(rangefinder), look, watch)
            report(f"scanning {task}")
            folder = writer.folder / name
            for problem in scan_uncalibrated(rangefinder, robot, plan.stance, folder, on_stripe=progress):
                report(f"{name}: {problem}")
    return writer.finish()


def planned_crosses(path: Path | None, robot: RobotModel, scale: float = 1.0) -> Float:
    """Positions (n, 2) of the crosses in base_footprint [m], after a check that they can be used.

    Args:
        path: JSON file with measured positions; None = those of the printed mat.
        robot: robot for which the mat was printed.
        scale: scale at which the mat was printed.

    Raises:
        MissingFile, FileFormatError: the file does not exist or cannot be read.
        InvalidInput: there are fewer than four crosses, all are on one line, or a coordinate exceeds FARTHEST_CROSS_M.
    """
    points = scale * cross_points(robot) if path is None else read_json(path).array("points_in_footprint", (None, 2))
    source = "crosses" if path is None else str(path)
    farthest = float(np.abs(points).max(initial=0.0))
    if farthest > FARTHEST_CROSS_M:
        raise InvalidInput(
            f"{source}: a coordinate of a cross is {farthest:g} m; allowed: up to {FARTHEST_CROSS_M:g} m; give metres, "
            "not millimetres"
        )
    with errors_as(InvalidInput, source, CalibrationRefused, InvalidInput):
        check_extent(Fiducials(CROSSES_PICTURE, points).points_in_footprint)
    return points


def measured_devices(robot: RobotModel, rangefinder: Rangefinder, devices: Devices) -> Devices:
    """Meter the exposure on a stripe, lock all settings and measure the lag; return the devices with these values.

    Raises:
        drivers.DriverError: a device failed, the camera rejects a setting, or exposure or lag cannot be measured.
    """
    from drivers import CameraSettings, measure_lag, meter_exposure

    board, camera = rangefinder.board, rangefinder.camera
    order = nominal_order(robot)
    rangefinder.lost_steps(order)
    centre_angle = order[len(order) // 2][1]
    held = rangefinder.lock(CameraSettings(**devices.settings))
    result = meter_exposure(board, camera, centre_angle, exposure=held.exposure or FIRST_EXPOSURE_S)
    settings = {**devices.settings, **({} if result.exposure is None else {"exposure": float(result.exposure)})}
    rangefinder.lock(CameraSettings(**settings))
    board.go_to_angle(centre_angle)
    lag = measure_lag(board, camera)
    camera.lag = lag.lag
    return replace(devices, settings=settings, lag=float(lag.lag), identity=camera.identity)


def _as_before(rangefinder: Rangefinder, devices: Devices) -> None:
    """Lock the camera to the settings of an interrupted session, so that all its images have the same exposure.

    Raises:
        CalibrationMismatch: another camera is connected.
        drivers.DriverError: the camera rejects a setting.
    """
    from drivers import CameraSettings

    check_identity(rangefinder.camera.identity, devices.identity, "the connected device")
    rangefinder.lock(CameraSettings(**devices.settings))
    if devices.lag is not None:
        rangefinder.camera.lag = devices.lag


def _picture(rangefinder: Rangefinder) -> Image:
    return np.asarray(rangefinder.camera.grab(GRAB_SECONDS).image)


def _fresh(rangefinder: Rangefinder) -> Image:
    """Grab an image whose exposure begins after this call; an exposure that has already begun is dropped."""
    rangefinder.camera.flush()
    _picture(rangefinder)
    return _picture(rangefinder)


def _record_boards(
    writer: SessionWriter, rangefinder: Rangefinder, operator: Operator, report: Callable[[str], None], watch: Watch
) -> None:
    advice = BoardAdvice(writer.plan.board)
    for name in writer.boards:
        picture = writer.read(name)
        view, _ = advice.judge(picture, name=name)
        if view.is_usable:
            advice.take(view, picture.shape)
    request = "hold up the board"
    for _ in range(MOST_PICTURES):
        if advice.is_complete():
            report(f"{len(advice.views)} pictures of the board")
            return
        operator.show_board(request)
        before, picture = _fresh(rangefinder), _picture(rangefinder)
        name = f"board_{len(writer.boards):02d}.png"
        view, problem = advice.judge(picture, before, name)
        if not problem:
            writer.write(name, picture)
            advice.take(view, picture.shape)
        request = problem or advice.missing()
        watch(picture, request)
    raise RecordingFailed(f"the board was not shown as needed: {request}")


def _record_floor(writer: SessionWriter, rangefinder: Rangefinder, operator: Operator, watch: Watch) -> None:
    board, reason = writer.plan.board, ""
    look = board_look(board)
    for _ in range(MOST_TRIES):
        ask = partial(operator.lay_board, board, reason)
        show_while(ask, lambda: _picture(rangefinder), look, watch)
        picture = _fresh(rangefinder)
        watch(*look(picture))
        view = find_board(picture, board, FLOOR_PICTURE)
        if view.is_usable:
            writer.write(FLOOR_PICTURE, picture)
            return
        reason = view.reason
    raise RecordingFailed(f"the board on the floor was not found: {reason}")


def _record_crosses(
    writer: SessionWriter, robot: RobotModel, rangefinder: Rangefinder, operator: Operator, watch: Watch
) -> None:
    plan, lens = writer.plan, _lens(writer)
    points = ", ".join(f"({x:.3f}, {y:.3f})" for x, y in plan.crosses)
    nominal = _nominal(writer, robot)
    look = crosses_look(lens, plan.crosses, tuple(nominal @ turn for turn in MOUNTS.values()))
    reason = ""
    for _ in range(MOST_TRIES):
        ask = partial(operator.lay_crosses, points, reason)
        show_while(ask, lambda: _picture(rangefinder), look, watch)
        picture = _fresh(rangefinder)
        try:
            locate_camera(to_grey(picture), lens, Fiducials(CROSSES_PICTURE, plan.crosses), nominal)
        except CalibrationRefused as error:
            reason = str(error)
            watch(look(picture)[0], reason)
            continue
        writer.write(CROSSES_PICTURE, picture)
        return
    raise RecordingFailed(f"the crosses were not found: {reason}")


def _nominal(writer: SessionWriter, robot: RobotModel) -> Float:
    """Nominal pose (4, 4) of the camera in base_footprint, from the robot's model."""
    pose = robot.stance_pose(writer.plan.stance)
    return np.asarray(pose.transform_base_to_footprint @ robot.transform_camera_to_base)


def _lens(writer: SessionWriter) -> CameraModel:
    """Camera intrinsics from the board images recorded so far."""
    pictures = {name: writer.read(name) for name in (*writer.boards, FLOOR_PICTURE)}
    views = [find_board(picture, writer.plan.board, name) for name, picture in pictures.items()]
    height, width = pictures[FLOOR_PICTURE].shape[:2]
    usable = [view for view in views if view.is_usable]
    return calibrate_intrinsics(usable, writer.plan.board, (width, height)).camera
