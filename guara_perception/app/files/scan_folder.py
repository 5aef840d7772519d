"""Reader and writer of scan folders, which contain `scan.json` and frames. A folder is written atomically."""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Collection
from contextlib import AbstractContextManager
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from guara_perception.arrays import Image
from guara_perception.calibration.calibration import Calibration
from guara_perception.calibration.file import save_calibration
from guara_perception.exceptions import FileFormatError, InvalidInput, MissingFile, errors_as
from guara_perception.fields import Fields, read_json
from guara_perception.files import existing_file, read_bounded
from guara_perception.images import LARGEST_PICTURE, decode_picture, write_picture
from guara_perception.scan import Scan, ScanStripe
from guara_perception.settings import MODES
from kinematics import KinematicsError, Stance

FORMAT = "guara-scan/1"
SCAN_FILE, CALIBRATION_FILE = "scan.json", "calibration.json"
# Largest stamp [ns] and largest step that grid files and messages can represent.
MAXIMUM_STAMP = 2**63 - 1
MAXIMUM_STEP = 2**31 - 1
# Compression level 1 takes a third of the time of the default; camera frames become 5 % larger.
PNG_OPTIONS = (cv2.IMWRITE_PNG_COMPRESSION, 1)


def open_scan_folder(folder: str | Path, *, missing_ok: bool = False) -> Scan:
    """Open a scan folder: read and check `scan.json`. Frames are loaded on demand.

    Args:
        folder: the scan folder.
        missing_ok: also open a folder with missing frames; reading such a frame raises MissingFile.

    Raises:
        MissingFile: the folder or its scan.json does not exist, or a frame named there, unless `missing_ok` is True.
        FileFormatError: `scan.json` is not valid JSON, or a field is missing or invalid; the message names it.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise MissingFile(f"{folder}: no such folder; a scan is a folder with {SCAN_FILE} and frames")
    if not (folder / SCAN_FILE).exists():
        kind = "; this is the folder of a calibration session" if (folder / "session.json").is_file() else ""
        raise MissingFile(f"{folder}: contains no {SCAN_FILE}, so it is not a scan{kind}")
    fields = read_json(folder / SCAN_FILE)
    fields.text("format", (FORMAT,))
    stripes = tuple(_stripe(item) for item in fields.items("stripes"))
    for stripe in stripes:
        for name in (stripe.on, stripe.off, stripe.dark):
            if name is not None and (Path(name).is_absolute() or ".." in Path(name).parts):
                raise FileFormatError(
                    f"{folder / SCAN_FILE}: stripe index {stripe.index} names frame {name}; allowed: a path inside the "
                    f"folder"
                )
            if name is not None and not missing_ok and not (folder / name).is_file():
                raise MissingFile(
                    f"{folder / SCAN_FILE}: stripe index {stripe.index} names frame {name}, which does not exist"
                )
    with errors_as(FileFormatError, folder / SCAN_FILE, KinematicsError):
        stance = Stance.from_dict(fields.sub("stance").data)
        stance_end = None
        if fields.has("stance_end"):
            stance_end = Stance.from_dict(fields.sub("stance_end").data, "stance_end")
    with errors_as(FileFormatError, "", InvalidInput):
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
            dark_after=_dark_after(fields) if fields.has("dark_after") else (),
            camera_identity=fields.text("camera_identity") if fields.has("camera_identity") else "",
        )


def read_picture(path: Path) -> npt.NDArray[np.generic]:
    """Read an image unchanged: BGR or grey, 8 or 16 bit.

    Raises:
        MissingFile: the file does not exist.
        FileFormatError: the file is not a usable image; see `decode_picture`.
    """
    return decode_picture(read_bounded(existing_file(path), LARGEST_PICTURE), str(path))


def _dark_after(fields: Fields) -> tuple[int, ...]:
    values = fields.sequence("dark_after")
    if any(type(value) is not int or not 0 <= value <= 9999 for value in values):
        raise FileFormatError(f"{fields.path_to('dark_after')} is {values!r:.80}; allowed: a list of stripe indices")
    return tuple(values)


def _stripe(item: Fields) -> ScanStripe:
    if "off" not in item.data:
        raise FileFormatError(f"{item.path_to('off')} is missing; allowed: a frame name or null")
    return ScanStripe(
        index=item.integer("index", minimum=0, maximum=9999),
        mirror_angle=item.number("mirror_angle", -3.15, 3.15),
        on=item.text("on"),
        off=item.text("off") if item.has("off") else None,
        stamp=item.integer("stamp", minimum=0, maximum=MAXIMUM_STAMP) if item.has("stamp") else None,
        dark=item.text("dark") if item.has("dark") else None,
    )


class ScanFolderWriter(AbstractContextManager["ScanFolderWriter"]):
    """Writer of a scan folder; use it in a `with` block and call `finish` when the scan is complete."""

    def __init__(self, folder: str | Path) -> None:
        """Create a temporary folder beside the target.

        Raises:
            InvalidInput: the target exists, or the parent folder does not exist.
        """
        self.folder = Path(folder)
        if self.folder.exists():
            raise InvalidInput(f"{self.folder} exists; give another name, or remove it first")
        if not self.folder.parent.is_dir():
            raise InvalidInput(f"{self.folder}: the folder {self.folder.parent} does not exist; create it first")
        self._staging = Path(tempfile.mkdtemp(prefix=f".{self.folder.name}-", dir=self.folder.parent))
        self._stripes: list[dict[str, object]] = []
        self._offs: dict[object, str] = {}
        self._off: Image | None = None
        self._alone: object = None

    def __exit__(self, *error: object) -> None:
        """Remove an unfinished folder."""
        shutil.rmtree(self._staging, ignore_errors=True)

    def add(
        self,
        index: int,
        mirror_angle: float,
        on: Image,
        off: Image | None = None,
        *,
        off_key: object = None,
        stamp: int | None = None,
        dark: Image | None = None,
    ) -> None:
        """Write one stripe.

        Args:
            index: index of the stripe.
            mirror_angle: commanded mirror angle [rad].
            on: laser-on frame.
            off: laser-off frame, or None.
            off_key: key of the laser-off file, which is shared by stripes with the same key. None = shared with the
                previous stripe if `off` is the same array, else a new file.
            stamp: stamp of the laser-on frame [ns since the Unix epoch].
            dark: frame of the dark flash after the stripe, or None.

        Raises:
            OSError: an image cannot be written.
        """
        entry: dict[str, object] = {"index": index, "mirror_angle": mirror_angle, "on": f"on_{index:03d}.png"}
        self._write(str(entry["on"]), on)
        entry["off"] = None
        if off is not None:
            # The array must be kept for this comparison, since a new array can get the address of a freed one.
            if off is not self._off:
                self._off, self._alone = off, ("alone", index)
            key = self._alone if off_key is None else off_key
            if key not in self._offs:
                self._offs[key] = f"off_{len(self._offs):03d}.png"
                self._write(self._offs[key], off)
            entry["off"] = self._offs[key]
        if dark is not None:
            entry["dark"] = f"dark_{index:03d}.png"
            self._write(str(entry["dark"]), dark)
        if stamp is not None:
            entry["stamp"] = stamp
        self._stripes.append(entry)

    def finish(
        self,
        *,
        robot: str,
        mode: str,
        stamp: int,
        step: int,
        stance: Stance,
        stance_end: Stance | None = None,
        calibration_hash: str | None = None,
        calibration: Calibration | None = None,
        dark_after: Collection[int] = (),
        camera_identity: str = "",
    ) -> Path:
        """Write `scan.json` and, if given, the calibration; move the folder to its final name and return its path."""
        document: dict[str, object] = {
            "format": FORMAT,
            "robot": robot,
            "mode": mode,
            "stamp": stamp,
            "step": step,
            "stripes": sorted(self._stripes, key=lambda entry: int(str(entry["index"]))),
            "stance": stance.to_dict(),
        }
        optional = {
            "dark_after": sorted(dark_after),
            "camera_identity": camera_identity,
            "stance_end": None if stance_end is None else stance_end.to_dict(),
            "calibration_hash": calibration_hash,
        }
        document |= {name: value for name, value in optional.items() if value}
        if calibration is not None:
            save_calibration(calibration, self._staging / CALIBRATION_FILE)
        (self._staging / SCAN_FILE).write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
        self._staging.chmod(0o755)
        self._staging.rename(self.folder)
        return self.folder

    def _write(self, name: str, picture: Image) -> None:
        try:
            write_picture(self._staging / name, picture, PNG_OPTIONS)
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(self.folder / name)) from error
