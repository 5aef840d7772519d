"""`record_session`: guide an operator through a calibration session, with advice on pictures of the board."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

import cv2
import numpy as np

from guara_perception.app.devices_file import Devices, load_devices, save_devices
from guara_perception.app.node.rangefinder import Rangefinder
from guara_perception.app.record.operator import Operator
from guara_perception.app.record.plate_scan import nominal_order, scan_uncalibrated
from guara_perception.app.record.session_writer import CROSSES_PICTURE, FLOOR_PICTURE, SessionWriter
from guara_perception.arrays import Float, Image
from guara_perception.calibration.board import BoardSpec, BoardView, to_grey
from guara_perception.calibration.find_board import find_board
from guara_perception.calibration.intrinsics import calibrate_intrinsics
from guara_perception.calibration.mount import locate_camera
from guara_perception.calibration.session import Fiducials
from guara_perception.exceptions import CalibrationRefused, PerceptionError

if TYPE_CHECKING:
    from kinematics import RobotModel

DEVICES_FILE: Final = "devices.toml"
FIRST_EXPOSURE_S: Final = 0.008
GRAB_SECONDS: Final = 2.0
# Pictures of the board after which the recording gives up (ten minutes at 30 per second).
MOST_PICTURES: Final = 18_000
MOST_TRIES: Final = 20
# Called with a picture and the request for the next one.
Watch = Callable[[Image, str], None]
ZONES: Final = 3
WANTED_PICTURES: Final = 12
# [rad] Below this tilt focal length and distance of the board cannot be told apart.
TILT: Final = float(np.deg2rad(15))
# A still board moves by less than STILL_PX from frame to frame. Two views differ by more than SAME_OF_WIDTH, a share of
# the picture's width.
STILL_PX: Final = 0.5
SAME_OF_WIDTH: Final = 0.04
CLIPPED_SHARE: Final = 0.02
# A common lens, to judge tilts before the real one is known: focal length as a share of the picture's width.
FOCAL_OF_WIDTH: Final = 0.92
SIDES: Final = ("left", "right", "top", "bottom")


class RecordingFailed(PerceptionError, RuntimeError):
    """The session could not be recorded; its pictures are kept, and the same command continues."""


def record_session(
    writer: SessionWriter,
    robot: RobotModel,
    rangefinder: Rangefinder,
    devices: Devices,
    operator: Operator,
    *,
    tell: Callable[[str], None],
    watch: Watch = lambda picture, request: None,
) -> Path:
    """Record the missing parts of a session and finish it.

    Args:
        writer: writer of the session's folder; parts that it holds already are not recorded again.
        robot: model of the robot.
        rangefinder: open board and camera.
        devices: the devices as the user named them; with the metered exposure and the measured lag they are written
            into the folder.
        operator: puts boards, crosses and plates before the camera.
        tell: called with a text for each task.
        watch: called with each picture and the request for the next one, for a live page.

    Returns:
        Path of `session.json`.

    Raises:
        RecordingFailed: crosses or board were not found after many tries.
        drivers.DriverError: a device failed; run the command again to go on.
    """
    plan = writer.plan
    if writer.has(DEVICES_FILE):
        _as_before(rangefinder, load_devices(writer.folder / DEVICES_FILE))
    else:
        operator.clear()
        tell("metering the exposure and measuring the camera's lag")
        save_devices(measured_devices(robot, rangefinder, devices), writer.folder / DEVICES_FILE)
    _record_boards(writer, rangefinder, operator, tell, watch)
    if not writer.has(FLOOR_PICTURE):
        tell("the board on the floor")
        _record_floor(writer, rangefinder, operator, watch)
    if not writer.has(CROSSES_PICTURE):
        tell("the crosses")
        _record_crosses(writer, robot, rangefinder, operator, watch)
    for plate in plan.plates:
        name = writer.plate_name(plate)
        if not writer.has(name):
            operator.lay_plate(plate)
            tell(f"scanning the plate of {1e3 * plate:g} mm")
            for problem in scan_uncalibrated(rangefinder, robot, plan.stance, writer.folder / name):
                tell(f"{name}: {problem}")
    return writer.finish()


def measured_devices(robot: RobotModel, rangefinder: Rangefinder, devices: Devices) -> Devices:
    """The devices with the exposure metered on a stripe, everything locked, and the lag measured.

    Raises:
        drivers.DriverError: the camera does not take an exposure, or does not see the laser.
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
    return replace(devices, settings=settings, lag=float(lag.lag))


def _as_before(rangefinder: Rangefinder, devices: Devices) -> None:
    """Lock the settings of an interrupted session, so that all its pictures have one exposure."""
    from drivers import CameraSettings

    rangefinder.lock(CameraSettings(**devices.settings))
    if devices.lag is not None:
        rangefinder.camera.lag = devices.lag


def _picture(rangefinder: Rangefinder) -> Image:
    return np.asarray(rangefinder.camera.grab(GRAB_SECONDS).image)


def _fresh(rangefinder: Rangefinder) -> Image:
    """A picture whose exposure begins after this call; one that is under way is dropped."""
    rangefinder.camera.flush()
    _picture(rangefinder)
    return _picture(rangefinder)


def _record_boards(
    writer: SessionWriter, rangefinder: Rangefinder, operator: Operator, tell: Callable[[str], None], watch: Watch
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
            tell(f"{len(advice.views)} pictures of the board")
            return
        operator.show_board(request)
        before, picture = _fresh(rangefinder), _picture(rangefinder)
        name = f"board_{len(writer.boards):02d}.png"
        view, problem = advice.judge(picture, before, name)
        if not problem:
            writer.write(name, picture)
            advice.take(view, picture.shape)
        request = problem or advice.missing(picture.shape)
        watch(picture, request)
    raise RecordingFailed(f"the board was not shown as needed: {request}")


def _record_floor(writer: SessionWriter, rangefinder: Rangefinder, operator: Operator, watch: Watch) -> None:
    for _ in range(MOST_TRIES):
        operator.lay_board(writer.plan.board)
        picture = _fresh(rangefinder)
        view = find_board(picture, writer.plan.board, FLOOR_PICTURE)
        watch(picture, view.reason or "the board lies well")
        if view.is_usable:
            writer.write(FLOOR_PICTURE, picture)
            return
    raise RecordingFailed(f"the board on the floor was not found: {view.reason}")


def _record_crosses(
    writer: SessionWriter, robot: RobotModel, rangefinder: Rangefinder, operator: Operator, watch: Watch
) -> None:
    plan = writer.plan
    pictures = {name: writer.read(name) for name in (*writer.boards, FLOOR_PICTURE)}
    views = [find_board(picture, plan.board, name) for name, picture in pictures.items()]
    height, width = pictures[FLOOR_PICTURE].shape[:2]
    lens = calibrate_intrinsics([view for view in views if view.is_usable], plan.board, (width, height))
    nominal = robot.stance_pose(plan.stance).transform_base_to_footprint @ robot.transform_camera_to_base
    points = ", ".join(f"({x:.3f}, {y:.3f})" for x, y in plan.crosses)
    reason = ""
    for _ in range(MOST_TRIES):
        operator.lay_crosses(points, reason)
        picture = _fresh(rangefinder)
        try:
            locate_camera(to_grey(picture), lens.camera, Fiducials(CROSSES_PICTURE, plan.crosses), nominal)
        except CalibrationRefused as error:
            reason = str(error)
            watch(picture, reason)
            continue
        writer.write(CROSSES_PICTURE, picture)
        return
    raise RecordingFailed(f"the crosses were not found: {reason}")


@dataclass
class BoardAdvice:
    """Coverage of the pictures of the board so far, and advice on the next one.

    Attributes:
        board: the board.
        views: views that were accepted.
    """

    board: BoardSpec
    views: list[BoardView] = field(default_factory=list)
    _zones: set[tuple[int, int]] = field(default_factory=set)
    _tilts: set[str] = field(default_factory=set)

    def judge(self, picture: Image, before: Image | None = None, name: str = "") -> tuple[BoardView, str]:
        """View of a picture, and the reason why it cannot be used, empty when it can."""
        grey = to_grey(picture)
        if float(np.mean(grey >= 254)) > CLIPPED_SHARE:
            reason = f"too bright: {100 * float(np.mean(grey >= 254)):.0f} % of the picture is clipped"
            return BoardView.unusable(name, reason), reason
        view = find_board(picture, self.board, name)
        if not view.is_usable:
            return view, view.reason
        if before is not None:
            earlier = find_board(before, self.board, name)
            moved = _moved(view, earlier)
            if not earlier.is_usable or not moved.size or moved.max() > STILL_PX:
                return view, "hold the board still"
        width = grey.shape[1]
        for other in self.views:
            moved = _moved(view, other)
            if moved.size and moved.mean() < SAME_OF_WIDTH * width:
                return view, f"shown before; {self.missing(picture.shape[:2])}"
        return view, ""

    def take(self, view: BoardView, shape: tuple[int, ...]) -> None:
        """Count an accepted view."""
        self.views.append(view)
        height, width = shape[:2]
        zone = np.clip((view.corners_px / np.array([width, height]) * ZONES).astype(int), 0, ZONES - 1)
        self._zones.update((int(row), int(column)) for column, row in zone)
        self._tilts.update(tilted_sides(view, self.board, (height, width)))

    def is_complete(self) -> bool:
        """Whether enough pictures show every zone and every tilt."""
        return len(self.views) >= WANTED_PICTURES and len(self._zones) == ZONES**2 and len(self._tilts) == len(SIDES)

    def missing(self, shape: tuple[int, ...]) -> str:
        """Request for the next picture."""
        advice = []
        empty = [(r, c) for r in range(ZONES) for c in range(ZONES) if (r, c) not in self._zones]
        if empty:
            row, column = empty[0]
            zone = f"{('top', 'middle', 'bottom')[row]} {('left', 'centre', 'right')[column]}"
            advice.append(f"bring it to the {zone} of the picture ({len(empty)} of {ZONES**2} zones not yet seen)")
        sides = [side for side in SIDES if side not in self._tilts]
        if sides:
            advice.append(f"tilt its {sides[0]} side away from the camera")
        if not advice:
            advice.append("show it elsewhere or tilted otherwise")
        return f"{len(self.views)} of {WANTED_PICTURES} pictures: " + ", and ".join(advice)


def _moved(view: BoardView, other: BoardView) -> Float:
    """Distances (n, 2) of the corners that both views show [px]."""
    _, here, there = np.intersect1d(view.corners, other.corners, return_indices=True)
    return np.abs(view.corners_px[here] - other.corners_px[there])


def tilted_sides(view: BoardView, board: BoardSpec, shape: tuple[int, int]) -> set[str]:
    """Sides of the picture at which the board leans away by TILT or more, judged with a common lens."""
    height, width = shape
    focal = FOCAL_OF_WIDTH * width
    matrix = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    found, turn, _ = cv2.solvePnP(view.points(board), view.corners_px.reshape(-1, 1, 2), matrix, None)
    if not found:
        return set()
    normal: Float = np.asarray(cv2.Rodrigues(turn)[0][:, 2], dtype=np.float64)
    normal = normal if normal[2] > 0 else -normal
    # A normal that points right in the picture means that the right side is the farther one: z grows along -x there.
    lean_x, lean_y = np.arctan2(-normal[0], normal[2]), np.arctan2(-normal[1], normal[2])
    tests = {"right": lean_x > TILT, "left": lean_x < -TILT, "bottom": lean_y > TILT, "top": lean_y < -TILT}
    return {side for side, holds in tests.items() if holds}
