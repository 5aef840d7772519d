"""Opens a recorded scan folder: `scan.json` and its frames."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from guara_perception.bounded_files import LARGEST_PICTURE, decode_picture, read_bounded
from guara_perception.exceptions import FileFormatError, InvalidInput, MissingFile
from guara_perception.fields import Fields, read_json
from guara_perception.scan import Scan, ScanStripe
from guara_perception.settings import MODES
from kinematics import KinematicsError, Stance

FORMAT = "guara-scan/1"
SCAN_FILE = "scan.json"
# What the grid file and the messages can hold.
MAXIMUM_STAMP = 2**63 - 1
MAXIMUM_STEP = 2**31 - 1


def open_scan_folder(folder: str | Path) -> Scan:
    """Read and check `scan.json`; frames are read when they are asked for.

    Raises:
        MissingFile: the folder, its scan.json or a frame that it names is not there.
        FileFormatError: the message names file and field, what was given and what is allowed.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise MissingFile(f"{folder}: no such folder; a scan is a folder with {SCAN_FILE} and frames")
    fields = read_json(folder / SCAN_FILE)
    fields.text("format", (FORMAT,))
    stripes = tuple(_stripe(item) for item in fields.items("stripes"))
    for stripe in stripes:
        for name in (stripe.on, stripe.off):
            if name is not None and (Path(name).is_absolute() or ".." in Path(name).parts):
                raise FileFormatError(
                    f"{folder / SCAN_FILE}: stripe index {stripe.index} names frame {name}; allowed: a path inside the "
                    f"folder"
                )
            if name is not None and not (folder / name).is_file():
                raise MissingFile(
                    f"{folder / SCAN_FILE}: stripe index {stripe.index} names frame {name}, it is not there"
                )
    try:
        stance = Stance.from_dict(fields.sub("stance").data)
        stance_end = None
        if fields.has("stance_end"):
            stance_end = Stance.from_dict(fields.sub("stance_end").data, "stance_end")
    except KinematicsError as error:
        raise FileFormatError(f"{folder / SCAN_FILE}: {error}") from None
    try:
        return Scan(
            robot=fields.text("robot"),
            mode=fields.text("mode", MODES),
            stamp=fields.integer("stamp", minimum=0, maximum=MAXIMUM_STAMP),
            step=fields.integer("step", minimum=0, maximum=MAXIMUM_STEP),
            stripes=stripes,
            stance=stance,
            stance_end=stance_end,
            calibration_hash=fields.text("calibration_hash") if fields.has("calibration_hash") else None,
            source=str(folder / SCAN_FILE),
            read_frame=lambda name: read_picture(folder / name),
        )
    except InvalidInput as error:
        raise FileFormatError(str(error)) from None


def read_picture(path: Path) -> npt.NDArray[np.generic]:
    """Read a picture as it is: BGR or grey, 8 or 16 bit.

    Raises:
        MissingFile: no such file.
        FileFormatError: it cannot be decoded.
    """
    if not path.is_file():
        raise MissingFile(f"{path}: no such file")
    return decode_picture(read_bounded(path, LARGEST_PICTURE), str(path))


def _stripe(item: Fields) -> ScanStripe:
    if "off" not in item.data:
        raise FileFormatError(f"{item.path_to('off')} is missing, it must be a frame name or null")
    return ScanStripe(
        index=item.integer("index", minimum=0, maximum=9999),
        mirror_angle=item.number("mirror_angle", -3.15, 3.15),
        on=item.text("on"),
        off=item.text("off") if item.has("off") else None,
        stamp=item.integer("stamp", minimum=0, maximum=MAXIMUM_STAMP) if item.has("stamp") else None,
    )
