"""State of a rolling map except its cells, and the NumPy file of a map."""

from __future__ import annotations

import dataclasses
import json
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

import numpy as np

from guara_perception.arrays import Array, Float
from guara_perception.exceptions import FileFormatError
from guara_perception.fields import Fields, parse_json
from guara_perception.files import existing_file, read_arrays
from guara_perception.terrain.map.fuse_heights import OdometryDrift
from guara_perception.terrain.map.odom_cells import MEMORY, OdomCells
from guara_perception.terrain.map.registration import SeenGround
from guara_perception.terrain.map.seen_texture import SeenTexture
from guara_perception.terrain.map.soft_ground import SoftFoothold
from guara_perception.terrain.map.support_feet import HeightAnchor
from guara_perception.terrain.map.walk_correction import FILE_KEYS, SidewaysDrift, WalkCorrection

FORMAT = "guara-map/3"
# Names of the arrays of SeenGround in files.
SEEN = {"layers": "seen", "origin": "seen_origin"}
# Names of the arrays of SeenTexture in files.
TEXTURE = {"texture": "texture", "first": "texture_first"}
# Largest total size of the arrays [bytes]; a window of 4 m x 4 m with cells of 1 mm takes 1.7 GB.
LARGEST_MAP = 2 * 1024**3
# Compression level of deflate.
COMPRESSION = 1


@dataclass(frozen=True, slots=True, eq=False)
class MapState:
    """State of a map except its cells.

    Attributes:
        centre: (2,) centre of the window in odom [m], None before the first pause.
        pause: number of the newest pause, counted from the first scan.
        step, time: step and time [ns] of the newest scan.
        drift, sideways: drift of odometry since the start, and planar drift by pause.
        anchor, walk: height and planar correction of odometry.
        seen: ground measured by the newest scan, for registered walks.
        texture: texture of the ground in view, for walks with images.
        ground: declared patches of known ground, as in the map's record.
        scans: number of fused scans.
        reasons: faults of the map, which are added to the health of its grids.
        soft: footholds at which the ground gave way or the foot slid.
    """

    centre: Float | None = None
    pause: int = 0
    step: int | None = None
    time: int | None = None
    drift: OdometryDrift = OdometryDrift()
    sideways: SidewaysDrift = field(default_factory=SidewaysDrift)
    anchor: HeightAnchor = HeightAnchor()
    walk: WalkCorrection = field(default_factory=WalkCorrection)
    seen: SeenGround | None = None
    texture: SeenTexture | None = None
    ground: tuple[Mapping[str, Any], ...] = ()
    scans: int = 0
    reasons: tuple[str, ...] = ()
    soft: tuple[SoftFoothold, ...] = ()


def write_map(stream: IO[bytes], robot: str, cells: OdomCells, state: MapState) -> None:
    """Write a map to a stream; `read_map` ignores any data that precede the map."""
    header = {"format": FORMAT, "robot": robot, "resolution": cells.resolution, "side": cells.side}
    fields = dataclasses.asdict(state)
    named = [(SEEN, fields.pop("seen") or {}), (TEXTURE, fields.pop("texture") or {})]
    fields["walk"] = {FILE_KEYS.get(name, name): value for name, value in fields["walk"].items()}
    text = json.dumps({**header, "first": cells.first, **fields}, default=np.ndarray.tolist)
    seen = {names[name]: array for names, layers in named for name, array in layers.items()}
    # Like `np.savez_compressed`, but at a level that takes a third of the time, because the journal is written at each
    # pause.
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED, compresslevel=COMPRESSION) as archive:
        for name, array in ({"state": np.array(text)} | dict(cells.memory) | seen).items():
            with archive.open(f"{name}.npy", "w") as member:
                np.lib.format.write_array(member, np.asanyarray(array), allow_pickle=False)


def read_map(path: str | Path) -> tuple[str, OdomCells, MapState]:
    """Read the name of the robot, the cells and the other state from a file written by `write_map`.

    Raises:
        MissingFile: there is no such file.
        FileFormatError: the file is not a map file, or its contents are invalid or inconsistent.
    """
    path = existing_file(path)
    data = read_arrays(path, ("state", *MEMORY, *SEEN.values(), *TEXTURE.values()), "map", LARGEST_MAP)
    if "variance" in data:
        # Files of earlier versions contain only the total variance: neither its local part nor `apart`.
        data.setdefault("local", data["variance"])
        data.setdefault("apart", data["variance"] * np.maximum(data.get("looks", 1), 1))
    missing = [name for name in ("state", *MEMORY) if name not in data]
    if missing:
        raise FileFormatError(f"{path}: not a map file; missing arrays: {', '.join(missing)}")
    fields = parse_json(str(data.pop("state")).encode(), str(path))
    fields.text("format", (FORMAT,))
    side = fields.integer("side", 2, 100_000)
    _check_memory(path, data, side**2)
    cells = OdomCells(fields.number("resolution", 1e-4, 0.1), side)
    first = [int(v) for v in fields.array("first", (2,))] if fields.has("first") else None
    cells.restore(data, None if first is None else (first[0], first[1]))
    state = dataclasses.replace(_state(fields, _seen(path, data)), texture=_texture(path, data))
    return fields.text("robot"), cells, state


def _seen(path: Path, data: Mapping[str, Array]) -> SeenGround | None:
    layers, origin = (data.get(key) for key in SEEN.values())
    if layers is None or origin is None:
        # A walk without registration, or a file of an earlier version.
        return None
    if layers.dtype != np.float32 or layers.ndim != 3 or len(layers) != 2 or layers.size < 2:
        raise FileFormatError(f"{path}: seen is {layers.dtype} of shape {layers.shape}; it must be float32 (2, ny, nx)")
    if origin.dtype != np.float64 or origin.shape != (2,) or not np.isfinite(origin).all():
        raise FileFormatError(f"{path}: seen_origin is not two finite numbers: the file is damaged")
    return SeenGround(layers, origin)


def _texture(path: Path, data: Mapping[str, Array]) -> SeenTexture | None:
    texture, first = (data.get(key) for key in TEXTURE.values())
    if texture is None or first is None:
        return None
    if texture.dtype != np.uint8 or texture.ndim != 2 or first.dtype != np.int64 or first.shape != (2,):
        raise FileFormatError(
            f"{path}: texture is {texture.dtype} {texture.shape}, texture_first is {first.dtype} {first.shape}; "
            "allowed: uint8 (ny, nx) and int64 (2,)"
        )
    return SeenTexture(texture, first)


def _state(fields: Fields, seen: SeenGround | None) -> MapState:
    drift, anchor = fields.sub("drift"), fields.sub("anchor")
    return MapState(
        centre=fields.array("centre", (2,)) if fields.has("centre") else None,
        pause=fields.integer("pause", 0),
        step=fields.integer("step") if fields.has("step") else None,
        time=fields.integer("time") if fields.has("time") else None,
        drift=OdometryDrift(*(drift.number(name, 0.0) for name in ("rise", "shift", "turn"))),
        sideways=SidewaysDrift.of_fields(fields.sub("sideways")),
        anchor=HeightAnchor(
            offset=anchor.number("offset"),
            **{name: anchor.number(name, 0.0) for name in ("variance", "rise", "odometry")},
            rejected=tuple(str(leg) for leg in anchor.sequence("rejected")),
        ),
        walk=WalkCorrection.of_fields(fields.sub("walk")),
        seen=seen,
        ground=tuple(dict(patch.data) for patch in fields.items("ground")),
        scans=fields.integer("scans", 0),
        reasons=tuple(str(reason) for reason in fields.sequence("reasons")),
        # Files of earlier versions do not contain soft footholds.
        soft=tuple(SoftFoothold(each.number("x"), each.number("y")) for each in fields.items("soft"))
        if fields.has("soft")
        else (),
    )


def _check_memory(path: Path, data: Mapping[str, Array], count: int) -> None:
    for name, (dtype, _) in MEMORY.items():
        if data[name].dtype != dtype or data[name].shape != (count,):
            raise FileFormatError(
                f"{path}: {name} is {data[name].dtype} of shape {data[name].shape}; it must be {np.dtype(dtype)} "
                f"of shape ({count},)"
            )
    # Exactly the unknown cells must have a cause; otherwise unknown ground could become safe.
    if (np.isfinite(data["height"]) != (data["cause"] == 0)).any():
        raise FileFormatError(f"{path}: heights and causes of unknown cells contradict each other: the file is damaged")
    extents = ("variance", "local", "other_variance", "below", "above", "steepness")
    if not all((data[name] >= 0).all() for name in extents) or not np.isfinite(data["apart"]).all():
        raise FileFormatError(f"{path}: a variance or an extent of a cell is negative or NaN: the file is damaged")
