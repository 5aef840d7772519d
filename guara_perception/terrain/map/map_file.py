"""The rolling map of a walk as one NumPy file: what `TerrainMap.save` writes and `TerrainMap.load` reads."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from guara_perception.arrays import Array
from guara_perception.exceptions import FileFormatError, MissingFile
from guara_perception.fields import Fields, parse_json
from guara_perception.files import whole_file
from guara_perception.terrain.file import UNREADABLE
from guara_perception.terrain.map.fuse_heights import OdometryDrift
from guara_perception.terrain.map.odom_cells import MEMORY, OdomCells
from guara_perception.terrain.map.support_feet import HeightAnchor
from guara_perception.terrain.map.walk_correction import SidewaysDrift, WalkCorrection

FORMAT = "guara-map/3"


@dataclass(frozen=True, slots=True)
class SavedMap:
    """What a file of a map holds.

    Attributes:
        robot: name of the robot.
        resolution: cell edge [m].
        side: cells along each side of the window.
        first: lowest cell (cy, cx) of the window, or None.
        memory: every array of MEMORY.
        state: attributes of the map by name.
    """

    robot: str
    resolution: float
    side: int
    first: tuple[int, int] | None
    memory: Mapping[str, Array]
    state: Mapping[str, Any]


def write_map(path: str | Path, robot: str, cells: OdomCells, state: Mapping[str, Any]) -> None:
    """Write a map, whole or not at all; `state` are its attributes by name.

    Raises:
        MissingFile: the folder does not exist.
    """
    centre = state["_centre"]
    plain = {
        **state,
        "_centre": None if centre is None else centre.tolist(),
        "_drift": dataclasses.asdict(state["_drift"]),
        "_sideways": state["_sideways"].to_fields(),
        "_anchor": dataclasses.asdict(state["_anchor"]),
        "_walk": state["_walk"].to_fields(),
    }
    header = {"format": FORMAT, "robot": robot, "resolution": cells.resolution, "side": cells.side}
    fields = {name.removeprefix("_"): value for name, value in plain.items()}
    text = json.dumps({**header, "first": cells.first, **fields})
    with whole_file(path) as temporary, temporary.open("wb") as stream:
        np.savez_compressed(stream, allow_pickle=False, state=np.array(text), **cells.memory)


def read_map(path: str | Path) -> SavedMap:
    """What `write_map` wrote; types and shapes are checked.

    Raises:
        MissingFile: no such file.
        FileFormatError: not such a file, or one whose contents do not fit each other.
    """
    path = Path(path)
    if not path.is_file():
        raise MissingFile(f"{path}: no such file")
    try:
        with np.load(path, allow_pickle=False) as content:
            data = {name: content[name] for name in content.files}
    except UNREADABLE as error:
        raise FileFormatError(f"{path}: not a map file ({error})") from None
    missing = [name for name in ("state", *MEMORY) if name not in data]
    if missing:
        raise FileFormatError(f"{path}: {', '.join(missing)} missing, it is not a map file")
    fields = parse_json(str(data.pop("state")).encode(), str(path))
    fields.text("format", (FORMAT,))
    side = fields.integer("side", 2, 100_000)
    _check_memory(path, data, side**2)
    first = [int(v) for v in fields.array("first", (2,))] if fields.has("first") else None
    return SavedMap(
        robot=fields.text("robot"),
        resolution=fields.number("resolution", 1e-4, 0.1),
        side=side,
        first=None if first is None else (first[0], first[1]),
        memory={name: data[name] for name in MEMORY},
        state=_state(fields),
    )


def _state(fields: Fields) -> dict[str, Any]:
    drift, anchor = fields.sub("drift"), fields.sub("anchor")
    return {
        "_centre": fields.array("centre", (2,)) if fields.has("centre") else None,
        "_pause": fields.integer("pause", 0),
        "_step": fields.integer("step") if fields.has("step") else None,
        "_time": fields.integer("time") if fields.has("time") else None,
        "_drift": OdometryDrift(*(drift.number(name, 0.0) for name in ("rise", "shift", "turn"))),
        "_sideways": SidewaysDrift.of_fields(fields.sub("sideways")),
        "_anchor": HeightAnchor(
            offset=anchor.number("offset"),
            variance=anchor.number("variance", 0.0),
            rise=anchor.number("rise", 0.0),
            odometry=anchor.number("odometry", 0.0),
            rejected=tuple(str(leg) for leg in anchor.sequence("rejected")),
        ),
        "_walk": WalkCorrection.of_fields(fields.sub("walk")),
        "_ground": [dict(patch.data) for patch in fields.items("ground")],
        "_scans": fields.integer("scans", 0),
        "_reasons": [str(reason) for reason in fields.sequence("reasons")],
    }


def _check_memory(path: Path, data: Mapping[str, Array], count: int) -> None:
    for name, (dtype, _) in MEMORY.items():
        if data[name].dtype != dtype or data[name].shape != (count,):
            raise FileFormatError(
                f"{path}: {name} is {data[name].dtype} of shape {data[name].shape}, it must be {np.dtype(dtype)} "
                f"of shape ({count},)"
            )
    # What is unknown has a cause, what is known has none: a file that says otherwise could make unknown ground safe.
    if (np.isfinite(data["height"]) != (data["cause"] == 0)).any():
        raise FileFormatError(f"{path}: heights and causes of unknown contradict each other, the file is damaged")
    if not all((data[name] >= 0).all() for name in ("variance", "other_variance", "below", "above", "steepness")):
        raise FileFormatError(f"{path}: a variance or an extent of a cell is negative or NaN, the file is damaged")
