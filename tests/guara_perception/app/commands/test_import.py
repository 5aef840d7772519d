"""`guara import`: scans and sessions from pictures of many formats with irregular names; every misfit is named."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

import guara_perception as gp
from guara_perception.app.files.calibration_session import open_session
from guara_perception.app.record.plate_scan import nominal_order
from kinematics import RobotModel


def noise(seed: int, size: tuple[int, int] = (48, 64), dtype: type = np.uint8) -> np.ndarray:
    """Random picture, different at each call."""
    return np.random.default_rng(seed).integers(0, np.iinfo(dtype).max, size, dtype=dtype)


def write(folder: Path, names: list[str], **of: object) -> list[Path]:
    """Write a different picture under each name."""
    for seed, name in enumerate(names):
        assert cv2.imwrite(str(folder / name), noise(seed, **of))  # type: ignore[arg-type]
    return [folder / name for name in names]


@pytest.mark.parametrize("suffix", ["bmp", "tiff", "pgm", "png"])
def test_odd_names_become_a_scan(guara, tmp_path: Path, robot: RobotModel, suffix: str):
    """Numbers without leading zeros, words in the names and one dark picture give a coarse scan with the angles of
    robot.toml.
    """
    names = [f"Foto on n° {n} (2).{suffix}" for n in range(35)]
    dtype = np.uint8 if suffix == "bmp" else np.uint16
    files = write(tmp_path, [*names, f"DARK.{suffix}"], dtype=dtype)
    said = guara("import", *reversed(files), "-o", tmp_path / "scan", "--number", "1")
    assert said.code == 0, said.err
    assert "stripe  22   +1.6" in said.out and f"Foto on n° 11 (2).{suffix}, without the laser: DARK" in said.out
    scan = gp.open_scan(tmp_path / "scan")
    assert (scan.mode, scan.robot) == ("coarse", "guara")
    assert [(s.index, s.mirror_angle) for s in scan.stripes] == nominal_order(robot, "coarse")
    assert scan.stance.joint_positions == robot.posture(robot.config.scan_posture)
    for seed, (_, on, off) in enumerate(scan.frames()):
        assert np.array_equal(on, noise(seed, dtype=dtype)) and np.array_equal(off, noise(35, dtype=dtype))


def test_pairs_and_joints(guara, tmp_path: Path, robot: RobotModel):
    """Each stripe has its own dark picture, some stripes are missing, and the joints come from a CSV file."""
    (tmp_path / "p").mkdir()
    numbers = [n for n in range(70) if n != 13]
    write(tmp_path / "p", [f"{n:02d}_{word}.png" for n in numbers for word in ("laser", "background")])
    posture = robot.posture(robot.config.scan_posture)
    table = "joint,angle\n" + "".join(f"{name}, {angle + 0.01}\n" for name, angle in posture.items())
    (tmp_path / "joints.csv").write_text(table)
    more = ["-o", tmp_path / "scan", "--joints", tmp_path / "joints.csv"]
    refused = guara("import", tmp_path / "p", *more)
    assert refused.code == 2 and "69 laser-on pictures; numbers missing: 13; allowed: 35 (coarse) or 70" in refused.err
    assert guara("import", tmp_path / "p", *more, "--indices", "--preview").code == 0
    assert not (tmp_path / "scan").exists()
    assert guara("import", tmp_path / "p", *more, "--indices").code == 0
    scan = gp.open_scan(tmp_path / "scan")
    assert [stripe.index for stripe in scan.stripes] == numbers and scan.mode == "standard"
    assert scan.stance.joint_positions == {name: angle + 0.01 for name, angle in posture.items()}
    _, on, off = list(scan.frames())[20]
    assert np.array_equal(on, noise(40)) and np.array_equal(off, noise(41))


def test_what_is_not_given_is_asked(guara, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """On a terminal, kind and posture are asked for, and confirmation after the preview."""
    write(tmp_path, [f"{n}.png" for n in range(35)])
    asked: list[str] = []

    def prompt(question: str, default: str, err: bool) -> str:
        asked.append(question)
        return "standing" if "posture" in question else default

    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    monkeypatch.setattr("click.prompt", prompt)
    answers = iter([False, True])
    monkeypatch.setattr("click.confirm", lambda question, default, err: next(answers))
    pictures = sorted(tmp_path.glob("*.png"))
    assert guara("import", *pictures, "-o", tmp_path / "scan").code != 0
    assert not (tmp_path / "scan").exists()
    assert guara("import", *pictures, "-o", tmp_path / "scan").code == 0
    assert asked[:2] == ["what to create, scan or session", "posture in which the robot stood"]
    robot = gp.load_robot("guara")
    assert gp.open_scan(tmp_path / "scan").stance.joint_positions == robot.posture("standing")


def test_a_session(guara, data: Path, tmp_path: Path, robot: RobotModel):
    """The recorded session under other names and formats is imported and calibrates as it did."""
    source, pictures = data / "calibration", tmp_path / "pictures"
    pictures.mkdir()
    content = json.loads((source / "session.json").read_text())
    for number, name in enumerate([*content["board_images"], "fiducials.jpg"]):
        cv2.imwrite(str(pictures / f"IMG {number}.tif"), cv2.imread(str(source / name), cv2.IMREAD_UNCHANGED))
    (tmp_path / "crosses.json").write_text(json.dumps(content["fiducials"]))
    plates = [f"{plate['height']}={source / plate['scan']}" for plate in content["plates"]]
    options = ["--ground", "IMG 0.tif", "--crosses-picture", "IMG 14.tif", "--crosses", tmp_path / "crosses.json"]
    options += [part for plate in plates for part in ("--plate", plate)]
    said = guara("import", pictures, "-o", tmp_path / "session", *options)
    assert said.code == 0, said.err
    assert "board on the floor: IMG 0.tif\ncrosses: IMG 14.tif\nplate of 0 mm: " in said.out
    session = open_session(tmp_path / "session")
    assert len(session.board_images) == 14 and [plate.height for plate in session.plates] == [0.0, 0.04, 0.08]
    wrong = guara("import", pictures, "-o", tmp_path / "other", *options[:-1], f"0.08={tmp_path / 'none'}")
    assert wrong.code == 2 and "none: no such folder; `guara import` makes it from pictures" in wrong.err
    moved = guara("import", pictures, "-o", tmp_path / "other", *options, "--posture", "standing")
    assert moved.code == 2 and "degrees away from the session's stance" in moved.err and ".other-" not in moved.err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["crosses.json", "pictures", "session"]


def duplicate(folder: Path) -> list[str]:
    """Give two pictures the same number."""
    write(folder, ["a_1.png", "b_1.png", "a_2.png"])
    return []


def two_orders(folder: Path) -> list[str]:
    """Give the pictures two numbers that imply different orders."""
    write(folder, ["1_9.png", "2_8.png", "3_7.png"])
    return []


def odd_name(folder: Path) -> list[str]:
    """Give one picture an irregular name."""
    write(folder, ["1.png", "2.png", "extra.png"])
    return []


def unnumbered(folder: Path) -> list[str]:
    """Remove all numbers from the names."""
    write(folder, ["a.png", "b.png"])
    return []


def alone(folder: Path) -> list[str]:
    """Leave a laser-on and a laser-off picture without a partner."""
    write(folder, ["on_1.png", "off_1.png", "on_2.png", "off_3.png"])
    return []


def sizes(folder: Path) -> list[str]:
    """Change the size of one picture."""
    write(folder, ["0.png", "1.png"])
    write(folder, ["2.png"], size=(60, 80))
    return []


def dark_only(folder: Path) -> list[str]:
    """Keep only laser-off pictures."""
    write(folder, ["off_1.png", "off_2.png"])
    return []


def broken(folder: Path) -> list[str]:
    """Replace a picture by a file that is not one."""
    (folder / "1.png").write_bytes(b"x")
    return []


def with_options(*options: str) -> Callable[[Path], list[str]]:
    """Pictures of a coarse scan, and these options."""

    def make(folder: Path) -> list[str]:
        write(folder, [f"{n}.png" for n in range(35)])
        (folder / "degrees.csv").write_text("lf_haa_joint,30\n")
        (folder / "text.csv").write_text("joint,angle\nlf_haa_joint,straight\n")
        (folder / "few.csv").write_text("lf_haa_joint,0.1\n")
        return [option.replace("{}", str(folder)) for option in options]

    return make


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (duplicate, "the order of the pictures is not clear: these repeat the number of another: a_1.png"),
        (two_orders, "numbers 1, 2 of names such as 1_9.png give different orders: give --number, 1 for the first"),
        (
            odd_name,
            "the order of the pictures is not clear: names without 1 numbers, unlike the others: extra.png",
        ),
        (unnumbered, "the order of the pictures is not clear: names without a number: a.png, b.png"),
        (alone, "pictures without a partner: off_3.png, on_2.png"),
        (sizes, "pictures of different sizes: 2.png 80x60 px, the others 64x48"),
        (dark_only, "the names mark all 2 pictures as laser-off: give --off PATTERN"),
        (broken, "1.png: not a readable picture (1 bytes); it must be PNG, JPEG, BMP, TIFF or PGM"),
        (lambda folder: [], "contains no picture"),
        (with_options("{}/0.png"), "pictures given twice: 0.png"),
        (with_options("{}/none.png"), "none.png: no such picture"),
        (with_options("--mode", "standard"), "35 laser-on pictures; allowed: 70 (standard) of robot guara"),
        (with_options("--indices", "--mode", "coarse"), "--indices: 1.png, 11.png"),
        (with_options("--off", "{}/dark_*"), "matches no picture; allowed: a pattern of names, such as 'dark_*'"),
        (with_options("--number", "2"), "--number is 2; allowed: 1 ... 1 or -1 ... -1"),
        (with_options("--posture", "sitting"), "unknown posture 'sitting'"),
        (with_options("--posture", "scan", "--joints", "{}/few.csv"), "--posture and --joints are given: give one"),
        (with_options("--joints", "{}/none.csv"), "none.csv: no such file"),
        (with_options("--joints", "{}/degrees.csv"), "lf_haa_joint is 30; allowed: -6.28 ... 6.28 rad; give radians"),
        (with_options("--joints", "{}/text.csv"), "line 2 is 'lf_haa_joint,straight'; allowed: joint, angle"),
        (with_options("--joints", "{}/few.csv"), "few.csv: "),
        (with_options("-c", "{}/none.json"), "none.json"),
        (with_options("--kind", "scan", "--ground", "0.png"), "are for a session: leave --kind out"),
        (with_options("--kind", "session"), "--ground is missing; allowed: the name of one of the 35 pictures"),
        (with_options("--ground", "x.png"), "--ground is 'x.png', which is none of the pictures"),
        (
            with_options("--ground", "0.png", "--crosses-picture", "0.png"),
            "another one of the board on the floor, and one of the crosses",
        ),
        (
            with_options("--ground", "0.png", "--crosses-picture", "1.png"),
            "list of --plate heights is ''; it must be heights in metres",
        ),
    ],
)
def test_what_does_not_fit_is_named(guara, tmp_path: Path, make: Callable[[Path], list[str]], reason: str):
    """Exit 2 with one line; nothing is written."""
    (tmp_path / "p").mkdir()
    options = make(tmp_path / "p")
    said = guara("import", tmp_path / "p", "-o", tmp_path / "out", *options)
    assert said.code == 2 and reason in said.err and said.err.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["p"]


def test_a_target_that_is_there(guara, tmp_path: Path):
    """An existing target is not overwritten."""
    write(tmp_path, ["1.png"])
    said = guara("import", tmp_path / "1.png", "-o", tmp_path)
    assert said.code == 2 and "exists; give another name" in said.err
    said = guara("import", tmp_path / "1.png", "-o", tmp_path / "a" / "b")
    assert said.code == 2 and "its folder does not exist" in said.err
