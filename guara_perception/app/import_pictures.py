"""Import of images taken by another program as scan folders and calibration sessions."""

from __future__ import annotations

import csv
import math
import shutil
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

from guara_perception.app.files.calibration_session import open_session
from guara_perception.app.files.pair_pictures import PicturePair, names_of
from guara_perception.app.files.scan_folder import ScanFolderWriter, read_picture
from guara_perception.app.record.plate_scan import nominal_order
from guara_perception.app.record.session_writer import CROSSES_PICTURE, FLOOR_PICTURE, SessionPlan, SessionWriter
from guara_perception.calibration.calibration import Calibration
from guara_perception.exceptions import FileFormatError, InvalidInput, MissingFile, PerceptionError, errors_as
from guara_perception.files import existing_file, whole_folder
from guara_perception.settings import MODES, Settings
from kinematics import KinematicsError, RobotModel, Stance

# Largest plausible joint position [rad]. Larger values are rejected, because they are probably in degrees.
LARGEST_ANGLE = 2 * math.pi


def check_sizes(pictures: Sequence[Path]) -> tuple[int, int]:
    """Return the common width and height of all images [px].

    Raises:
        InvalidInput: the sizes differ; the message names the images that do not have the most common size.
        MissingFile, FileFormatError: an image cannot be read.
    """
    sizes = {path: read_picture(path).shape[1::-1] for path in pictures}
    (width, height), _ = Counter(sizes.values()).most_common(1)[0]
    other = [path for path, size in sizes.items() if size != (width, height)]
    if other:
        w, h = sizes[other[0]]
        raise InvalidInput(
            f"pictures of different sizes: {names_of(other)} {w}x{h} px, the others {width}x{height}: all pictures of "
            "a scan or session must come from one camera at one setting"
        )
    return width, height


def stripe_indices(pairs: Sequence[PicturePair], robot: RobotModel, mode: str | None, is_index: bool) -> list[int]:
    """Return the stripe index of each pair of images.

    Args:
        pairs: pairs in firing order.
        robot: robot whose pattern was scanned.
        mode: scan pattern; None = the pattern with as many stripes as there are pairs, or the standard pattern if
            `is_index`.
        is_index: True if the numbers in the names are the indices.

    Raises:
        InvalidInput: no allowed pattern has this number of stripes, or an index is not in the pattern.
    """
    settings = Settings.of(robot)
    if is_index:
        indices = [pair.number for pair in pairs]
        wrong = [pair.on for pair in pairs if pair.number not in settings.pattern(mode or "standard")]
        if wrong:
            raise InvalidInput(
                f"--indices: {names_of(wrong)}: no such stripe in the pattern; allowed: its indices (0 ... "
                f"{settings.stripes - 1})"
            )
        return indices
    lengths = {name: len(settings.pattern(name)) for name in MODES if mode in (None, name)}
    for name, length in lengths.items():
        if length == len(pairs):
            return list(settings.pattern(name))
    numbers = [pair.number for pair in pairs]
    gaps = sorted(set(range(min(numbers), max(numbers) + 1)) - set(numbers))
    missing = f"; numbers missing: {', '.join(map(str, gaps[:6]))}" if 0 < len(gaps) <= len(numbers) else ""
    allowed = " or ".join(f"{length} ({name})" for name, length in lengths.items())
    raise InvalidInput(
        f"{len(pairs)} laser-on pictures{missing}; allowed: {allowed} of robot {robot.name}, or fewer if the "
        "numbers in their names are the stripe indices (--indices)"
    )


def mirror_angles(indices: Sequence[int], robot: RobotModel, calibration: Calibration | None) -> dict[int, float]:
    """Commanded mirror angle [rad] of each stripe, from a calibration or from the pattern in robot.toml.

    Raises:
        CalibrationMismatch: a stripe was not calibrated.
    """
    if calibration is None:
        return {index: angle for index, angle in nominal_order(robot) if index in set(indices)}
    return {index: calibration.stripe(index).mirror_angle for index in indices}


def read_joints(path: Path, robot: RobotModel) -> Stance:
    """Read a stance from a CSV file with a line `joint, angle [rad]` for each joint and an optional heading.

    The robot is assumed to stand on all feet, with unknown gravity.

    Raises:
        MissingFile: the file does not exist.
        FileFormatError: the file is not CSV, a line is invalid, an angle is too large for radians, or a joint is
            missing or unknown.
    """
    joints: dict[str, float] = {}
    try:
        lines = existing_file(path).read_text(encoding="utf-8").splitlines()
        rows = [row for row in csv.reader(lines) if any(map(str.strip, row))]
    except (csv.Error, UnicodeDecodeError) as error:
        raise FileFormatError(f"{path}: not a CSV file ({error})") from None
    for number, row in enumerate(rows):
        try:
            name, angle = row[0].strip(), float(row[1])
        except (IndexError, ValueError):
            if number == 0:
                continue  # the heading
            raise FileFormatError(f"{path}: line {number + 1} is {','.join(row)!r}; allowed: joint, angle") from None
        if not abs(angle) <= LARGEST_ANGLE:
            raise FileFormatError(f"{path}: {name} is {angle:g}; allowed: -6.28 ... 6.28 rad; give radians")
        joints[name] = angle
    with errors_as(FileFormatError, path, KinematicsError):
        stance = Stance(joints, robot.legs, None)
        robot.stance_pose(stance)
    return stance


def write_scan(
    folder: Path, pairs: Mapping[int, PicturePair], angles: Mapping[int, float], robot: RobotModel, stance: Stance
) -> None:
    """Write a scan folder atomically from pairs of images and mirror angles by stripe index."""
    with ScanFolderWriter(folder) as writer:
        for index, pair in pairs.items():
            off = None if pair.off is None else read_picture(pair.off)
            writer.add(index, angles[index], read_picture(pair.on), off, off_key=pair.off)
        mode = "coarse" if set(pairs) <= set(Settings.of(robot).pattern("coarse")) else "standard"
        writer.finish(robot=robot.name, mode=mode, stamp=time.time_ns(), step=0, stance=stance)


def write_session(
    folder: Path, plan: SessionPlan, boards: Sequence[Path], ground: Path, crosses: Path, plates: Sequence[Path]
) -> None:
    """Write a session folder atomically from images and scan folders.

    Args:
        folder: folder to be created.
        plan: board, crosses, heights of the plates and stance.
        boards: images of the board in many poses.
        ground: image of the board on the floor.
        crosses: image of the crosses.
        plates: scan folders, in the order of `plan.plates`.

    Raises:
        InvalidInput: the board is out of range, or a plate was scanned by another robot or in another stance.
        CalibrationMismatch: the plates were scanned by several cameras.
        MissingFile, FileFormatError: an image or the scan of a plate cannot be read.
    """
    try:
        with whole_folder(folder) as staging:
            writer = SessionWriter(staging, plan)
            for number, path in enumerate(boards):
                writer.write(f"board_{number:02d}.png", read_picture(path))
            writer.write(FLOOR_PICTURE, read_picture(ground))
            writer.write(CROSSES_PICTURE, read_picture(crosses))
            for name, plate in zip(writer.plate_names, plates, strict=True):
                if not plate.is_dir():
                    raise MissingFile(f"--plate: {plate}: no such folder; `guara import` makes it from pictures")
                shutil.copytree(plate, staging / name)
            writer.finish()
            open_session(staging)
    except PerceptionError as error:
        # Name the final folder: the user does not know the temporary one.
        error.args = tuple(str(text).replace(str(staging), str(folder)) for text in error.args)
        raise
