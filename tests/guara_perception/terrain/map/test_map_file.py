"""A map that is saved during a walk continues without a difference; damaged files are rejected."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import guara_perception as gp
from kinematics import PoseInOdom, RobotModel

MakeScan = Callable[..., gp.TerrainGrid]


MOTION = np.diag([0.002**2, 0.002**2, 0.001**2, 1e-8, 1e-8, 0.002**2])


def add_pause(
    terrain_map: gp.TerrainMap, make_scan: MakeScan, step: int, *, registered: bool = False
) -> gp.TerrainGrid:
    """Add a pause of a walk over rough ground with an unknown patch, half a cycle farther each time."""
    rng = np.random.default_rng(step)
    transform = np.eye(4)
    transform[:2, 3] = 0.07 * step, 0.003 * step
    flags = np.zeros((108, 90), np.uint16)
    flags[40:44, 30:50] = gp.Hazard.DROPOUT
    scan = make_scan(rng.normal(0, 0.0005, (108, 90)), flags=flags, step=step)
    ground = [gp.KnownGround([[-0.4, -0.3], [0.5, -0.3], [0.5, 0.3], [-0.4, 0.3]], 0.0, 0.001)] if step == 0 else []
    covariance = step * (MOTION if registered else 1e-6 * np.eye(6))
    return terrain_map.update(
        scan, PoseInOdom(transform, covariance, MOTION if registered else None), known_ground=ground
    )


@pytest.mark.slow
@pytest.mark.parametrize("registered", [False, True])
def test_a_loaded_map_goes_on_bit_for_bit(
    robot: RobotModel, make_scan: MakeScan, tmp_path: Path, registered: bool
) -> None:
    """Four pauses, saved, loaded, four more: bytes and metadata equal those of eight pauses without a break."""
    whole, first = gp.TerrainMap(robot), gp.TerrainMap(robot)
    for step in range(4):
        add_pause(whole, make_scan, step, registered=registered)
        add_pause(first, make_scan, step, registered=registered)
    first.save(tmp_path / "map.npz")
    again = gp.TerrainMap.load(tmp_path / "map.npz")
    for step in range(4, 8):
        expected, found = (add_pause(each, make_scan, step, registered=registered) for each in (whole, again))
        for name, layer in expected.layers.items():
            np.testing.assert_array_equal(layer, found.layer(name), err_msg=name)
        assert dict(expected.metadata) == dict(found.metadata)


@pytest.mark.slow
def test_a_map_of_no_scan_can_be_saved(robot: RobotModel, make_scan: MakeScan, tmp_path: Path) -> None:
    """A map without a scan can be saved and loaded."""
    gp.TerrainMap(robot).save(tmp_path / "map.npz")
    fused = add_pause(gp.TerrainMap.load(tmp_path / "map.npz", robot), make_scan, 0)
    assert (fused.traversability > 0).any()


def test_what_is_no_map_is_refused(robot: RobotModel, make_scan: MakeScan, tmp_path: Path) -> None:
    """A missing file, a text, a grid, a truncated file, and a map whose memory was changed."""
    terrain_map = gp.TerrainMap(robot)
    add_pause(terrain_map, make_scan, 0)
    good = tmp_path / "map.npz"
    terrain_map.save(good)
    with pytest.raises(gp.MissingFile, match="no such file"):
        gp.TerrainMap.load(tmp_path / "none.npz")
    (tmp_path / "text.npz").write_text("hello")
    with pytest.raises(gp.FileFormatError, match="not a map file"):
        gp.TerrainMap.load(tmp_path / "text.npz")
    (tmp_path / "cut.npz").write_bytes(good.read_bytes()[:-2000])
    with pytest.raises(gp.FileFormatError, match="not a map file"):
        gp.TerrainMap.load(tmp_path / "cut.npz")
    gp.assess_terrain(np.zeros((9, 9)), 0.01).save(tmp_path / "grid.npz")
    with pytest.raises(gp.FileFormatError, match="not a map file; missing arrays: "):
        gp.TerrainMap.load(tmp_path / "grid.npz")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("height", lambda a: np.where(np.isnan(a), 0.0, a), "contradict each other"),
        ("variance", lambda a: a - 1.0, "negative or NaN"),
        ("apart", lambda a: a * np.nan, "negative or NaN"),
        ("looks", lambda a: a.astype(np.int64), "looks is int64 of shape"),
        ("cause", lambda a: a[:-1], "cause is uint16 of shape"),
        ("state", lambda a: np.array(json.dumps({**json.loads(str(a)), "side": 4})), "it must be"),
        ("state", lambda a: np.array(json.dumps({**json.loads(str(a)), "format": "guara-map/9"})), "guara-map/9"),
        ("state", lambda a: np.array(json.dumps({**json.loads(str(a)), "pause": -3})), "pause is -3"),
    ],
)
def test_a_damaged_map_is_refused(
    robot: RobotModel, tmp_path: Path, name: str, change: Callable[[np.ndarray], np.ndarray], message: str
) -> None:
    """Damage that could make unknown ground known is rejected."""
    path = tmp_path / "map.npz"
    gp.TerrainMap(robot).save(path)
    with np.load(path) as content:
        data = {key: content[key] for key in content.files}
    data[name] = change(data[name])
    np.savez(path, **data)
    with pytest.raises(gp.FileFormatError, match=message):
        gp.TerrainMap.load(path, robot)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seen", "origin", "message"),
    [
        (np.zeros((3, 4, 5), np.float32), np.zeros(2), "seen is float32 of shape"),
        (np.zeros((2, 4, 5)), np.zeros(2), "seen is float64 of shape"),
        (np.zeros((2, 4, 5), np.float32), np.array([0.0, np.nan]), "seen_origin is not two finite numbers"),
    ],
)
def test_a_damaged_scan_in_a_map_is_refused(
    robot: RobotModel, tmp_path: Path, seen: np.ndarray, origin: np.ndarray, message: str
) -> None:
    """If the ground of the last scan has the wrong shape, the file is rejected."""
    path = tmp_path / "map.npz"
    gp.TerrainMap(robot).save(path)
    with np.load(path) as content:
        data = {key: content[key] for key in content.files}
    np.savez(path, **data, seen=seen, seen_origin=origin)
    with pytest.raises(gp.FileFormatError, match=message):
        gp.TerrainMap.load(path, robot)


def test_a_map_whose_cells_do_not_fit_the_robot_is_refused(robot: RobotModel, tmp_path: Path) -> None:
    """If its resolution does not divide the area of another robot.toml, the error names the file."""
    path = tmp_path / "map.npz"
    gp.TerrainMap(robot).save(path)
    with np.load(path) as content:
        data = {key: content[key] for key in content.files}
    data["state"] = np.array(json.dumps({**json.loads(str(data["state"])), "resolution": 0.0047}))
    np.savez(path, **data)
    with pytest.raises(gp.FileFormatError, match=r"map\.npz: .*resolution"):
        gp.TerrainMap.load(path, robot)
