"""`guara process`: the file it writes, and every kind of bad input, refused before anything is written."""

import json
import zipfile
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

import guara_perception as gp
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK

FLOATS = "elevation variance elevation_min elevation_max slope step_height roughness clearance traversability".split()
LAYERS = {**dict.fromkeys(FLOATS, np.float32), "hazard": np.uint16, "age": np.uint8, "looks": np.uint8}


@pytest.fixture(scope="module")
def processed(data: Path, calibration_file: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """OUT.npz of the paper scan, made by the command."""
    from guara_perception.app.main import run

    out = tmp_path_factory.mktemp("processed") / "out.npz"
    assert run(["process", str(data / "scans" / "paper"), "-c", str(calibration_file), "-o", str(out)]) == 0
    return out


@pytest.mark.slow
def test_says_what_it_made(guara, data: Path, calibration_file: Path, tmp_path: Path):
    """One line on standard output: the file, the step, what is known and why the rest is not."""
    out = tmp_path / "out.npz"
    said = guara("process", data / "scans" / "paper", "-c", calibration_file, "-o", out)
    assert said.code == 0 and said.err == ""
    assert said.out.startswith(f"{out}: step 0, coarse, 90x108 cells of 5 mm, known ") and said.out.count("\n") == 1
    assert list(tmp_path.iterdir()) == [out]


@pytest.mark.slow
def test_file_holds_every_promised_name(processed: Path, paper_scan: gp.Scan):
    """Names, types and shapes of docs/files.md, readable by NumPy alone without pickles."""
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


def test_file_keeps_the_safety_invariant(processed: Path):
    """Read with NumPy alone: NaN and unknown flags agree, and traversable means without any flag."""
    with np.load(processed) as content:
        unknown = (content["hazard"] & UNKNOWN_MASK) != 0
        np.testing.assert_array_equal(np.isnan(content["elevation"]), unknown)
        np.testing.assert_array_equal(content["hazard"] == 0, content["traversability"] > 0)


def truth_under_pictures(data: Path) -> tuple[np.ndarray, np.ndarray]:
    """True heights [mm] under the centres of the pictures' pixels, and whether ground is flat and seen there."""
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
    # Any flip or transposition puts boxes on the wrong ground.
    for wrong in (picture[::-1], picture[:, ::-1], picture[::-1, ::-1]):
        both = np.isfinite(wrong) & flat
        assert np.percentile(np.abs(wrong - height)[both], 99) > 5.0


def test_perspective_picture_leans_away_from_the_camera(processed: Path, data: Path, paper_scan: gp.Scan):
    """On the floor both pictures agree; a box top stands in the perspective one where its ray meets the floor."""
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
    """Another cell size that divides the area."""
    out = tmp_path / "out.npz"
    command = ["process", data / "scans" / "tilt", "-c", calibration_file, "-o", out, "--resolution", resolution]
    assert guara(*command).code == 0
    assert gp.load_terrain(out).shape == shape


Change = Callable[[Path], object]


def scan_json(change: Callable[[dict], object]) -> Change:
    """A change of the scan.json of a copied scan."""

    def apply(folder: Path) -> None:
        content = json.loads((folder / "scan.json").read_text())
        change(content)
        (folder / "scan.json").write_text(json.dumps(content))

    return apply


def resize_all(folder: Path) -> None:
    """Every frame at half its size."""
    for path in folder.glob("*.jpg"):
        cv2.imwrite(str(path), cv2.imread(str(path))[::2, ::2])


def rename_joint(content: dict) -> None:
    """A joint under a name that the robot does not know."""
    joints = content["stance"]["joint_positions"]
    joints["lf_hap_joint"] = joints.pop("lf_haa_joint")


BAD_SCANS: dict[str, tuple[Change, str]] = {
    "no scan.json": (lambda f: (f / "scan.json").unlink(), "scan.json: no such file"),
    "broken scan.json": (lambda f: (f / "scan.json").write_text("{"), "scan.json: not a JSON file"),
    "wrong format tag": (scan_json(lambda c: c.update(format="x/1")), "format is 'x/1', allowed: 'guara-scan/1'"),
    "unknown joint": (scan_json(rename_joint), "stance: unknown joint 'lf_hap_joint'; this robot has: lf_haa_joint"),
    "joint missing": (
        scan_json(lambda c: c["stance"]["joint_positions"].pop("rh_kfe_joint")),
        "stance: no position for rh_kfe_joint",
    ),
    "unknown leg": (
        scan_json(lambda c: c["stance"].update(support_feet=["lf", "rf", "left"])),
        "stance: unknown leg 'left'; this robot has: lf, rf, lh, rh",
    ),
    "NaN in a joint": (
        scan_json(lambda c: c["stance"]["joint_positions"].update(lf_haa_joint=float("nan"))),
        "stance.joint_positions.lf_haa_joint is nan, it must be finite",
    ),
    "NaN in gravity": (
        scan_json(lambda c: c["stance"].update(gravity_in_base=[0, float("nan"), -1])),
        "stance.gravity_in_base[1] is nan, it must be finite",
    ),
    "unknown robot": (scan_json(lambda c: c.update(robot="tapir")), "scan.json: robot: no robot 'tapir'"),
    "frame gone": (lambda f: (f / "on_003.jpg").unlink(), "names frame on_003.jpg, it is not there"),
    "broken frame": (lambda f: (f / "on_003.jpg").write_bytes(b"x"), "on_003.jpg: not a readable picture (1 bytes)"),
    "wrong image size": (resize_all, "frame on_000.jpg: the frame is 320x256 px, the calibrated camera gives 640x512"),
    "stripe not calibrated": (
        scan_json(lambda c: (c.update(mode="standard"), c["stripes"][1].update(index=1))),
        "stripe index 1 is not in the calibration, which holds 0, 2 ... 68",
    ),
    "stripe out of pattern": (
        scan_json(lambda c: c["stripes"][1].update(index=3)),
        "stripe index 3 is not in the coarse pattern of guara: 0, 2 ... 68",
    ),
}


@pytest.mark.parametrize(("change", "reported"), BAD_SCANS.values(), ids=BAD_SCANS)
def test_bad_scan_is_refused(
    guara, paper_copy: Path, calibration_file: Path, tmp_path: Path, change: Change, reported: str
):
    """Exit 2, one line that names file and field; no output file, whole or half, nor one beside it."""
    change(paper_copy)
    folder = tmp_path / "results"
    folder.mkdir()
    said = guara("process", paper_copy, "-c", calibration_file, "-o", folder / "out.npz")
    assert said.code == 2 and said.out == ""
    assert reported in said.err and said.err.startswith(f"guara: {paper_copy}") and said.err.count("\n") == 1
    assert list(folder.iterdir()) == []


BAD_CALIBRATIONS: dict[str, tuple[Callable[[dict], object], str]] = {
    "wrong format tag": (
        lambda c: c.update(format="guara-scan/1"),
        "format is 'guara-scan/1', allowed: 'guara-calibration/1'",
    ),
    "NaN in a plane": (lambda c: c["stripes"][5]["plane"].__setitem__(0, float("nan")), "stripes[5].plane[0] is nan"),
    "another robot": (lambda c: c.update(robot="tapir"), "belongs to robot 'tapir', the robot is 'guara'"),
    "another camera": (lambda c: c["camera"].update(size=[1280, 1024]), "the calibrated camera gives 1280x1024"),
}


@pytest.mark.parametrize(("change", "reported"), BAD_CALIBRATIONS.values(), ids=BAD_CALIBRATIONS)
def test_bad_calibration_is_refused(guara, data: Path, calibration_file: Path, tmp_path: Path, change, reported: str):
    """The calibration is checked as the scan is, and must be the scan's."""
    content = json.loads(calibration_file.read_text())
    change(content)
    bad = tmp_path / "bad.json"
    bad.write_text(json.dumps(content))
    said = guara("process", data / "scans" / "paper", "-c", bad, "-o", tmp_path / "out.npz")
    assert said.code == 2 and said.out == "" and reported in said.err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bad.json"]


def bad_options(data: Path, calibration: Path, folder: Path) -> dict[str, tuple[list[object], str]]:
    """Command lines that cannot be meant."""
    scan, out = data / "scans" / "paper", folder / "out.npz"
    return {
        "scan not there": ([folder / "no", "-c", calibration, "-o", out], "no: no such scan"),
        "calibration not there": ([scan, "-c", folder / "no.json", "-o", out], "no.json: no such file"),
        "calibration a folder": ([scan, "-c", folder, "-o", out], "is a folder; give the file in it"),
        "out of another kind": ([scan, "-c", calibration, "-o", folder / "out.txt"], "out.txt, it must end in .npz"),
        "out in no folder": (
            [scan, "-c", calibration, "-o", folder / "no" / "out.npz"],
            "no does not exist, create it",
        ),
        "method unknown": (
            [scan, "-c", calibration, "-o", out, "--method", "precise,exact"],
            "'exact', allowed: precise",
        ),
        "method empty": ([scan, "-c", calibration, "-o", out, "--method", ""], "--method holds '', allowed: precise"),
        "resolution": (
            [scan, "-c", calibration, "-o", out, "--resolution", "0.007"],
            "0.007 m does not divide the area",
        ),
        "resolution zero": ([scan, "-c", calibration, "-o", out, "--resolution", "0"], "resolution is 0.0, it must be"),
        "resolution NaN": (
            [scan, "-c", calibration, "-o", out, "--resolution", "nan"],
            "resolution is nan, it must be",
        ),
        "figures a file": (
            [scan, "-c", calibration, "-o", out, "--figures", calibration],
            "a file; the pictures need a",
        ),
        "robot unknown": ([scan, "-c", calibration, "-o", out, "--robot", "tapir"], "no robot 'tapir'"),
    }


@pytest.mark.parametrize("case", bad_options(Path(), Path(), Path()))
def test_bad_option_is_refused(guara, data: Path, calibration_file: Path, tmp_path: Path, case: str):
    """Options are checked before any work, and nothing is written."""
    words, reported = bad_options(data, calibration_file, tmp_path)[case]
    said = guara("process", *words)
    assert said.code == 2 and said.out == "" and reported in said.err and said.err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_keep_going_leaves_a_bad_frame_unknown(guara, paper_copy: Path, calibration_file: Path, tmp_path: Path):
    """With --keep-going a frame of another size costs its stripe, and the line says which and why."""
    path = paper_copy / "on_010.jpg"
    cv2.imwrite(str(path), cv2.imread(str(path))[::2, ::2])
    said = guara("process", paper_copy, "-c", calibration_file, "-o", tmp_path / "out.npz", "--keep-going")
    assert said.code == 0 and "stripe 20: the frame is 320x256 px" in said.out
    assert list(gp.load_terrain(tmp_path / "out.npz").metadata["frames_bad"]) == ["20"]


@pytest.mark.slow
def test_keep_going_leaves_an_unreadable_frame_unknown(guara, paper_copy: Path, calibration_file: Path, tmp_path: Path):
    """A frame file that was cut off costs its stripe with --keep-going, and is refused by name without."""
    name = "on_010.jpg"
    (paper_copy / name).write_bytes((paper_copy / name).read_bytes()[:30])
    words = ["process", paper_copy, "-c", calibration_file, "-o", tmp_path / "out.npz"]
    refused = guara(*words)
    assert refused.code == 2 and f"{name}: not a readable picture (30 bytes)" in refused.err
    said = guara(*words, "--keep-going")
    assert said.code == 0 and f"{name}: not a readable picture" in said.out
    terrain = gp.load_terrain(tmp_path / "out.npz")
    assert list(terrain.metadata["frames_bad"]) == ["20"] and terrain.metadata["stripes_used"] > 30


def test_scan_without_a_readable_frame_is_refused(guara, paper_copy: Path, calibration_file: Path, tmp_path: Path):
    """Going on with nothing makes no sense: the first frame is named."""
    for path in paper_copy.glob("on_*.jpg"):
        path.write_bytes(b"")
    words = ["process", paper_copy, "-c", calibration_file, "-o", tmp_path / "out.npz", "--keep-going"]
    said = guara(*words)
    assert said.code == 2 and "on_000.jpg: not a readable picture (0 bytes)" in said.err


@pytest.mark.slow
def test_two_methods_give_two_files(guara, data: Path, calibration_file: Path, tmp_path: Path):
    """The first method goes into OUT, the second beside it, each line saying which file it is about."""
    out = tmp_path / "out.npz"
    said = guara("process", data / "scans" / "paper", "-c", calibration_file, "-o", out, "--method", "precise,paper")
    assert said.code == 0
    assert [line.split(":")[0] for line in said.out.splitlines()] == [str(out), str(tmp_path / "out-paper.npz")]
    assert gp.load_terrain(out).metadata["method"] == "precise"
    assert gp.load_terrain(tmp_path / "out-paper.npz").metadata["method"] == "paper"


@pytest.mark.slow
def test_figures_are_drawn_into_a_folder(guara, data: Path, calibration_file: Path, tmp_path: Path):
    """`--figures` makes the folder and says how many files there are; each PNG is a readable picture."""
    folder = tmp_path / "new" / "pictures"
    scan = data / "scans" / "paper"
    said = guara("process", scan, "-c", calibration_file, "-o", tmp_path / "out.npz", "--figures", folder)
    assert said.code == 0 and said.out.splitlines()[-1].startswith(f"{folder}: {len(list(folder.iterdir()))} ")
    pictures = list(folder.glob("*.png"))
    assert len(pictures) >= 5
    for picture in pictures:
        assert min(cv2.imread(str(picture), cv2.IMREAD_UNCHANGED).shape[:2]) > 100


@pytest.mark.slow
def test_old_file_survives_a_failure(guara, paper_copy: Path, calibration_file: Path, tmp_path: Path):
    """A result from before is not touched by a run that fails half way."""
    out = tmp_path / "out.npz"
    assert guara("process", paper_copy, "-c", calibration_file, "-o", out).code == 0
    before = out.read_bytes()
    (paper_copy / "on_034.jpg").write_bytes(b"")
    assert guara("process", paper_copy, "-c", calibration_file, "-o", out).code == 2
    assert out.read_bytes() == before and zipfile.is_zipfile(out)
