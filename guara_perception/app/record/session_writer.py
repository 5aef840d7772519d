"""Folder of a session while it is recorded; an interrupted recording continues in it."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from guara_perception.app.files.calibration_session import FORMAT, SESSION_FILE, board_to_dict
from guara_perception.app.files.scan_folder import read_picture
from guara_perception.app.files.write_picture import write_picture
from guara_perception.arrays import Float, Image
from guara_perception.calibration.board import BoardSpec
from guara_perception.exceptions import InvalidInput
from guara_perception.fields import read_json
from guara_perception.files import check_folder, whole_file

if TYPE_CHECKING:
    from kinematics import Stance

PLAN_FILE = "recording.json"
FLOOR_PICTURE, CROSSES_PICTURE = "board_floor.png", "crosses.png"


@dataclass(frozen=True, slots=True, eq=False)
class SessionPlan:
    """Contents of a session; it must be the same when a recording is continued.

    Attributes:
        robot: name of the robot.
        board: the board, its square as printed.
        crosses: (n, 2) where the crosses lie, in base_footprint [m].
        plates: heights of the plates' tops above z = 0 [m].
        stance: stance of all pictures.
    """

    robot: str
    board: BoardSpec
    crosses: Float
    plates: tuple[float, ...]
    stance: Stance

    def to_dict(self) -> dict[str, Any]:
        """Plain values, as the session's file holds them."""
        return {
            "robot": self.robot,
            "board": board_to_dict(self.board),
            "crosses": np.asarray(self.crosses).tolist(),
            "plates": list(self.plates),
            "stance": self.stance.to_dict(),
        }


class SessionWriter:
    """Writes a session folder picture by picture, each whole or not at all."""

    def __init__(self, folder: str | Path, plan: SessionPlan) -> None:
        """Begin, or continue an earlier recording with the same plan.

        Raises:
            InvalidInput: the folder holds something else, a finished session, or was begun with another plan.
        """
        self.folder, self.plan = Path(folder), plan
        check_folder(self.folder)
        if (self.folder / SESSION_FILE).exists():
            raise InvalidInput(f"{self.folder} holds a finished session; give another name, or `guara calibrate` it")
        present = self.folder / PLAN_FILE
        if present.exists():
            differing = sorted(k for k, v in plan.to_dict().items() if read_json(present).data.get(k) != v)
            if differing:
                raise InvalidInput(
                    f"{self.folder} was begun with other {', '.join(differing)}: give the same options or another name"
                )
        elif self.folder.exists() and any(self.folder.iterdir()):
            raise InvalidInput(f"{self.folder} exists and is no recording; give another name")
        self.folder.mkdir(parents=True, exist_ok=True)
        with whole_file(present) as temporary:
            temporary.write_text(json.dumps(plan.to_dict(), indent=1) + "\n", encoding="utf-8")

    @property
    def boards(self) -> list[str]:
        """Names of the board pictures taken so far."""
        return sorted(path.name for path in self.folder.glob("board_[0-9][0-9].png"))

    def has(self, name: str) -> bool:
        """Whether a picture or scan exists."""
        return (self.folder / name).exists()

    def read(self, name: str) -> Image:
        """Read a picture."""
        return read_picture(self.folder / name)

    def write(self, name: str, picture: Image) -> None:
        """Write a picture.

        Raises:
            OSError: it cannot be written.
        """
        with whole_file(self.folder / name) as temporary:
            write_picture(temporary, picture)

    def plate_name(self, height: float) -> str:
        """Folder of a plate's scan."""
        return f"plate_{1e3 * height:g}".replace(".", "_")

    def finish(self) -> Path:
        """Write `session.json`; the session can then be calibrated."""
        plan = self.plan
        document = {
            "format": FORMAT,
            "robot": plan.robot,
            "board": plan.to_dict()["board"],
            "board_images": [*self.boards, FLOOR_PICTURE],
            "ground_board_image": FLOOR_PICTURE,
            "fiducials": {"image": CROSSES_PICTURE, "points_in_footprint": plan.to_dict()["crosses"]},
            "plates": [{"scan": self.plate_name(height), "height": height} for height in plan.plates],
            "stance": plan.to_dict()["stance"],
        }
        path = self.folder / SESSION_FILE
        with whole_file(path) as temporary:
            temporary.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
        return path
