"""`guara process` refuses every kind of bad input before anything is written."""

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import pytest

Change = Callable[[Path], object]


def scan_json(change: Callable[[dict], object]) -> Change:
    """Edit the scan.json of a copied scan."""

    def apply(folder: Path) -> None:
        content = json.loads((folder / "scan.json").read_text())
        change(content)
        (folder / "scan.json").write_text(json.dumps(content))

    return apply


def resize_all(folder: Path) -> None:
    """Shrink every frame to half its size."""
    for path in folder.glob("*.jpg"):
        cv2.imwrite(str(path), cv2.imread(str(path))[::2, ::2])


def rename_joint(content: dict) -> None:
    """Rename a joint to a name that the robot does not have."""
    joints = content["stance"]["joint_positions"]
    joints["lf_hap_joint"] = joints.pop("lf_haa_joint")


BAD_SCANS: dict[str, tuple[Change, str]] = {
    "no scan.json": (lambda f: (f / "scan.json").unlink(), "contains no scan.json, so it is not a scan"),
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
        "stance.joint_positions.lf_haa_joint is nan; it must be finite",
    ),
    "NaN in gravity": (
        scan_json(lambda c: c["stance"].update(gravity_in_base=[0, float("nan"), -1])),
        "stance.gravity_in_base[1] is nan; it must be finite",
    ),
    "unknown robot": (scan_json(lambda c: c.update(robot="tapir")), "scan.json: robot: no robot 'tapir'"),
    "frame gone": (lambda f: (f / "on_003.jpg").unlink(), "names frame on_003.jpg, which does not exist"),
    "broken frame": (lambda f: (f / "on_003.jpg").write_bytes(b"x"), "on_003.jpg: not a readable picture (1 bytes)"),
    "wrong image size": (resize_all, "frame on_000.jpg: the frame is 320x256 px, the calibration is for 640x512 px"),
    "stripe not calibrated": (
        scan_json(lambda c: (c.update(mode="standard"), c["stripes"][1].update(index=1))),
        "stripe index 1 is not in the calibration, which holds 0, 2 ... 68: scan and calibration differ in rangefinder",
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
    """Exit 2 with one line that names file and field; no output file and no temporary file is left."""
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
    "another robot": (lambda c: c.update(robot="tapir"), "belongs to robot 'tapir', not 'guara'"),
    "another camera": (lambda c: c["camera"].update(size=[1280, 1024]), "the calibration is for 1280x1024 px"),
}


@pytest.mark.parametrize(("change", "reported"), BAD_CALIBRATIONS.values(), ids=BAD_CALIBRATIONS)
def test_bad_calibration_is_refused(guara, data: Path, calibration_file: Path, tmp_path: Path, change, reported: str):
    """The calibration is checked like the scan, and must belong to it."""
    content = json.loads(calibration_file.read_text())
    change(content)
    bad = tmp_path / "bad.json"
    bad.write_text(json.dumps(content))
    said = guara("process", data / "scans" / "paper", "-c", bad, "-o", tmp_path / "out.npz")
    assert said.code == 2 and said.out == "" and reported in said.err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bad.json"]


def bad_options(data: Path, calibration: Path, folder: Path) -> dict[str, tuple[list[object], str]]:
    """Command lines with an invalid option each."""
    scan, out = data / "scans" / "paper", folder / "out.npz"
    return {
        "scan not there": ([folder / "no", "-c", calibration, "-o", out], "no: no such scan"),
        "calibration not there": ([scan, "-c", folder / "no.json", "-o", out], "no.json: no such file"),
        "calibration a folder": ([scan, "-c", folder, "-o", out], "is a folder; give the file in it"),
        "out of another kind": ([scan, "-c", calibration, "-o", folder / "out.txt"], "out.txt: it must end in .npz"),
        "out in no folder": (
            [scan, "-c", calibration, "-o", folder / "no" / "out.npz"],
            "no does not exist; create it",
        ),
        "method unknown": (
            [scan, "-c", calibration, "-o", out, "--method", "precise,exact"],
            "'exact'; allowed: precise",
        ),
        "method empty": ([scan, "-c", calibration, "-o", out, "--method", ""], "--method is ''; allowed: precise"),
        "resolution": (
            [scan, "-c", calibration, "-o", out, "--resolution", "0.007"],
            "0.007 m does not divide the area",
        ),
        "resolution zero": ([scan, "-c", calibration, "-o", out, "--resolution", "0"], "resolution is 0.0; it must be"),
        "resolution NaN": (
            [scan, "-c", calibration, "-o", out, "--resolution", "nan"],
            "resolution is nan; it must be",
        ),
        "figures a file": (
            [scan, "-c", calibration, "-o", out, "--figures", calibration],
            "is a file; a folder is needed",
        ),
        "robot unknown": ([scan, "-c", calibration, "-o", out, "--robot", "tapir"], "no robot 'tapir'"),
    }


@pytest.mark.parametrize("case", bad_options(Path(), Path(), Path()))
def test_bad_option_is_refused(guara, data: Path, calibration_file: Path, tmp_path: Path, case: str):
    """Options are checked before any work; nothing is written."""
    arguments, reported = bad_options(data, calibration_file, tmp_path)[case]
    said = guara("process", *arguments)
    assert said.code == 2 and said.out == "" and reported in said.err and said.err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_scan_without_a_readable_frame_is_refused(guara, paper_copy: Path, calibration_file: Path, tmp_path: Path):
    """Without any readable frame, --keep-going fails too and names the first frame."""
    for path in paper_copy.glob("on_*.jpg"):
        path.write_bytes(b"")
    arguments = ["process", paper_copy, "-c", calibration_file, "-o", tmp_path / "out.npz", "--keep-going"]
    said = guara(*arguments)
    assert said.code == 2 and "on_000.jpg: not a readable picture (0 bytes)" in said.err
