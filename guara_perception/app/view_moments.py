"""Moments (stance pauses) for the viewer, loaded from a grid file, recorded scans or a recorded walk."""

from __future__ import annotations

import logging
from functools import cache, partial
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

from guara_perception.app.messages import message_to_terrain
from guara_perception.app.scene.scene import cloud_points, planned_footholds
from guara_perception.arrays import Float, Image
from guara_perception.calibration.calibration import Calibration
from guara_perception.calibration.file import parse_calibration
from guara_perception.exceptions import FileFormatError, InvalidInput, MissingFile, errors_as
from guara_perception.settings import RobotLike, robot_model
from guara_perception.terrain.layers.layered_grid import EXTENTS
from guara_perception.view.moment import Moment
from transport import DEFAULT_ROBOT, TransportError
from transport.messages.codec import read_time

if TYPE_CHECKING:
    from guara_perception.scan import Scan
    from guara_perception.terrain.grid import TerrainGrid
    from kinematics import RobotModel

logger = logging.getLogger(__name__)


def load_moments(
    path: str | Path, robot: RobotLike | None = None, calibration: Calibration | None = None
) -> tuple[RobotModel, list[Moment]]:
    """Load the moments of a file or folder; return the model of its robot, and the moments.

    Args:
        path: a grid (.npz), a recording (.mcap) or a scan folder.
        robot: model, name or folder of the robot that recorded it; None = the robot named in it, or guara.
        calibration: used to process scans without a recorded grid or points; None = the calibration in the recording
            or folder, if any.

    Raises:
        MissingFile: the path does not exist.
        InvalidInput: the file is of another kind, a scan cannot be processed, or there is no calibration for a scan
            folder or a recording without grids.
        FileFormatError: the file is damaged, or contains neither grids nor scans.
        CalibrationMismatch: the calibration does not match a scan that is processed.
        kinematics.KinematicsError: the robot does not exist or cannot be loaded.
    """
    path = Path(path)
    if not path.exists():
        raise MissingFile(f"{path}: no such file or folder")
    if path.is_dir():
        from guara_perception.app.files.open_scan import calibration_for, open_scans

        scans = open_scans(path)
        model = robot_model(scans[0].robot if robot is None else robot)
        known = calibration_for(path, None) if calibration is None else calibration
        return model, [_processed(scan, model, known) for scan in scans]
    if path.suffix == ".npz":
        from guara_perception.terrain.file import load_terrain

        terrain = load_terrain(path)
        model = robot_model((terrain.record.robot or DEFAULT_ROBOT) if robot is None else robot)
        return model, [Moment({terrain.extent: terrain}, footholds=planned_footholds(model, terrain))]
    if path.suffix == ".mcap":
        return _recorded(path, robot, calibration)
    raise InvalidInput(f"cannot show {path}; allowed: a grid (.npz), a recording (.mcap) or a scan folder")


def _processed(scan: Scan, robot: RobotModel, calibration: Calibration) -> Moment:
    from guara_perception.scanning.process import run_scan

    processor = run_scan(scan, calibration, robot)
    terrain = processor.finish()
    points = [stripe.points for stripe in processor.points.values()]
    planned = planned_footholds(robot, terrain)
    return Moment({"footprint": terrain}, lambda: points, planned, cache(partial(_picture, scan)))


def _recorded(path: Path, robot: RobotLike | None, calibration: Calibration | None) -> tuple[RobotModel, list[Moment]]:
    """Robot and moments of a recording, by walk and step. With a calibration, scans without grids are processed."""
    from guara_perception.app.files.open_scan import open_scans
    from transport.recording import open_recording

    # Walks by epoch, in the order of their first grids, with the time of the first frame of each.
    walks: dict[str, int] = {}
    grids: dict[tuple[int, int], dict[str, TerrainGrid]] = {}
    with errors_as(FileFormatError, "", TransportError), open_recording(path) as recording:
        for extent in EXTENTS:
            for message in recording.terrains(extent):
                walks.setdefault(message.epoch, message.scan_start)
                pause = list(walks).index(message.epoch), message.step
                grids.setdefault(pause, {})[extent] = message_to_terrain(message)
        # Each grid is recorded as it was first sent; the range images of a scan follow once the pause has confirmed it.
        confirmed = {read_time(image.header.stamp) for image in recording.messages("range_image")}
        clouds = {read_time(cloud.header.stamp): [cloud_points(cloud)] for cloud in recording.messages("scan/points")}
        if calibration is None and recording.calibration is not None:
            calibration = parse_calibration(recording.calibration, f"{path}: calibration.json")
    begins = list(walks.values())
    scans = {(_walk_of(scan.end, begins), scan.step): scan for scan in open_scans(path)}
    if robot is None:
        names = (scan.robot for scan in scans.values()), (next(iter(of.values())).record.robot for of in grids.values())
        robot = next(filter(None, chain(*names)), None) or DEFAULT_ROBOT
    model = robot_model(robot)
    if not grids and calibration is None and scans:
        raise InvalidInput(f"{path} holds scans but no grids: give the calibration that belongs to it with -c")
    if not grids and not scans:
        raise FileFormatError(f"{path} holds neither grids nor scans: there is nothing to show")
    for pause, of_pause in grids.items():
        if any(grid.stamp in confirmed for grid in of_pause.values()):
            grids[pause] = {extent: grid.restated(provisional=False) for extent, grid in of_pause.items()}
    moments = []
    for pause in sorted({*grids, *(scans if calibration is not None else ())}):
        if pause not in grids and calibration is not None:
            moments.append(_processed(scans[pause], model, calibration))
            continue
        scan, terrain = scans.get(pause), grids[pause].get("footprint") or grids[pause]["map"]
        parts: dict[str, Any] = {}
        if terrain.stamp in clouds:
            parts["stripes"] = partial(clouds.__getitem__, terrain.stamp)
        elif scan is not None and calibration is not None:
            parts["stripes"] = cache(partial(_measured, scan, model, calibration))
        if scan is not None:
            parts["picture"] = cache(partial(_picture, scan))
        planned = planned_footholds(model, grids[pause].get("map") or terrain)
        moments.append(Moment(grids[pause], footholds=planned, **parts))
    return model, moments


def _walk_of(stamp: int, begins: list[int]) -> int:
    """Number of the walk that a scan belongs to: the last one whose first frame precedes the end of the scan."""
    return max((number for number, begin in enumerate(begins) if begin <= stamp), default=0)


def _measured(scan: Scan, robot: RobotModel, calibration: Calibration) -> list[Float]:
    """Process a scan and return its points."""
    from guara_perception.scanning.process import run_scan

    return [stripe.points for stripe in run_scan(scan, calibration, robot).points.values()]


def _picture(scan: Scan) -> Image | None:
    """Camera image of the median stripe; None if it cannot be read."""
    in_order = sorted(scan.stripes, key=lambda stripe: stripe.mirror_angle)
    try:
        return scan.read_frame(in_order[len(in_order) // 2].on)
    except (MissingFile, FileFormatError) as error:
        logger.warning("skipping camera image: %s", error)
        return None
