"""The accuracy benchmark: its metrics on truth made by hand, and the foundation's figures on the recorded scans."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import guara_perception as gp
from kinematics import RobotModel
from testbed.grid_truth import figures, load_truth

pytestmark = pytest.mark.slow

CELL = 5
NY, NX = 8, 12


def truth_file(path: Path, elevation: np.ndarray, **layers: np.ndarray) -> Path:
    """A truth.npz at 1 mm; what is not given is seen and not dark."""
    whole = {
        "visible": np.ones(elevation.shape, bool),
        "lit": np.ones(elevation.shape, bool),
        "dark": np.zeros(elevation.shape, bool),
        **layers,
    }
    np.savez(path, elevation=elevation, **whole)
    return path


def flat() -> np.ndarray:
    """A floor of NY x NX cells at 1 mm, 20 mm high."""
    return np.full((NY * CELL, NX * CELL), 0.02)


def grid(elevation: np.ndarray) -> gp.TerrainGrid:
    """Terrain of any heights, assessed on its own."""
    return gp.assess_terrain(elevation.astype(np.float32), 0.005)


def test_flat_floor_is_all_interior(tmp_path: Path):
    """Everything seen and flat: every cell is interior, none unseen or dark, the mean is the height."""
    truth = load_truth(truth_file(tmp_path / "t.npz", flat()), CELL)
    assert truth.interior.all() and not truth.unseen.any() and not truth.dark.any()
    for layer in (truth.mean, truth.low, truth.high):
        assert layer.shape == (NY, NX)
        np.testing.assert_allclose(layer, 0.02)


def test_cells_are_gathered_row_by_row(tmp_path: Path):
    """Cell (iy, ix) holds the millimetres 5 iy ... 5 iy + 4 and 5 ix ... 5 ix + 4."""
    elevation = flat()
    elevation[10:15, 30:35] = np.arange(25).reshape(5, 5) / 1000
    truth = load_truth(truth_file(tmp_path / "t.npz", elevation), CELL)
    assert truth.mean[2, 6] == pytest.approx(0.012)
    assert (truth.low[2, 6], truth.high[2, 6]) == (0.0, pytest.approx(0.024))
    assert truth.mean[6, 2] == pytest.approx(0.02)


def test_interior_keeps_six_millimetres_from_every_jump(tmp_path: Path):
    """A step of 10 mm between columns 29 and 30: cells within 6 mm of the pixels that see it are no interior."""
    elevation = flat()
    elevation[:, 30:] += 0.010
    interior = load_truth(truth_file(tmp_path / "t.npz", elevation), CELL).interior
    # The range over 3 x 3 mm shows the jump at columns 29 and 30, so 23 ... 36 are too near: cells 4 ... 7.
    np.testing.assert_array_equal(interior[3], [True] * 4 + [False] * 4 + [True] * 4)


def test_gentle_slope_is_interior(tmp_path: Path):
    """Less than 3 mm within 3 x 3 mm is no jump."""
    elevation = flat() + np.arange(NX * CELL) * 0.001
    assert load_truth(truth_file(tmp_path / "t.npz", elevation), CELL).interior.all()


@pytest.mark.parametrize("layer", ["visible", "lit"])
def test_one_unseen_millimetre_ends_interior_but_not_seen(tmp_path: Path, layer: str):
    """Interior needs every millimetre seen; unseen means that none is."""
    seen = np.ones(flat().shape, bool)
    seen[0, 0] = False
    seen[20:25, 20:25] = False
    truth = load_truth(truth_file(tmp_path / "t.npz", flat(), **{layer: seen}), CELL)
    assert not truth.interior[0, 0] and not truth.unseen[0, 0]
    assert truth.unseen[4, 4] and truth.unseen.sum() == 1


def test_dark_needs_the_whole_cell(tmp_path: Path):
    """A cell is dark when all of it is, and then nobody saw it either."""
    dark = np.zeros(flat().shape, bool)
    dark[5:10, 5:10] = True
    dark[20:24, 20:25] = True
    truth = load_truth(truth_file(tmp_path / "t.npz", flat(), dark=dark), CELL)
    assert truth.dark[1, 1] and truth.unseen[1, 1] and truth.dark.sum() == 1
    assert not truth.interior[4, 4] and not truth.unseen[4, 4]


def test_error_is_measured_in_millimetres_with_its_sign(tmp_path: Path):
    """1 mm too high in the near third and 2 mm too low in the far one, nothing between."""
    truth = load_truth(truth_file(tmp_path / "t.npz", flat()), CELL)
    elevation = np.full((NY, NX), 0.02)
    elevation[:, :4] += 0.001
    elevation[:, 8:] -= 0.002
    result = figures(grid(elevation), truth)
    assert (result.near, result.far) == (pytest.approx(1, abs=1e-4), pytest.approx(2, abs=1e-4))
    assert (result.bias_near, result.bias_far) == (pytest.approx(1, abs=1e-4), pytest.approx(-2, abs=1e-4))
    assert result.mean == pytest.approx(1, abs=1e-4) and result.bias == pytest.approx(-1 / 3, abs=1e-4)
    assert result.worst == pytest.approx(2, abs=1e-4) and result.p95 == pytest.approx(2, abs=1e-4)
    assert result.known == 100


def test_known_counts_interior_cells(tmp_path: Path):
    """A quarter of the interior left unknown is 75 % known, and has no error."""
    truth = load_truth(truth_file(tmp_path / "t.npz", flat()), CELL)
    elevation = np.full((NY, NX), 0.02)
    elevation[:2] = np.nan
    result = figures(grid(elevation), truth)
    assert result.known == pytest.approx(75) and result.mean == pytest.approx(0, abs=1e-4)


def test_made_up_ground_is_counted(tmp_path: Path):
    """Heights where nobody could see: their share, and those that lie 2 mm outside the true heights."""
    unseen = np.ones(flat().shape, bool)
    unseen[:, 50:] = False
    truth = load_truth(truth_file(tmp_path / "t.npz", flat(), visible=unseen), CELL)
    elevation = np.full((NY, NX), 0.02)
    elevation[:, 11] = np.nan
    elevation[:4, 10] = 0.0221
    result = figures(grid(elevation), truth)
    assert result.unseen_known == pytest.approx(50)
    assert result.unseen_wrong == 4


def test_safe_cells_where_nobody_looked_are_counted(tmp_path: Path):
    """A large flat grid is traversable in its interior; if that was dark, every such cell is unsafe."""
    side = 60
    elevation = np.full((side * CELL, side * CELL), 0.0)
    terrain = grid(np.zeros((side, side)))
    safe = terrain.traversability > 0
    assert safe[30, 30]
    dark = np.ones(elevation.shape, bool)
    truth = load_truth(truth_file(tmp_path / "dark.npz", elevation, dark=dark), CELL)
    result = figures(terrain, truth)
    assert result.unsafe == int(safe.sum()) and result.dark_known == 100 and result.known == 0
    assert np.isnan(result.mean)
    seen = load_truth(truth_file(tmp_path / "seen.npz", elevation), CELL)
    assert figures(terrain, seen).unsafe == 0


@pytest.mark.parametrize("name", ["paper", "dark", "tilt"])
def test_recorded_scans_meet_the_foundations_figures(
    data: Path, calibration: gp.Calibration, robot: RobotModel, name: str
):
    """Mean error 0.25 mm at most, 98 % of the interior known, nothing safe that is dark or that nobody could see."""
    folder = data / "scans" / name
    terrain = gp.process_scan(gp.open_scan(folder), calibration, robot, pictures=False)
    result = figures(terrain, load_truth(folder / "truth.npz", CELL))
    assert result.mean <= 0.25
    assert result.known >= 98.0
    assert result.unsafe == 0
    assert abs(result.bias) <= 0.1


@pytest.mark.heavy
def test_command_prints_one_row_per_scan(data: Path, root: Path):
    """`python -m benchmarks.accuracy FOLDER` prints the header and a row for each scan asked for."""
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks", "accuracy", str(data), "--scans", "tilt"],
        capture_output=True,
        text=True,
        cwd=root,
        check=True,
    )
    lines = done.stdout.splitlines()
    assert lines[1].split()[:3] == ["scan", "method", "mean"] and len(lines) == 3 and len(set(map(len, lines[1:]))) == 1
    assert lines[2].startswith("data/tilt") and " precise " in lines[2]


@pytest.mark.heavy
def test_a_folder_without_truth_is_refused(root: Path, tmp_path: Path):
    """In one line that names what is missing."""
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks", "accuracy", str(tmp_path)], capture_output=True, text=True, cwd=root
    )
    assert done.returncode == 1
    assert (
        done.stderr
        == f"{tmp_path} has no calibration/truth.json; give a data folder of rendered scans with their truth\n"
    )
