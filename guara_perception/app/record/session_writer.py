"""Writer of a session folder during a recording, which can be resumed in the same folder."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from guara_perception.app.files.calibration_session import FORMAT, SESSION_FILE, board_to_dict, read_board
from guara_perception.app.files.scan_folder import read_picture
from guara_perception.arrays import Float, Image
from guara_perception.calibration.board import BoardSpec
from guara_perception.exceptions import FileFormatError, InvalidInput, MissingFile, errors_as
from guara_perception.fields import read_json
from guara_perception.files import check_folder, whole_file, write_text
from guara_perception.images import write_picture
from kinematics import KinematicsError, Stance

PLAN_FILE = "recording.json"
FLOOR_PICTURE, CROSSES_PICTURE = "board_floor.png", "crosses.png"
# Parts that can be recorded again, with the patterns of their image files and folders.
PARTS = {"plates": ("plate_*",), "board": ("board_[0-9][0-9].png", FLOOR_PICTURE), "crosses": (CROSSES_PICTURE,)}


@dataclass(frozen=True, slots=True, eq=False)
class SessionPlan:
    """Planned contents of a session. A recording can only be resumed with the same plan.

    Attributes:
        robot: name of the robot.
        board: the board, with the printed size of the squares.
        crosses: (n, 2) positions of the crosses in base_footprint [m].
        plates: heights of the plates' tops above z = 0 [m].
        stance: stance of the robot in all images.
    """

    robot: str
    board: BoardSpec
    crosses: Float
    plates: tuple[float, ...]
    stance: Stance

    def to_dict(self) -> dict[str, Any]:
        """Convert the plan to plain values for recording.json."""
        return {
            "robot": self.robot,
            "board": board_to_dict(self.board),
            "crosses": np.asarray(self.crosses).tolist(),
            "plates": list(self.plates),
            "stance": self.stance.to_dict(),
        }


def read_plan(folder: Path) -> SessionPlan:
    """Read the plan of the recording in a folder.

    Raises:
        MissingFile: the folder has no plan.
        FileFormatError: the plan cannot be read.
    """
    if not (folder / PLAN_FILE).is_file():
        raise MissingFile(f"{folder} contains no {PLAN_FILE}; --redo works only on sessions made by `guara record`")
    fields = read_json(folder / PLAN_FILE)
    with errors_as(FileFormatError, folder / PLAN_FILE, KinematicsError):
        stance = Stance.from_dict(fields.sub("stance").data)
    board, crosses = read_board(fields.sub("board")), fields.array("crosses", (None, 2))
    return SessionPlan(fields.text("robot"), board, crosses, tuple(fields.array("plates", (None,)).tolist()), stance)


class SessionWriter:
    """Writer of a session folder, which writes each file atomically."""

    def __init__(self, folder: str | Path, plan: SessionPlan, redo: Sequence[str] = ()) -> None:
        """Start a recording, or resume an earlier recording with the same plan.

        Args:
            folder: the session's folder.
            plan: planned contents of the session.
            redo: keys of `PARTS` to record again; `clear` removes their files. The plan may differ in these parts.

        Raises:
            InvalidInput: `folder` is a file, contains files but no recording or, without `redo`, a finished session; or
                the recording in it has another plan.
            FileFormatError: `recording.json` cannot be read.
        """
        self.folder, self.plan, self._redo = Path(folder), plan, tuple(redo)
        check_folder(self.folder)
        if (self.folder / SESSION_FILE).exists() and not redo:
            raise InvalidInput(
                f"{self.folder} contains a finished session; give another name, run `guara calibrate` on it, or record "
                f"a part of it again with --redo PART (PART: {', '.join(PARTS)})"
            )
        present = self.folder / PLAN_FILE
        if present.exists():
            old = read_json(present).data
            differing = sorted(k for k, v in plan.to_dict().items() if old.get(k) != v and k not in redo)
            if differing:
                raise InvalidInput(
                    f"{self.folder} was started with other values of {', '.join(differing)}; give the same options or "
                    "another name"
                )
        elif self.folder.exists() and any(self.folder.iterdir()):
            raise InvalidInput(f"{self.folder} exists and is not a recording; give another name")
        self.folder.mkdir(parents=True, exist_ok=True)
        if not redo:
            self._write_plan()

    @property
    def boards(self) -> list[str]:
        """File names of the board images recorded so far."""
        return sorted(path.name for path in self.folder.glob("board_[0-9][0-9].png"))

    def has(self, name: str) -> bool:
        """True if the image, scan or file `name` exists."""
        return (self.folder / name).exists()

    def read(self, name: str) -> Image:
        """Read an image of the session.

        Raises:
            MissingFile, FileFormatError: the image does not exist or cannot be read.
        """
        return read_picture(self.folder / name)

    def write(self, name: str, picture: Image) -> None:
        """Write an image of the session.

        Raises:
            OSError: the image cannot be written.
        """
        with whole_file(self.folder / name) as temporary:
            write_picture(temporary, picture)

    def clear(self) -> None:
        """Remove `session.json` and the parts to record again, and write the new plan.

        Call it after the devices have been opened, so that nothing is lost if one is missing.
        """
        for path in [path for part in self._redo for pattern in PARTS[part] for path in self.folder.glob(pattern)]:
            shutil.rmtree(path) if path.is_dir() else path.unlink()
        (self.folder / SESSION_FILE).unlink(missing_ok=True)
        self._write_plan()

    def _write_plan(self) -> None:
        write_text(self.folder / PLAN_FILE, json.dumps(self.plan.to_dict(), indent=1) + "\n")

    @property
    def plate_names(self) -> list[str]:
        """Folder names of the plate scans; repeated scans of one height are numbered."""
        heights = self.plan.plates
        names = [f"plate_{1e3 * height:g}".replace(".", "_") for height in heights]
        again = [heights[:i].count(height) for i, height in enumerate(heights)]
        return [f"{name}-{count + 1}" if count else name for name, count in zip(names, again, strict=True)]

    def finish(self) -> Path:
        """Write `session.json`, so that the session can be calibrated; return its path."""
        plan = self.plan
        document = {
            "format": FORMAT,
            "robot": plan.robot,
            "board": plan.to_dict()["board"],
            "board_images": [*self.boards, FLOOR_PICTURE],
            "ground_board_image": FLOOR_PICTURE,
            "fiducials": {"image": CROSSES_PICTURE, "points_in_footprint": plan.to_dict()["crosses"]},
            "plates": [
                {"scan": name, "height": height} for name, height in zip(self.plate_names, plan.plates, strict=True)
            ],
            "stance": plan.to_dict()["stance"],
        }
        path = self.folder / SESSION_FILE
        write_text(path, json.dumps(document, indent=1) + "\n")
        return path
