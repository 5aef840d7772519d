"""`guara robot new` on the robots of this repository, from their URDF alone."""

from __future__ import annotations

import tomllib
import warnings
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from guara_perception.app.main import run
from guara_perception.app.robot_folder import postures
from guara_perception.exceptions import InvalidInput
from guara_perception.settings import Settings
from kinematics import RobotModel, load_robot
from kinematics.model_checks import sole_above_foot

ROOT = Path(__file__).parents[4]
SOURCES = {
    "guara": ROOT / "robots" / "guara" / "urdf" / "guara.urdf",
    "tapir": ROOT / "tests" / "robots" / "tapir" / "urdf" / "tapir.urdf",
}


@pytest.fixture(scope="module", params=SOURCES)
def made(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[RobotModel, RobotModel]:
    """Robot made from a URDF by `robot new`, and the same robot written by hand."""
    folder = tmp_path_factory.mktemp("robots") / "mine"
    assert run(["robot", "new", str(SOURCES[request.param]), "-o", str(folder)]) == 0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return load_robot(folder), load_robot(SOURCES[request.param].parents[1])


@pytest.mark.slow
def test_it_loads_under_the_folder_s_name_and_is_sound(
    made: tuple[RobotModel, RobotModel], capsys: pytest.CaptureFixture[str]
) -> None:
    """Without a warning, under the name of its folder; `robot check` exits 0 and lists the values to measure."""
    robot, _ = made
    assert robot.name == "mine"
    assert sorted(path.name for path in robot.folder.iterdir()) == ["README.md", "robot.toml", "srdf", "urdf"]
    assert run(["robot", "check", str(robot.folder)]) == 0
    printed = capsys.readouterr().out
    assert f"{robot.folder}: sound" in printed
    assert "note: robot.toml [assumed] sole: assumed, not measured" in printed


@pytest.mark.slow
def test_legs_are_those_written_by_hand(made: tuple[RobotModel, RobotModel]) -> None:
    """The same joints from hip to foot; left and right, front and hind are assigned correctly."""
    robot, by_hand = made
    found = {leg.joints for leg in robot.config.legs}
    assert found == {leg.joints for leg in by_hand.config.legs}
    assert robot.legs == ("lf", "rf", "lh", "rh")
    soles = dict(zip(robot.legs, robot.state(robot.posture("scan")).soles_in_base(), strict=True))
    for leg, sole in soles.items():
        assert (sole[1] > 0) == leg.startswith("l") and (sole[0] > 0) == leg.endswith("f")


@pytest.mark.slow
def test_soles_lie_under_the_feet(made: tuple[RobotModel, RobotModel]) -> None:
    """In the scan posture each sole frame is level, at the lowest point of its foot and below its pitch joint."""
    robot, _ = made
    state = robot.state(robot.posture("scan"))
    for leg in robot.tree.legs.values():
        assert sole_above_foot(robot.tree, leg, state) == pytest.approx(0.0, abs=1e-6)
        np.testing.assert_allclose(state.transform_to_base(leg.sole)[:3, :3], np.eye(3), atol=1e-6)
        np.testing.assert_allclose(state.position_in_base(leg.sole)[:2], state.position_in_base(leg.hip)[:2], atol=1e-6)


@pytest.mark.slow
def test_the_disc_is_a_quarter_of_the_sole(made: tuple[RobotModel, RobotModel]) -> None:
    """As for the Guará; at least three cells of 5 mm."""
    limits = Settings.of(made[0]).limits
    assert limits.disc_radius == pytest.approx(max(0.015, min(made[0].sole) / 4), abs=0.0005)


@pytest.mark.slow
def test_every_value_has_its_reason(made: tuple[RobotModel, RobotModel]) -> None:
    """Each number of robot.toml has a comment with its reason; each assumed key names a value."""
    robot, _ = made
    text = (robot.folder / "robot.toml").read_text()
    content = tomllib.loads(text)
    for table in ("traversability", "heights", "scan"):
        lines = text.split(f"[{table}]")[1].split("\n\n")[0].splitlines()[1:]
        assert len(lines) == len(content[table])
        assert all("#" in line for line in lines if not line.startswith("coarse_every"))
    for key in content["assumed"]:
        value = content
        for part in key.split("."):
            value = value[part]
    readme = (robot.folder / "README.md").read_text()
    assert all(f"| `{key}` |" in readme for key in content["assumed"])


@pytest.mark.slow
def test_the_pattern_sweeps_the_area_and_the_camera_sees_it(made: tuple[RobotModel, RobotModel]) -> None:
    """By the rule of the hand-written folders: from just before the area to just beyond it."""
    robot, _ = made
    state, settings = robot.state(robot.posture("scan")), Settings.of(robot)
    mirror = state.position_in_base(robot.config.laser_frame)
    height = mirror[2] - state.soles_in_base()[:, 2].mean()
    first, last = (mirror[0] + height * np.tan(2.0 * angle) for angle in settings.mirror_angles)
    near, far = settings.footprint_x
    assert near - 0.02 < first < near and far < last < far + 0.02


def test_nothing_is_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A folder that is not empty is refused and unchanged."""
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("mine")
    assert run(["robot", "new", str(SOURCES["guara"]), "-o", str(tmp_path / "mine")]) == 2
    assert "already exists and will not be overwritten" in capsys.readouterr().err
    assert [path.name for path in (tmp_path / "mine").iterdir()] == ["notes.txt"]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("<axis xyz", "<axes xyz", "did you mean <axis>?"),
        ('type="revolute"', 'type="fixed"', "A leg is a chain of 3 or more moving joints"),
        ('<joint name="', '<joint nam="', "a <joint> has no name"),
        ("</robot>", '<xacro:property name="a" value="1"/></robot>', "has xacro macros: expand it first"),
        ('lower="-1.6" upper="1.0"', 'lower="-92" upper="57"', "has the limits -92 ... 57 rad, more than two turns"),
        ('xyz="0 0 -0.1', 'xyz="0 0 -100.1', "m long, allowed: 0.05 ... 5 m. Lengths in a URDF are in metres"),
    ],
)
def test_a_urdf_that_is_no_walking_robot_is_refused(
    old: str, new: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit 2, one line, no folder."""
    source = tmp_path / "bad.urdf"
    source.write_text(SOURCES["guara"].read_text().replace(old, new))
    assert run(["robot", "new", str(source), "-o", str(tmp_path / "mine")]) == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["bad.urdf"]


@pytest.mark.slow
def test_the_next_command_can_be_copied(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Also if the name of the folder contains a space."""
    folder = tmp_path / "my robot"
    assert run(["robot", "new", str(SOURCES["tapir"]), "-o", str(folder)]) == 0
    assert capsys.readouterr().out.endswith(f"next: guara robot check '{folder}'\n")


def test_a_missing_urdf_and_a_bad_name_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Exit 2 with what is allowed."""
    assert run(["robot", "new", str(tmp_path / "no.urdf"), "-o", str(tmp_path / "mine")]) == 2
    assert "no.urdf: cannot be read" in capsys.readouterr().err
    assert run(["robot", "new", str(SOURCES["guara"]), "-o", str(tmp_path / "mine"), "--name", "a b"]) == 2
    assert "allowed: letters, digits, '_' and '-'" in capsys.readouterr().err


def test_a_height_may_be_asked_for(tmp_path: Path) -> None:
    """The hips are at the requested height."""
    assert run(["robot", "new", str(SOURCES["tapir"]), "-o", str(tmp_path / "mine"), "--height", "0.30"]) == 0
    robot = load_robot(tmp_path / "mine")
    assert next(p.hip_height for p in robot.config.postures if p.name == "scan") == 0.30
    assert "hip_height = 0.300    # given by --height\n" in (tmp_path / "mine" / "robot.toml").read_text()


@pytest.mark.parametrize(("stands", "expected_text"), [(False, "cannot stand level"), (True, "stands, but its feet")])
def test_no_height_is_chosen_without_reach(monkeypatch: pytest.MonkeyPatch, stands: bool, expected_text: str) -> None:
    """The error of a robot that can stand but reaches no position of the gait does not say that it cannot stand."""
    leg = SimpleNamespace(length=0.3, foot=SimpleNamespace(size=np.full(3, 0.04)))
    monkeypatch.setattr(postures, "stand", lambda legs, height: object() if stands else None)
    monkeypatch.setattr(postures, "reach_share", lambda leg, posture: 0.0)
    with pytest.raises(InvalidInput, match=expected_text):
        postures.choose_height((leg, leg, leg))
