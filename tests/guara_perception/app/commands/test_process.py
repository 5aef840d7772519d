"""`guara process`: its output file, and the scans with bad frames that --keep-going accepts."""

import json
import zipfile
from pathlib import Path

import cv2
import numpy as np
import pytest

import guara_perception as gp
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK

FLOATS = (
    *("elevation", "variance", "variance_local", "elevation_min", "elevation_max"),
    *("slope", "step_height", "roughness", "clearance", "traversability", "ceiling"),
)
LAYERS = {**dict.fromkeys(FLOATS, np.float32), "hazard": np.uint16, "age": np.uint8, "looks": np.uint8}


@pytest.fixture(scope="module")
def processed(data: Path, calibration_file: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """OUT.npz of the paper scan, as written by the command."""
    from guara_perception.app.main import run

    out = tmp_path_factory.mktemp("processed") / "out.npz"
    assert run(["process", str(data / "scans" / "paper"), "-c", str(calibration_file), "-o", str(out)]) == 0
    return out


@pytest.mark.slow
def test_says_what_it_made(guara, data: Path, calibration_file: Path, tmp_path: Path):
    """One line on standard output: file, step, known fraction, and causes of the unknown cells."""
    out = tmp_path / "out.npz"
    said = guara("process", data / "scans" / "paper", "-c", calibration_file, "-o", out)
    assert said.code == 0 and said.err == ""
    assert said.out.startswith(f"{out}: step 0, coarse, 90x108 cells of 5 mm, known ") and said.out.count("\n") == 1
    assert list(tmp_path.iterdir()) == [out]


@pytest.mark.slow
def test_file_holds_every_promised_name(processed: Path, paper_scan: gp.Scan):
    """Names, types and shapes are those of docs/files.md, and NumPy reads the file without pickles."""
    with np.load(processed, allow_pickle=False) as content:
        assert set(content.files) == {
            *LAYERS, "origin", "resolution", "frame", "stamp", "step", "metadata", "ortho_image_mm", "range_image_mm"
        }  # fmt: skip
        for name, dtype in LAYERS.items():
            assert content[name].dtype == dtype and content[name].shape == (108, 90), name
        for name in ("ortho_image_mm", "range_image_mm"):
            assert content[name].dtype == np.float32 and content[name].shape == (512, 640)
        assert content["origin"].shape == (2,) and content["origin"].tolist() == [0.50, -0.27]
        assert content["resolution"] == 0.005 and content["resolution"].shape == ()
        assert str(content["frame"]) == "base_footprint"
        assert content["stamp"].dtype == np.int64 and content["stamp"] == paper_scan.stamp
        assert content["step"].dtype == np.int64 and content["step"] == paper_scan.step
        assert json.loads(str(content["metadata"]))["mode"] == "coarse"


@pytest.mark.slow
def test_file_is_the_grid_that_python_makes(processed: Path, paper_terrain: gp.TerrainGrid):
    """The command and `gp.process_scan` give the same bytes, and `gp.load_terrain` reads them back."""
    loaded = gp.load_terrain(processed)
    for name, layer in paper_terrain.layers.items():
        assert loaded.layer(name).tobytes() == layer.tobytes(), name
    for name, picture in paper_terrain.pictures.items():
        assert loaded.pictures[name].tobytes() == picture.tobytes(), name
    assert {k: v for k, v in loaded.metadata.items() if k not in ("seconds", "calibration_hash")} == {
        k: v for k, v in paper_terrain.metadata.items() if k not in ("seconds", "calibration_hash")
    }


@pytest.mark.slow
def test_file_keeps_the_safety_invariant(processed: Path):
    """Read with NumPy alone: NaN agrees with the unknown flags, and traversable cells have no flag."""
    with np.load(processed) as content:
        unknown = (content["hazard"] & UNKNOWN_MASK) != 0
        np.testing.assert_array_equal(np.isnan(content["elevation"]), unknown)
        np.testing.assert_array_equal(content["hazard"] == 0, content["traversability"] > 0)


def truth_under_pictures(data: Path) -> tuple[np.ndarray, np.ndarray]:
    """True heights [mm] below the pixel centres of the range images, and a mask of flat, visible ground."""
    with np.load(data / "scans" / "paper" / "truth.npz") as truth:
        elevation, seen = truth["elevation"] * 1e3, truth["visible"] & truth["lit"] & ~truth["dark"]
    x = 0.50 + (np.arange(512) + 0.5) * 0.45 / 512
    y = -0.27 + (np.arange(640) + 0.5) * 0.54 / 640
    columns = np.minimum(((x - 0.50) * 1e3).astype(int), elevation.shape[1] - 1)
    rows = np.minimum(((y + 0.27) * 1e3).astype(int), elevation.shape[0] - 1)
    kernel = np.ones((21, 21), np.uint8)
    flat = (cv2.dilate(elevation, kernel) - cv2.erode(elevation, kernel)) < 0.5
    good = flat & (cv2.erode(seen.astype(np.uint8), kernel) > 0)
    return elevation[rows[None, :], columns[:, None]], good[rows[None, :], columns[:, None]]


def test_orthorectified_picture_lies_where_its_mapping_says(processed: Path, data: Path):
    """Pixel (r, c): x = 0.50 + (r + 0.5) 0.45/512, y = -0.27 + (c + 0.5) 0.54/640; flat ground there has its height."""
    height, flat = truth_under_pictures(data)
    with np.load(processed) as content:
        picture = content["ortho_image_mm"]
    known = np.isfinite(picture) & flat
    assert known.sum() > 0.5 * flat.sum() and np.unique(np.round(height[known], -1)).size >= 4
    assert np.percentile(np.abs(picture - height)[known], 99) < 1.0
    # A flip or transposition would put the boxes in the wrong place.
    for wrong in (picture[::-1], picture[:, ::-1], picture[::-1, ::-1]):
        both = np.isfinite(wrong) & flat
        assert np.percentile(np.abs(wrong - height)[both], 99) > 5.0


def test_perspective_picture_leans_away_from_the_camera(processed: Path, data: Path, paper_scan: gp.Scan):
    """On the floor, both range images agree; the perspective one shows a box top where its ray meets the floor."""
    height, flat = truth_under_pictures(data)
    with np.load(processed) as content:
        ortho, perspective = content["ortho_image_mm"], content["range_image_mm"]
    floor = flat & (np.abs(height) < 0.2) & np.isfinite(perspective) & np.isfinite(ortho)
    same = np.abs(perspective - height)[floor]
    assert np.percentile(same, 75) < 0.5
    top = np.isfinite(ortho) & flat & (height > 60)
    mean_x = {}
    for name, picture in (("ortho", ortho), ("perspective", perspective)):
        rows = np.nonzero(np.isfinite(picture) & (picture > 60))[0]
        mean_x[name] = 0.50 + (rows.mean() + 0.5) * 0.45 / 512
    assert top.any()
    # By eqs. 20, 21: x' - nadir = (x - nadir) H / (H - z), with the camera at x = 0.40, H = 0.50.
    z = float(ortho[top].mean()) * 1e-3
    expected = 0.40 + (mean_x["ortho"] - 0.40) * 0.50 / (0.50 - z)
    assert mean_x["perspective"] == pytest.approx(expected, abs=0.01)


@pytest.mark.slow
@pytest.mark.parametrize(("resolution", "shape"), [("0.01", (54, 45)), ("0.015", (36, 30))])
def test_resolution_is_taken(guara, data: Path, calibration_file: Path, tmp_path: Path, resolution, shape):
    """A different cell size that divides the area."""
    out = tmp_path / "out.npz"
    command = ["process", data / "scans" / "tilt", "-c", calibration_file, "-o", out, "--resolution", resolution]
    assert guara(*command).code == 0
    assert gp.load_terrain(out).shape == shape


@pytest.mark.slow
def test_keep_going_leaves_a_bad_frame_unknown(guara, paper_copy: Path, calibration_file: Path, tmp_path: Path):
    """With --keep-going, the stripe of a frame of another size is unknown, and the line names stripe and reason."""
    path = paper_copy / "on_010.jpg"
    cv2.imwrite(str(path), cv2.imread(str(path))[::2, ::2])
    said = guara("process", paper_copy, "-c", calibration_file, "-o", tmp_path / "out.npz", "--keep-going")
    assert said.code == 0 and "stripe 20: the frame is 320x256 px" in said.out
    assert list(gp.load_terrain(tmp_path / "out.npz").metadata["frames_bad"]) == ["20"]


@pytest.mark.slow
def test_keep_going_goes_on_without_a_missing_frame(guara, paper_copy: Path, calibration_file: Path, tmp_path: Path):
    """The ground of its stripe is unknown although it was fired; without the option, the scan is refused."""
    arguments = ["process", paper_copy, "-c", calibration_file, "-o", tmp_path / "out.npz"]
    assert guara(*arguments).code == 0
    whole = gp.load_terrain(tmp_path / "out.npz")
    (paper_copy / "on_010.jpg").unlink()
    refused = guara(*arguments)
    assert refused.code == 2 and "stripe index 20 names frame on_010.jpg, which does not exist" in refused.err
    said = guara(*arguments, "--keep-going")
    assert said.code == 0 and "on_010.jpg" in said.out
    terrain = gp.load_terrain(tmp_path / "out.npz")
    assert list(terrain.metadata["frames_bad"]) == ["20"]
    assert not (terrain.hazard[whole.hazard != 0] == 0).any() and (terrain.hazard == 0).any()


@pytest.mark.slow
def test_keep_going_leaves_an_unreadable_frame_unknown(guara, paper_copy: Path, calibration_file: Path, tmp_path: Path):
    """With --keep-going, a truncated frame file makes its stripe unknown; without, the file is named in an error."""
    name = "on_010.jpg"
    (paper_copy / name).write_bytes((paper_copy / name).read_bytes()[:30])
    arguments = ["process", paper_copy, "-c", calibration_file, "-o", tmp_path / "out.npz"]
    refused = guara(*arguments)
    assert refused.code == 2 and f"{name}: not a readable picture (30 bytes)" in refused.err
    said = guara(*arguments, "--keep-going")
    assert said.code == 0 and f"{name}: not a readable picture" in said.out
    terrain = gp.load_terrain(tmp_path / "out.npz")
    assert list(terrain.metadata["frames_bad"]) == ["20"] and terrain.metadata["stripes_used"] > 30


@pytest.mark.slow
def test_two_methods_give_two_files(guara, data: Path, calibration_file: Path, tmp_path: Path):
    """The first method is written to OUT, the second beside it; each line names its file."""
    out = tmp_path / "out.npz"
    said = guara("process", data / "scans" / "paper", "-c", calibration_file, "-o", out, "--method", "precise,paper")
    assert said.code == 0
    assert [line.split(":")[0] for line in said.out.splitlines()] == [str(out), str(tmp_path / "out-paper.npz")]
    assert gp.load_terrain(out).metadata["method"] == "precise"
    assert gp.load_terrain(tmp_path / "out-paper.npz").metadata["method"] == "paper"


@pytest.mark.slow
def test_old_file_survives_a_failure(guara, paper_copy: Path, calibration_file: Path, tmp_path: Path):
    """A failing run does not touch an earlier result."""
    out = tmp_path / "out.npz"
    assert guara("process", paper_copy, "-c", calibration_file, "-o", out).code == 0
    before = out.read_bytes()
    (paper_copy / "on_034.jpg").write_bytes(b"")
    assert guara("process", paper_copy, "-c", calibration_file, "-o", out).code == 2
    assert out.read_bytes() == before and zipfile.is_zipfile(out)
