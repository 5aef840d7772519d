"""The demo as a user runs it, and its own check, which must be able to fail."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import guara_perception as gp
from guara_perception.app.commands.demo import command as demo_command
from guara_perception.app.demo.check import CheckedFoothold, DemoCheck
from guara_perception.app.demo.walk import first_recorded
from guara_perception.app.files.open_scan import open_scans
from guara_perception.app.view_moments import load_moments
from testbed.altered_robot import altered_guara

PATIENCE = 240.0


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """One gait cycle of the demo in its own process: the folder, and the output."""
    folder = tmp_path_factory.mktemp("demo")
    done = subprocess.run(
        [sys.executable, "-m", "guara_perception.app.main", "demo", "--out", str(folder), "--cycles", "1"],
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return folder, done.stdout


@pytest.mark.heavy
def test_each_pause_is_reported_and_the_check_passes(demo: tuple[Path, str]) -> None:
    """Five pauses, each with mode, coverage and foothold; the planner received every grid."""
    lines = demo[1].splitlines()
    assert [line.split()[1] for line in lines if line.startswith("step")] == ["0", "1", "2", "3", "4"]
    assert "grids: 5 published, 5 received by the planner" in lines
    assert "unknown cells called traversable: 0" in lines
    assert "swings: 4 planned, 0 refused by check_path" in lines
    assert lines[-1] == "the demo's check passed"
    assert sum("on declared ground" in line for line in lines) >= 3


@pytest.mark.heavy
def test_pictures_and_recording_are_left(demo: tuple[Path, str]) -> None:
    """The picture files are images, and the recording contains every pause."""
    for name, magic in (("scan.png", b"\x89PNG"), ("map.png", b"\x89PNG"), ("walk.gif", b"GIF8")):
        assert (demo[0] / name).read_bytes()[:4] == magic
    assert {scan.step for scan in open_scans(demo[0] / "walk.mcap")} == {0, 1, 2, 3, 4}
    size = (demo[0] / "walk.mcap").stat().st_size / 1e6
    assert f"recording: {demo[0] / 'walk.mcap'}, {size:.0f} MB, every pause" in demo[1].splitlines()
    _, moments = load_moments(demo[0] / "walk.mcap", gp.load_robot("guara"))
    assert len(moments) == 5 and not any(grid.is_provisional for item in moments[:-1] for grid in item.grids.values())
    assert [first_recorded(cycles) for cycles in (1, 2, 2.5, 10, 12)] == [0, 1, 3, 33, 41]


@pytest.mark.heavy
def test_the_recording_of_the_whole_walk_is_small(tmp_path: Path) -> None:
    """The demo with default options writes less than 60 MB."""
    program = [sys.executable, "-m", "guara_perception.app.main", "demo", "--out", str(tmp_path)]
    done = subprocess.run(program, capture_output=True, text=True, timeout=3 * PATIENCE, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert ", the last 8 of 41 pauses" in done.stdout
    assert {scan.step for scan in open_scans(tmp_path / "walk.mcap")} == set(range(33, 41))
    assert sum(path.stat().st_size for path in tmp_path.iterdir()) < 60e6


@pytest.mark.heavy
def test_empty_ground_stays_coarse_and_a_box_is_refined(tmp_path: Path) -> None:
    """A floor with 2 mm undulation, and a 20 mm box that comes into view at the fourth pause."""
    (tmp_path / "floor.toml").write_text(
        "x = [-1.0, 3.0]\ny = [-1.0, 1.0]\nundulation = 0.002\n"
        "[[box]]\nx = 1.06\ny = 0.1\nsize = [0.08, 0.08]\nheight = 0.02\n"
    )
    program = [sys.executable, "-m", "guara_perception.app.main", "demo", "--world", str(tmp_path / "floor.toml")]
    done = subprocess.run(
        [*program, "--out", str(tmp_path / "out"), "--cycles", "1.25"],
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    modes = [line.split()[2:4] for line in done.stdout.splitlines() if line.startswith("step")]
    assert modes[:2] == [["coarse", "35"]] * 2 and modes[-2:] == [["standard", "70"]] * 2


@pytest.mark.heavy
def test_a_robot_outside_of_the_package_walks_too(tmp_path: Path) -> None:
    """`--robot FOLDER` with a folder made by `robot new`: its own legs and name, from the folder to the planner."""
    urdf = Path(__file__).parents[3] / "robots" / "tapir" / "urdf" / "tapir.urdf"
    program = [sys.executable, "-m", "guara_perception.app.main"]
    mine, out = tmp_path / "mine", tmp_path / "out"
    subprocess.run([*program, "robot", "new", str(urdf), "-o", str(mine)], capture_output=True, check=True, timeout=120)
    done = subprocess.run(
        [*program, "demo", "--robot", str(mine), "--out", str(out), "--cycles", "1"],
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=False,
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    said = done.stdout.splitlines()
    assert "grids: 5 published, 5 received by the planner" in said
    assert "swings: 4 planned, 0 refused by check_path" in said and said[-1] == "the demo's check passed"
    with gp.open_recording(out / "walk.mcap") as recording:
        grids = list(recording)
        assert {scan.robot for scan in recording.scans} == {"mine"}
    assert {grid.metadata["robot"] for grid in grids} == {"mine"}
    # The grid contains the robot's description, so a recording alone gives its legs.
    assert grids[0].check_foothold(0.7, 0.0, leg="lf").reasons is not None


@pytest.mark.heavy
def test_a_walk_in_the_sun_keeps_its_promises_however_slow_the_machine(tmp_path: Path) -> None:
    """`--world sunlit`, with pauses far longer than the robot's limit for a pause without END."""
    robot = altered_guara(tmp_path, ("time_limit = 30.0 ", "time_limit = 0.1 "))
    program = [sys.executable, "-m", "guara_perception.app.main", "demo", "--world", "sunlit", "--cycles", "1"]
    done = subprocess.run(
        [*program, "--robot", str(robot), "--out", str(tmp_path / "out")],
        capture_output=True,
        text=True,
        timeout=2 * PATIENCE,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    said = done.stdout.splitlines()
    assert "grids: 5 published, 5 received by the planner" in said
    assert "unknown cells called traversable: 0" in said
    assert said[-1] == "the demo's check passed"


@pytest.mark.heavy
def test_stepping_stones_are_crossed_and_a_film_is_left(tmp_path: Path) -> None:
    """`--course stones`: every foot ends beyond the stones, none on a hazard, also on a slow machine."""
    robot = altered_guara(tmp_path, ("\nseconds = 420.0 ", "\nseconds = 4200.0 "))
    program = [sys.executable, "-m", "guara_perception.app.main", "demo", "--course", "stones", "--robot", str(robot)]
    done = subprocess.run(
        [*program, "--out", str(tmp_path)], capture_output=True, text=True, timeout=8 * PATIENCE, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    said = done.stdout.splitlines()
    assert said[-1] == "the demo's check passed" and "unknown cells called traversable: 0" in said
    (feet,) = (text for text in said if text.startswith("footholds: "))
    assert feet.endswith("0 on a hazard")
    for name, magic in (("crossing.png", b"\x89PNG"), ("crossing.gif", b"GIF8")):
        assert (tmp_path / name).read_bytes()[:4] == magic
    assert not (tmp_path / "walk.mcap").exists()


@pytest.mark.heavy
def test_a_course_that_cannot_be_crossed_fails(tmp_path: Path) -> None:
    """The robot stops before a 0.6 m trench; the check names the place, and the animation is written."""
    course = tmp_path / "trench.toml"
    course.write_text("x = [-1.0, 3.0]\n[[pit]]\nx = 0.9\ny = 0.0\nsize = [0.6, 1.9]\ndepth = 0.12\n")
    program = [sys.executable, "-m", "guara_perception.app.main", "demo", "--course", str(course)]
    done = subprocess.run(
        [*program, "--out", str(tmp_path)], capture_output=True, text=True, timeout=5 * PATIENCE, check=False
    )
    assert done.returncode == 1, done.stdout + done.stderr
    assert "not across after " in done.stderr and "of 1.20 m" in done.stderr
    assert (tmp_path / "crossing.gif").read_bytes()[:4] == b"GIF8"


@pytest.mark.slow
def test_a_course_needs_features_and_a_file(tmp_path: Path) -> None:
    """Refused in one line before anything starts."""
    (tmp_path / "floor.toml").write_text("x = [-1.0, 3.0]\n")
    for course, said in ((tmp_path / "floor.toml", "has no features"), ("lava", "no such world file; worlds that")):
        program = [sys.executable, "-m", "guara_perception.app.main", "demo", "--course", str(course)]
        done = subprocess.run(
            [*program, "--out", str(tmp_path)], capture_output=True, text=True, timeout=PATIENCE, check=False
        )
        assert done.returncode == 2 and said in done.stderr and "Traceback" not in done.stderr


def foothold(**changes: object) -> CheckedFoothold:
    values = {"step": 1, "leg": "lh", "is_hind": True, "is_scanned": True, "is_hazard": False, "height_error": 0.0}
    values["is_swing_refused"] = False
    return CheckedFoothold(**{**values, **changes})  # type: ignore[arg-type]


def check(**changes: object) -> DemoCheck:
    made = DemoCheck(grids_published=41, grids_received=41)
    made.footholds = [foothold() for _ in range(8)]
    made.errors = [np.array([0.001, 0.002])]
    for name, value in changes.items():
        setattr(made, name, value)
    return made


def test_a_walk_as_promised_has_no_failures() -> None:
    """A walk that meets all conditions has no failures."""
    assert check().failures(41) == []


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"grids_published": 40, "grids_received": 40}, "40 of 41 pauses produced a grid"),
        ({"grids_received": 39}, "received 39 of 41"),
        ({"footholds": [foothold() for _ in range(7)]}, "7 hind footholds on scanned ground, at least 8 required"),
        ({"footholds": [foothold(is_scanned=False) for _ in range(9)]}, "0 hind footholds on scanned ground"),
        (
            {"footholds": [foothold()] * 8 + [foothold(is_hazard=True, step=5)]},
            "footholds on a hazard: 1, the first at step 5",
        ),
        (
            {"footholds": [foothold()] * 8 + [foothold(is_swing_refused=True, step=7)]},
            "swings refused by check_path: 1, the first at step 7",
        ),
        ({"unknown_called_safe": 3}, "unknown cells called traversable: 3"),
    ],
)
def test_each_broken_promise_is_a_failure(changes: dict[str, object], said: str) -> None:
    """The check can fail, and its message names the failed condition."""
    assert any(said in problem for problem in check(**changes).failures(41))


@pytest.mark.parametrize(
    "arguments",
    [
        ["--course", "stones", "--view"],
        ["--course", "stones", "--cycles", "3"],
        ["--course", "stones", "--world", "demo"],
        ["--sway", "0.5", "--cycles", "3"],
    ],
)
def test_an_option_that_a_demo_does_not_use_is_refused(tmp_path: Path, arguments: list[str]) -> None:
    result = CliRunner().invoke(demo_command, [*arguments, "--out", str(tmp_path / "out")])
    assert result.exit_code == 2
    assert f"{arguments[2]} was given with {arguments[0]}, which does not use it" in result.output
    assert not (tmp_path / "out").exists()


def test_a_course_and_a_body_that_sways_are_two_demos(tmp_path: Path) -> None:
    arguments = ["--course", "stones", "--sway", "0.5", "--out", str(tmp_path / "out")]
    result = CliRunner().invoke(demo_command, arguments)
    assert result.exit_code == 2 and "--course and --sway were both given; allowed: one of them" in result.output
    assert not (tmp_path / "out").exists()
