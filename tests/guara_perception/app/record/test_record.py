"""From the targets to a first grid: `guara targets`, `record`, `calibrate`, `doctor`, `scan`, `process`, `run`."""

from __future__ import annotations

import json
import shutil
import sys
import types
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import guara_perception as gp
from drivers import CameraSettings
from guara_perception.app.devices_file import Devices, load_devices, save_devices
from guara_perception.app.files.calibration_session import open_session
from guara_perception.app.record.advice import with_advice
from guara_perception.app.record.plate_scan import PlateScanFailed, nominal_order, scan_uncalibrated
from guara_perception.app.record.record import RecordingFailed, record_session
from guara_perception.app.record.session_writer import CROSSES_PICTURE, SessionPlan, SessionWriter
from guara_perception.app.record.simulated import SimulatedWorkshop
from guara_perception.app.targets.drawings import cross_points, parse_board
from guara_perception.calibration.board import BoardSpec
from guara_perception.calibration.find_board import find_board
from guara_perception.simulation.rangefinder import SimulatedRangefinder
from guara_perception.simulation.simulated_camera import renderer
from guara_perception.simulation.world import World
from kinematics import Stance, load_robot
from testbed.bench_board import BenchBoard, BenchCamera, CameraFault, bench_backend
from tests.made_once import made_once

pytestmark = pytest.mark.slow

# A whole session takes as long as the demo, so tests that need one are heavy.


def record_by_command(folder: Path, *arguments: str) -> None:
    """Record with the command in the simulated workshop."""
    from guara_perception.app.main import run

    assert run(["record", str(folder), "--simulated", *arguments]) == 0


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Session recorded by the command; read only."""
    return made_once(tmp_path_factory, "recorded-session", record_by_command)


@pytest.fixture(scope="module")
def recorded_with_charuco(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Session with a ChArUco board held out to the edge of the image."""
    arguments = ("--pattern", "charuco")
    return made_once(tmp_path_factory, "charuco-session", lambda folder: record_by_command(folder, *arguments))


@pytest.fixture
def unfinished(recorded: Path, tmp_path: Path) -> Path:
    """Copy without the crosses, one plate and the finished session.json."""
    folder = Path(shutil.copytree(recorded, tmp_path / "session"))
    for name in ("session.json", CROSSES_PICTURE, "calibration.json"):
        (folder / name).unlink()
    shutil.rmtree(folder / "plate_40")
    return folder


SESSIONS = ["recorded", "recorded_with_charuco"]


@pytest.mark.heavy
@pytest.mark.parametrize("session", SESSIONS)
def test_recorded_session_calibrates_as_good(session: str, request: pytest.FixtureRequest):
    """The verdict is good; the mount is correct to a millimetre and a fifth of a degree."""
    folder = request.getfixturevalue(session)
    made, truth = gp.load_calibration(folder / "calibration.json"), SimulatedWorkshop().truth
    assert made.quality["verdict"] == "good" and len(made.stripes) == 70
    difference = np.linalg.inv(truth.transform_camera_to_base) @ made.transform_camera_to_base
    assert np.linalg.norm(difference[:3, 3]) < 0.001
    assert np.arccos(np.clip((np.trace(difference[:3, :3]) - 1) / 2, -1, 1)) < np.deg2rad(0.2)
    assert np.allclose(made.camera.matrix, truth.camera.matrix, rtol=2e-3, atol=1.0)


@pytest.mark.heavy
def test_parts_of_a_charuco_board_were_taken(recorded_with_charuco: Path):
    """Some images show only a part of the board; session.json names the pattern."""
    session = open_session(recorded_with_charuco)
    assert session.board == BoardSpec(9, 7, 0.03, "charuco")
    views = [find_board(session.read_picture(name), session.board, name) for name in session.board_images]
    assert all(view.is_usable for view in views)
    assert sum(len(view.corners) < 63 for view in views) >= 3


@pytest.mark.heavy
def test_devices_are_measured_and_kept(recorded: Path):
    """The exposure was metered, and the lag is that of the emulated camera: exposure and transfer."""
    devices = load_devices(recorded / "devices.toml")
    assert devices.source == "simulated" and devices.lag is not None
    camera = gp.load_calibration(recorded / "calibration.json").camera
    assert devices.identity == camera.identity == "emulated camera, serial EMU0001"
    exposure = devices.settings["exposure"]
    assert exposure <= devices.lag <= exposure + 1.5 / 60


@pytest.mark.heavy
@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("session", SESSIONS)
def test_commands_lead_to_a_first_grid(session: str, guara, tmp_path: Path, request: pytest.FixtureRequest):
    """The commands of docs/first-grid.md in order, with emulated devices."""
    folder: Path = request.getfixturevalue(session)
    pattern = open_session(folder).board.pattern
    assert guara("targets", "-o", tmp_path / "targets.pdf", "--pattern", pattern).code == 0
    calibration = folder / "calibration.json"
    doctor = guara("doctor", "-c", calibration, "--only", "calibration", "--json")
    assert doctor.code == 0 and json.loads(doctor.out)["level"] == "ok"
    scan = guara("scan", tmp_path / "first", "--simulated", "-c", calibration, "--mode", "coarse")
    assert scan.code == 0, scan.err
    processed = guara("process", tmp_path / "first", "-o", tmp_path / "first.npz")
    assert processed.code == 0, processed.err
    terrain = gp.load_terrain(tmp_path / "first.npz")
    assert (terrain.hazard & 0xFF == 0).mean() > 0.6
    assert terrain.metadata["calibration_hash"] == gp.load_calibration(calibration).hash


@pytest.fixture
def devices_of_the_session(recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The session's devices.toml with a board on the USB bus and a camera class, as with real devices."""
    truth, robot = SimulatedWorkshop().truth, load_robot("guara")
    view = SimulatedRangefinder(World(), truth, robot, seed=3)
    standing = Stance(robot.posture(robot.config.scan_posture), robot.legs, None)
    view.set_pose(robot.stance_pose(standing).transform_base_to_footprint, standing.joint_positions)
    board = BenchBoard()

    class RigCamera(BenchCamera):
        def __init__(self) -> None:
            super().__init__(board, renderer(view), fps=60.0, exposure=0.002, latency=0.001, name="rig camera")

    module = types.ModuleType("emulated_rig")
    module.RigCamera = RigCamera  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "emulated_rig", module)
    monkeypatch.setattr("drivers.board.usb_link.default_backend", lambda: bench_backend(board))
    kept = replace(load_devices(recorded / "devices.toml"), source="emulated_rig:RigCamera")
    save_devices(kept, tmp_path / "devices.toml")
    return tmp_path / "devices.toml"


@pytest.mark.heavy
@pytest.mark.usefixtures("undrawn")
def test_doctor_checks_camera_and_board_of_the_session(
    recorded: Path, devices_of_the_session: Path, guara, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    """Board and camera answer and the metered exposure is kept; the following scan is locked and good."""
    calibration, devices = recorded / "calibration.json", devices_of_the_session
    arguments = ["doctor", "-c", calibration, "--devices", devices, "--json"]
    arguments += ["--only", "board", "--only", "camera", "--only", "calibration"]
    said = guara(*arguments)
    found = {line["name"]: line for line in map(json.loads, said.out.splitlines())}
    assert said.code == 0 and {line["level"] for line in found.values()} == {"ok"}
    assert "firmware" in found["board"]["message"]
    exposure = load_devices(devices).settings["exposure"]
    assert f"delivers 640x512 px; exposure locked at {exposure:g}" in found["camera"]["message"]

    scan = guara("scan", tmp_path / "first", "-c", calibration, "--devices", devices, "--mode", "coarse")
    assert scan.code == 0, scan.err
    assert "locked" not in scan.err and "light" not in scan.err

    monkeypatch.setattr("drivers.board.usb_link.default_backend", lambda: bench_backend())
    said = guara(*arguments)
    found = {line["name"]: line for line in map(json.loads, said.out.splitlines())}
    assert said.code == 1 and found["board"]["level"] == "FAIL" and found["camera"]["level"] == "ok"


def record_with(workshop: SimulatedWorkshop, session: Path, watched: list[str] | None = None) -> list[str]:
    """Resume a session in a workshop; return the reports, and collect the shown images."""
    board, crosses = parse_board("9x7", 0.03), cross_points(workshop.robot)
    plan = SessionPlan("guara", board, crosses, (0.0, 0.04, 0.08), workshop.stance)
    writer = SessionWriter(session, plan)
    with workshop.rangefinder:
        told: list[str] = []
        shown = [] if watched is None else watched
        watch = lambda picture, text: shown.append(text)  # noqa: E731
        record_session(
            writer, workshop.robot, workshop.rangefinder, Devices(), workshop, report=told.append, watch=watch
        )
    return told


@pytest.mark.heavy
def test_an_interrupted_recording_goes_on(unfinished: Path):
    """Only missing parts are recorded; existing images are not written again."""
    before = {path: path.stat().st_mtime_ns for path in unfinished.rglob("*.png") if path.parent.name != "report"}
    shown: list[str] = []
    told = record_with(SimulatedWorkshop(), unfinished, shown)
    tasks = ["the crosses", "the plate of 40 mm", "scanning the plate of 40 mm"]
    assert told == ["views of the hand-held board", told[1], *tasks]
    assert "the scanned area is outlined" in shown and shown[-1] == "stripe 70 of 70"
    assert (unfinished / "session.json").is_file() and (unfinished / "plate_40" / "scan.json").is_file()
    assert all(path.stat().st_mtime_ns == stamp for path, stamp in before.items())


@pytest.mark.heavy
def test_a_session_that_goes_on_is_locked_as_it_was_begun(unfinished: Path):
    """Exposure and lag come from its file; a plate is refused if the camera does not keep them."""
    devices = load_devices(unfinished / "devices.toml")

    class Meddling(SimulatedWorkshop):
        def lay_plate(self, height: float) -> None:
            super().lay_plate(height)
            assert self.rangefinder.camera.lag == pytest.approx(devices.lag)
            self.rangefinder.camera.lock(CameraSettings(exposure=0.5 * devices.settings["exposure"]))

    with pytest.raises(PlateScanFailed, match=r"plate_40: simulated camera: exposure is .* locked"):
        record_with(Meddling(), unfinished)
    assert not (unfinished / "plate_40").exists()


REFUSED = [
    (
        "plate plate_40: after stripe index 3 the mirror",
        "{session} --redo plates`, or correct a height in {session}",
    ),
    ("plate heights look swapped: plate_0", "exchange the heights in {session}/session.json and run `guara calibrate"),
    ("fiducials: 3 of 5 crosses were found", "`guara record {session} --redo crosses`"),
    ("2 of 14 board views are usable", "`guara record {session} --redo board`"),
    (
        "wrong square size: relative to the fiducials",
        "`guara calibrate {session} -o {session}/calibration.json --square",
    ),
]


@pytest.mark.parametrize(("refusal", "way"), REFUSED)
def test_a_refusal_tells_the_way_on(tmp_path: Path, refusal: str, way: str):
    """Only for sessions recorded by `guara record`."""
    with pytest.raises(gp.CalibrationRefused) as told, with_advice(tmp_path):
        raise gp.CalibrationRefused(refusal)
    assert str(told.value) == refusal
    (tmp_path / "recording.json").write_text("{}")
    with pytest.raises(gp.CalibrationRefused) as told, with_advice(tmp_path):
        raise gp.CalibrationRefused(refusal)
    assert str(told.value).startswith(f"{refusal}; to continue without recording everything again, ")
    assert way.format(session=tmp_path) in str(told.value)


@pytest.mark.heavy
def test_a_part_is_recorded_again(recorded: Path, tmp_path: Path, guara):
    """After a refusal, `--redo` records one part again with the earlier options, and the verdict is good."""
    folder = Path(shutil.copytree(recorded, tmp_path / "session"))
    shutil.rmtree(folder / "plate_80")
    # The plate was forgotten, so the bare floor was scanned.
    shutil.copytree(folder / "plate_0", folder / "plate_80")
    (folder / "calibration.json").unlink()
    refused = guara("calibrate", folder, "-o", folder / "calibration.json")
    assert refused.code == 1 and f"guara record {folder} --redo plates" in refused.err
    before = {path: path.read_bytes() for path in folder.glob("*.png")}
    assert guara("record", folder, "--simulated").code == 2
    said = guara("record", folder, "--simulated", "--redo", "plates", "--plates", "0,0.04,0.07")
    assert said.code == 0, said.err
    assert gp.load_calibration(folder / "calibration.json").quality["verdict"] == "good"
    assert sorted(path.name for path in folder.glob("plate_*")) == ["plate_0", "plate_40", "plate_70"]
    assert {path: path.read_bytes() for path in folder.glob("*.png")} == before


@pytest.mark.heavy
def test_a_plate_in_light_that_clips_is_reported(tmp_path: Path):
    """The scan is complete; one of its problems is the clipped light."""
    workshop = SimulatedWorkshop()
    workshop.lay_plate(0.04)
    with workshop.rangefinder as rangefinder:
        rangefinder.lock(CameraSettings(gain=12.0))
        reported = scan_uncalibrated(rangefinder, workshop.robot, workshop.stance, tmp_path / "plate_40", mode="coarse")
    assert any("of the picture is clipped without the laser" in problem for problem in reported)


@pytest.mark.heavy
def test_crosses_that_are_not_there_are_asked_for_again(
    recorded: Path, unfinished: Path, monkeypatch: pytest.MonkeyPatch
):
    """With the reason; after MOST_TRIES the recording ends, and all images are kept."""
    shutil.copytree(recorded / "plate_40", unfinished / "plate_40")
    asked: list[str] = []

    class Forgetful(SimulatedWorkshop):
        def lay_crosses(self, points: str, why_again: str) -> None:
            asked.append(why_again)
            self.clear()
            if len(asked) == 3:
                super().lay_crosses(points, why_again)

    record_with(Forgetful(), unfinished)
    assert asked[0] == "" and "cross" in asked[1] and len(asked) == 3

    (unfinished / CROSSES_PICTURE).unlink()
    (unfinished / "session.json").unlink()
    monkeypatch.setattr("guara_perception.app.record.record.MOST_TRIES", 2)
    with pytest.raises(RecordingFailed, match="the crosses were not found"):
        record_with(Forgetful(), unfinished)
    assert len(asked) == 3 + 2 and len(list(unfinished.glob("board_*.png"))) >= 12


@pytest.mark.heavy
def test_a_plate_is_scanned_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A lost frame leaves no folder; the message names the stripe."""
    monkeypatch.setattr("drivers.emulator.emulated_camera.EmulatedCamera", BenchCamera)
    workshop = SimulatedWorkshop()
    workshop.rangefinder.camera.faults.append(CameraFault("silence", first=20, count=400))
    with workshop.rangefinder, pytest.raises(PlateScanFailed, match=r"plate_0: stripe \d+: frame .*; scan again"):
        scan_uncalibrated(workshop.rangefinder, workshop.robot, workshop.stance, tmp_path / "plate_0", mode="coarse")
    assert not (tmp_path / "plate_0").exists()


@pytest.mark.heavy
def test_scan_without_a_calibration_takes_robot_tomls_pattern(guara, tmp_path: Path, robot):
    """`guara scan FOLDER --no-calibration` scans a plate for a calibration."""
    said = guara("scan", tmp_path / "plate", "--simulated", "--no-calibration", "--mode", "coarse")
    assert said.code == 0 and "recorded without a calibration" in said.out
    scan = gp.open_scan(tmp_path / "plate")
    assert [(s.index, s.mirror_angle) for s in scan.stripes] == nominal_order(robot, "coarse")
    assert scan.calibration_hash is None


@pytest.mark.parametrize(
    ("arguments", "reported"),
    [
        (["--simulated", "--camera", "0"], "--simulated has its own devices"),
        (["--simulated", "--printed-150", "15"], "--printed-150 is 15 mm; allowed: 135 ... 165"),
        (["--simulated", "--plates", "0,0"], "--plates is '0,0', allowed: 2 ... 20 heights"),
        (["--simulated", "--plates", "0,40"], "heights of -0.5 ... 0.5 m"),
        (["--simulated", "--plates", "0"], "--plates is '0', allowed: 2 ... 20 heights"),
        (["--simulated", "--plates", "0.04,0.045"], "two successive ones 0.01 m or more apart; 0 is the bare floor"),
        (
            ["--simulated", "--crosses", "mm.json"],
            "mm.json: a coordinate of a cross is 930 m; allowed: up to 5 m; give metres, not",
        ),
        (["--simulated", "--crosses", "three.json"], "three.json: fiducials.points_in_footprint: 3 points given; 4 or"),
        (["--simulated", "--crosses", "line.json"], "line.json: fiducials: the points are collinear"),
        (["--simulated", "--redo", "plates"], "contains no recording.json; --redo works only on sessions made by"),
        (["--simulated", "--redo", "laser"], "'laser' is not one of 'plates', 'board', 'crosses'"),
        (["--simulated", "--pattern", "dots"], "'dots' is not one of 'checkerboard', 'charuco'"),
        (["--simulated", "--board", "9"], "--board is '9'; it must be COLUMNSxROWS"),
        (["--devices", "none.toml"], "none.toml: no such file; `guara record` writes one"),
        (["--robot", "dog"], "dog"),
    ],
)
def test_wrong_options_are_refused(guara, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments, reported):
    """Exit 2, one line, no folder."""
    monkeypatch.chdir(tmp_path)
    square = [[0.52, 0.25], [0.52, -0.25], [0.93, 0.25], [0.93, -0.25]]
    files = {"mm": 1e3 * np.array(square), "three": np.array(square[:3]), "line": np.c_[np.arange(4.0), np.arange(4.0)]}
    for name, points in files.items():
        Path(f"{name}.json").write_text(json.dumps({"points_in_footprint": points.tolist()}))
    said = guara("record", tmp_path / "s", *arguments)
    assert said.code == 2 and reported in said.err and said.err.count("\n") == 1
    assert not (tmp_path / "s").exists()


def test_scan_refuses_two_targets(guara, tmp_path: Path):
    """FOLDER and --out are the same option."""
    said = guara("scan", tmp_path / "a", "-o", tmp_path / "b", "--simulated")
    assert said.code == 2 and "give one of them" in said.err
    said = guara("scan", tmp_path / "a", "--no-calibration", "-c", "c.json")
    assert said.code == 2 and "mutually exclusive" in said.err
