"""Damaged files, cut anywhere or with bytes changed, are refused, as are values that nobody would write."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.app.files.camera_info import read_camera_info
from guara_perception.app.files.open_scan import open_scans
from guara_perception.calibration.file import to_json
from guara_perception.simulation.specimen import specimen
from guara_perception.simulation.world import load_world
from kinematics import KinematicsError, load_robot
from transport import TransportError
from transport.messages.submessages import StanceMessage
from transport.recording import RecordingWriter, ScanRecord, recover_recording
from transport.security.folder import init_security, load_configuration

ROOT = Path(__file__).resolve().parents[2]
PACKAGE_ERRORS = (gp.PerceptionError, KinematicsError, TransportError)
MUTATIONS = 150


def _recording(path: Path) -> None:
    stance = StanceMessage(joint_positions={"lf_haa_joint": 0.0}, support_feet=("lf", "rf", "lh"))
    with RecordingWriter(path, calibration=b"{}") as writer:
        for step in range(3):
            writer.begin_scan(ScanRecord(robot="guara", mode="coarse", stamp=step + 1, step=step, stance=stance))
            writer.end_scan(stamp=step + 1)


def _world(path: Path) -> None:
    path.write_bytes(next((ROOT / "guara_perception/simulation/worlds").glob("*.toml")).read_bytes())


def _camera(path: Path) -> None:
    lines = ["image_width: 1280", "image_height: 1024", "distortion_model: plumb_bob"]
    lines += ["camera_matrix: {rows: 3, cols: 3, data: [1000, 0, 640, 0, 1000, 512, 0, 0, 1]}"]
    lines += ["distortion_coefficients: {rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}"]
    path.write_text("\n".join(lines))


def _calibration(path: Path) -> None:
    path.write_text(to_json(specimen(load_robot("guara"), (640, 512), 0)))


def _scan(path: Path) -> None:
    path.write_bytes((ROOT / "tests/data/scans/paper/scan.json").read_bytes())


def _open_scan_json(path: Path) -> None:
    from guara_perception.app.files.scan_folder import open_scan_folder

    open_scan_folder(path.parent)


def _grid(path: Path) -> None:
    elevation = np.zeros((30, 30))
    gp.assess_terrain(elevation, 0.005).save(path)


def _recover(path: Path) -> None:
    target = path.with_name("recovered.mcap")
    target.unlink(missing_ok=True)
    recover_recording(path, target)


CASES: dict[str, tuple[str, Callable[[Path], None], Callable[[Path], object]]] = {
    "npz": ("t.npz", _grid, gp.load_terrain),
    "mcap": ("r.mcap", _recording, open_scans),
    "recover": ("r.mcap", _recording, _recover),
    "calibration": ("c.json", _calibration, gp.load_calibration),
    "world": ("w.toml", _world, load_world),
    "camera_info": ("c.yaml", _camera, read_camera_info),
    "scan.json": ("scan.json", _scan, _open_scan_json),
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", list(CASES))
def test_damaged_files_end_in_words(tmp_path: Path, kind: str) -> None:
    """Cut anywhere, bytes changed, pieces repeated: an error of the packages or a file that is still sound."""
    name, make, read = CASES[kind]
    sound = tmp_path / name
    make(sound)
    content = sound.read_bytes()
    rng = np.random.default_rng(len(kind))
    refused = 0
    for number in range(MUTATIONS):
        damaged = bytearray(content)
        where = int(rng.integers(0, len(damaged)))
        if number % 3 == 0:
            del damaged[where:]
        elif number % 3 == 1:
            damaged[where] ^= int(rng.integers(1, 256))
        else:
            damaged[where:where] = damaged[where : where + 40] * 3
        sound.write_bytes(damaged)
        try:
            read(sound)
        except PACKAGE_ERRORS:
            refused += 1
    assert refused > 0


ODD = (None, True, 0, -1, 10**9, -(10**400), 1e308, 1e-320, "", "x" * 1000, [], {}, [[[]]], [None] * 3, {"a": {}})


def _paths(node: object, path: tuple = ()) -> Iterator[tuple]:
    """Paths of the values of a JSON text, objects and lists too."""
    for key, value in node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ():
        yield (*path, key)
        yield from _paths(value, (*path, key))


@pytest.mark.slow
def test_a_calibration_of_odd_values_ends_in_words(tmp_path: Path, paper_scan: gp.Scan) -> None:
    """Any value replaced by any other: refused, or fit to process a scan with; no warning of numpy either."""
    path, robot = tmp_path / "c.json", load_robot("guara")
    _calibration(path)
    text = path.read_text()
    paths = list(_paths(json.loads(text)))
    rng = np.random.default_rng(3)
    outcomes = {"refused": 0, "used": 0}
    for number in range(MUTATIONS):
        where = paths[int(rng.integers(len(paths)))]
        # Values near the root are as frequent as deeply nested ones.
        *parents, last = where[: int(rng.integers(1, len(where) + 1))]
        content = json.loads(text)
        node = content
        for key in parents:
            node = node[key]
        node[last] = ODD[number % len(ODD)]
        path.write_text(json.dumps(content))
        try:
            with np.errstate(all="raise"):
                gp.ScanProcessor(gp.load_calibration(path), robot, paper_scan.stance, "coarse").finish()
        except PACKAGE_ERRORS:
            outcomes["refused"] += 1
        else:
            outcomes["used"] += 1
    assert outcomes["refused"] > 100 and outcomes["used"] > 0


@pytest.mark.slow
@pytest.mark.parametrize("file", ["robot.toml", "urdf/guara.urdf"])
def test_damaged_robot_files_end_in_words(tmp_path: Path, file: str) -> None:
    """As above, for files of a robot folder."""
    import shutil

    shutil.copytree(ROOT / "robots/guara", tmp_path / "guara", ignore=shutil.ignore_patterns("meshes"))
    path = tmp_path / "guara" / file
    content = path.read_bytes()
    rng = np.random.default_rng(1)
    for number in range(60):
        damaged = bytearray(content)
        where = int(rng.integers(0, len(damaged)))
        if number % 2:
            damaged[where] ^= int(rng.integers(1, 256))
        else:
            del damaged[where : where + 30]
        path.write_bytes(damaged)
        try:
            load_robot(tmp_path / "guara")
        except PACKAGE_ERRORS:
            continue


def test_damaged_security_folders_end_in_words(tmp_path: Path) -> None:
    """The Zenoh configuration of a role, cut and changed; Zenoh's own reader never ends the process."""
    path = init_security(tmp_path / "keys") / "node" / "zenoh.json5"
    content = path.read_bytes()
    rng = np.random.default_rng(2)
    for _ in range(60):
        damaged = bytearray(content)
        damaged[int(rng.integers(0, len(damaged)))] ^= int(rng.integers(1, 256))
        path.write_bytes(damaged)
        try:
            load_configuration(path.parent)
        except PACKAGE_ERRORS:
            continue
