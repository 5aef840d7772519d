"""Files made to harm their reader, and the reader of each; `reading_cost` measures what they cost."""

from __future__ import annotations

import io
import json
import shutil
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np


def _write(path: Path, content: bytes) -> None:
    path.write_bytes(content)


def _arrays(path: Path, **arrays: np.ndarray[Any, Any]) -> None:
    np.savez_compressed(path, **arrays)  # type: ignore[arg-type]


def _npz_unknown_array(path: Path) -> None:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("unknown.npy", "w") as file:
        np.lib.format.write_array_header_1_0(file, {"descr": "<f8", "fortran_order": False, "shape": (150_000_000,)})
        for _ in range(1200):
            file.write(bytes(1_000_000))


def _npz_known_array(path: Path) -> None:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("elevation.npy", "w") as file:
        np.lib.format.write_array_header_1_0(file, {"descr": "<f4", "fortran_order": False, "shape": (250_000, 1000)})
        for _ in range(1000):
            file.write(bytes(1_000_000))


def _npz_lying_header(path: Path) -> None:
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f4", "fortran_order": False, "shape": (2**20, 2**20)})
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("elevation.npy", header.getvalue() + bytes(100))


def _mcap(path: Path, chunk: bytes, stated: int, repeats: int = 1) -> None:
    from mcap.writer import Writer

    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2")
        writer.finish()
    whole = path.read_bytes()
    # Magic and header stay; then chunks, and no index: like a file that was cut short.
    begin = 8 + 9 + struct.unpack("<Q", whole[9:17])[0]
    text = b"zstd"
    body = struct.pack("<QQQII", 0, 1, stated, 0, len(text)) + text + struct.pack("<Q", len(chunk)) + chunk
    path.write_bytes(whole[:begin] + (b"\x06" + struct.pack("<Q", len(body)) + body) * repeats)


def _mcap_bomb(path: Path) -> None:
    import zstandard

    compressor = zstandard.ZstdCompressor(level=1).compressobj(size=1_500_000_000)
    pieces = [compressor.compress(bytes(10_000_000)) for _ in range(150)] + [compressor.flush()]
    _mcap(path, b"".join(pieces), 1_000_000)


def _mcap_many_bombs(path: Path) -> None:
    import zstandard

    _mcap(path, zstandard.compress(bytes(90_000_000)), 90_000_000, repeats=60)


def _mcap_many_records(path: Path) -> None:
    import zstandard

    record = b"\x05" + struct.pack("<QHIQQ", 22, 1, 0, 0, 0)
    _mcap(path, zstandard.compress(record * 2_500_000), len(record) * 2_500_000)


def _mcap_long_record(path: Path) -> None:
    _mcap(path, b"", 0)
    path.write_bytes(path.read_bytes() + b"\x09" + struct.pack("<Q", 2**62) + bytes(100))


def _png(width: int, height: int) -> bytes:
    def chunk(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    row = zlib.compressobj(9)
    lines = b"".join(row.compress(bytes(1 + 3 * width)) for _ in range(min(height, 20_000))) + row.flush()
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", lines) + chunk(b"IEND", b"")


def _stance() -> dict[str, Any]:
    return {"joint_positions": {"lf_haa_joint": 0.0}, "support_feet": ["lf", "rf", "lh"]}


def _scan(path: Path, stripes: list[dict[str, Any]], picture: bytes = b"") -> None:
    path.mkdir()
    content = {
        "format": "guara-scan/1",
        "robot": "guara",
        "mode": "standard",
        "stamp": 0,
        "step": 0,
        "stripes": stripes,
        "stance": _stance(),
    }
    (path / "scan.json").write_text(json.dumps(content))
    (path / "on.png").write_bytes(picture)


def _scan_of_many_stripes(path: Path) -> None:
    _scan(path, [{"index": n, "mirror_angle": 0.0, "on": "on.png", "off": None} for n in range(200_000)])


def _scan_of_large_frames(path: Path) -> None:
    _scan(path, [{"index": 0, "mirror_angle": 0.0, "on": "on.png", "off": None}], _png(20_000, 20_000))


def _calibration(path: Path, text: str = "", **changes: Any) -> None:
    camera = {"size": [1280, 1024], "matrix": np.diag([1000.0, 1000.0, 1.0]).tolist(), "distortion": [0.0] * 5}
    content = {
        "format": "guara-calibration/1",
        "robot": "guara",
        "camera": {**camera, **changes},
        "transform_camera_to_base": np.eye(4).tolist(),
        "stripes": [{"index": 0, "mirror_angle": 0.0, "plane": [1.0, 0.0, 0.0, 0.0]}],
        "mirror": None,
        "paper": None,
        "covariance": None,
    }
    path.write_text(text or json.dumps(content))


def _robot(path: Path, toml: str = "", urdf: bytes = b"") -> None:
    source = Path(__file__).resolve().parents[2] / "robots" / "guara"
    shutil.copytree(source, path, ignore=shutil.ignore_patterns("meshes"))
    if toml:
        (path / "robot.toml").write_text(toml)
    if urdf:
        for file in path.rglob("*.urdf"):
            file.write_bytes(urdf)


def _keys(path: Path, text: str) -> None:
    path.mkdir()
    (path / "zenoh.json5").write_text(text)


def _aliases() -> bytes:
    lines = [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]" for n in range(1, 25)]
    return "\n".join(["a0: &a0 [1]", *lines]).encode()


def _read_terrain(path: Path) -> None:
    import guara_perception as gp

    gp.load_terrain(path)


def _recover(path: Path) -> None:
    from transport.recording import recover_recording

    recover_recording(path, path.with_name("recovered.mcap"))


def _replay(path: Path) -> None:
    from guara_perception.app.files.open_scan import open_scans

    open_scans(path)


def _open_scan(path: Path) -> None:
    from guara_perception.app.files.open_scan import open_scan

    for _ in open_scan(path).frames():
        pass


def _load_calibration(path: Path) -> None:
    import guara_perception as gp

    gp.load_calibration(path)


def _load_robot(path: Path) -> None:
    from kinematics import load_robot

    load_robot(path)


def _load_world(path: Path) -> None:
    from guara_perception.simulation.world import load_world

    load_world(path)


def _load_camera(path: Path) -> None:
    from guara_perception.app.files.camera_info import read_camera_info

    read_camera_info(path)


def _open_keys(path: Path) -> None:
    from transport.security.folder import load_configuration

    load_configuration(path)


def _fine_grid(path: Path) -> None:
    from guara_perception.terrain.layers.geometry import GridGeometry

    GridGeometry.over((0.5, 0.95), (-0.27, 0.27), float(path.read_text()))


Making = Callable[[Path], None]
FILES: dict[str, tuple[str, Making, Making]] = {
    "npz: 1.2 GB in an array that nobody asks for": ("a.npz", _npz_unknown_array, _read_terrain),
    "npz: 1 GB in a layer": ("a.npz", _npz_known_array, _read_terrain),
    "npz: header of 4 TB": ("a.npz", _npz_lying_header, _read_terrain),
    "npz: a text": ("a.npz", lambda p: _arrays(p, elevation=np.array("no")), _read_terrain),
    "mcap: chunk of 1.5 GB, recovered": ("a.mcap", _mcap_bomb, _recover),
    "mcap: 60 chunks of 90 MB, recovered": ("a.mcap", _mcap_many_bombs, _recover),
    "mcap: 2.5 million messages, recovered": ("a.mcap", _mcap_many_records, _recover),
    "mcap: record of 2^62 bytes, recovered": ("a.mcap", _mcap_long_record, _recover),
    "mcap: record of 2^62 bytes, replayed": ("a.mcap", _mcap_long_record, _replay),
    "mcap: no mcap at all, replayed": ("a.mcap", lambda p: _write(p, bytes(5_000_000)), _replay),
    "scan: 200,000 stripes": ("scan", _scan_of_many_stripes, _open_scan),
    "scan: frame of 20,000 x 20,000 px": ("scan", _scan_of_large_frames, _open_scan),
    "calibration: camera of 1e9 px": ("c.json", lambda p: _calibration(p, size=[10**9, 10**9]), _load_calibration),
    "calibration: 100,000 lists in one another": (
        "c.json",
        lambda p: _calibration(p, "[" * 100_000),
        _load_calibration,
    ),
    "calibration: a number of a million digits": (
        "c.json",
        lambda p: _calibration(p, '{"format": ' + "9" * 1_000_000 + "}"),
        _load_calibration,
    ),
    "calibration: 60 MB of text": ("c.json", lambda p: _calibration(p, "[" + "0," * 30_000_000), _load_calibration),
    "robot.toml: key of 50,000 pieces": ("r", lambda p: _robot(p, ".".join("a" * 50_000) + " = 1"), _load_robot),
    "robot.toml: 100,000 lists in one another": ("r", lambda p: _robot(p, "a = " + "[" * 100_000), _load_robot),
    "robot.toml: lists side by side and in one another": (
        "r",
        lambda p: _robot(p, "a = " + "[[]," * 100_000),
        _load_robot,
    ),
    "robot.toml: a number of a million digits": ("r", lambda p: _robot(p, "a = " + "9" * 1_000_000), _load_robot),
    "urdf: unknown encoding": (
        "r",
        lambda p: _robot(p, urdf=b'<?xml version="1.0" encoding="klingon"?><robot name="a"/>'),
        _load_robot,
    ),
    "urdf: entities": (
        "r",
        lambda p: _robot(p, urdf=b'<!DOCTYPE r [<!ENTITY a "aaaaaaaaaa">]><robot name="&a;"/>'),
        _load_robot,
    ),
    "urdf: 300,000 elements in one another": ("r", lambda p: _robot(p, urdf=b"<robot>" * 300_000), _load_robot),
    "world: key of 50,000 pieces": ("w.toml", lambda p: _write(p, b".".join([b"a"] * 50_000) + b" = 1"), _load_world),
    "world: 100,000 lists in one another": ("w.toml", lambda p: _write(p, b"x = " + b"[" * 100_000), _load_world),
    "camera_info: aliases": (
        "c.yaml",
        lambda p: _write(p, _aliases()),
        _load_camera,
    ),
    "zenoh.json5: 200,000 lists in one another": ("k", lambda p: _keys(p, "[" * 200_000), _open_keys),
    "zenoh.json5: 5 MB": ("k", lambda p: _keys(p, '{"mode": "' + "a" * 5_000_000 + '"}'), _open_keys),
    "resolution of 1e-9 m": ("resolution", lambda p: _write(p, b"1e-9"), _fine_grid),
}
