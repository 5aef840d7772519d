"""Reader of calibration session folders: `session.json`, images and plate scans."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from guara_perception.app.files.scan_folder import SCAN_FILE, open_scan_folder, read_picture
from guara_perception.calibration.board import CHECKERBOARD, COLOURS, PATTERNS, BoardSpec
from guara_perception.calibration.calibration_input import SQUARES, CalibrationSession, Fiducials, Plate
from guara_perception.exceptions import FileFormatError, InvalidInput, MissingFile, errors_as
from guara_perception.fields import Fields, read_json
from kinematics import KinematicsError, Stance

FORMAT = "guara-calibration-session/1"
SESSION_FILE = "session.json"
# Placeholder for the board of a session with neither board nor board images; its values are not used.
NO_BOARD = BoardSpec(3, 3, 0.03)
# Allowed heights of a plate above the soles [m].
PLATE_HEIGHTS = (-0.5, 0.5)


def open_session(folder: str | Path, square: float | None = None) -> CalibrationSession:
    """Open a session folder: read and check `session.json`. Images are loaded on demand.

    Args:
        folder: the session's folder.
        square: edge of the board's squares [m]; None = as in the session.

    Raises:
        MissingFile: the folder, its session.json, or an image or scan named there does not exist.
        FileFormatError: a JSON file is not valid, or a field is missing or invalid; the message names it.
        InvalidInput: the board or its squares are out of range, a plate was scanned by another robot or in another
            stance, or a scan is named twice.
        CalibrationMismatch: the plates were scanned by several cameras.
    """
    folder = Path(folder)
    if square is not None and not SQUARES[0] <= square <= SQUARES[1]:
        raise InvalidInput(f"square is {square:g} m; allowed: {SQUARES[0]:g} ... {SQUARES[1]:g} m (28 mm are 0.028)")
    if not folder.is_dir():
        raise MissingFile(f"{folder}: no such folder; a calibration session is a folder with {SESSION_FILE}")
    if not (folder / SESSION_FILE).is_file():
        kind = "; this is the folder of a single scan" if (folder / SCAN_FILE).is_file() else ""
        raise MissingFile(f"{folder}: contains no {SESSION_FILE}, so it is not a calibration session{kind}")
    fields = read_json(folder / SESSION_FILE)
    fields.text("format", (FORMAT,))
    with errors_as(FileFormatError, folder / SESSION_FILE, KinematicsError):
        stance = Stance.from_dict(fields.sub("stance").data)
    images = tuple(
        _picture_name(name, folder, fields.path_to("board_images"))
        for name in (fields.sequence("board_images") if fields.has("board_images") else ())
    )
    ground = None
    if fields.has("ground_board_image"):
        ground = _picture_name(fields.text("ground_board_image"), folder, fields.path_to("ground_board_image"))
        images = images if ground in images else (*images, ground)
    board = read_board(fields.sub("board")) if images or fields.has("board") else NO_BOARD
    plates = tuple(_plate(item, folder) for item in fields.items("plates"))
    return CalibrationSession(
        robot=fields.text("robot"),
        board=board if square is None else replace(board, square=square),
        board_images=images,
        ground_board_image=ground,
        fiducials=_fiducials(fields.sub("fiducials"), folder),
        plates=plates,
        stance=stance,
        source=str(folder),
        read_picture=lambda name: read_picture(folder / name),
    )


def read_board(fields: Fields) -> BoardSpec:
    """Read the `board` object of `session.json`.

    Raises:
        FileFormatError: a field is missing or invalid.
    """
    columns, rows = fields.array("inner_corners", (2,))
    if columns != int(columns) or rows != int(rows):
        raise FileFormatError(f"{fields.path_to('inner_corners')} is [{columns}, {rows}]; allowed: two whole numbers")
    pattern = fields.text("pattern", PATTERNS) if fields.has("pattern") else CHECKERBOARD
    first = fields.text("first_square", COLOURS) if fields.has("first_square") else None
    return BoardSpec(int(columns), int(rows), fields.number("square"), pattern, first)


def board_to_dict(board: BoardSpec) -> dict[str, Any]:
    """Convert a board to the `board` object of `session.json`."""
    pattern = {} if board.pattern == CHECKERBOARD else {"pattern": board.pattern}
    first = {} if board.first_square is None else {"first_square": board.first_square}
    return {**pattern, "inner_corners": [board.columns, board.rows], "square": board.square, **first}


def _fiducials(fields: Fields, folder: Path) -> Fiducials:
    image = _picture_name(fields.text("image"), folder, fields.path_to("image"))
    points = fields.array("points_in_footprint", (None, 2))
    pixels = fields.array("points_px", (None, 2)) if fields.has("points_px") else None
    with errors_as(FileFormatError, fields.source, InvalidInput):
        return Fiducials(image, points, pixels)


def _plate(item: Fields, folder: Path) -> Plate:
    name = item.text("scan")
    return Plate(name, item.number("height", *PLATE_HEIGHTS), open_scan_folder(folder / name))


def _picture_name(name: object, folder: Path, path: str) -> str:
    if not isinstance(name, str):
        raise FileFormatError(f"{path}: {name!r} is not a file name")
    if not (folder / name).is_file():
        raise MissingFile(f"{path}: {folder / name} does not exist")
    return name
