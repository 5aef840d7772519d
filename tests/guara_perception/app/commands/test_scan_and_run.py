"""`guara scan` and `guara run` as a user runs them, with simulated devices."""

import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import guara_perception as gp
from drivers import HeldSettings
from drivers.emulator import EmulatedCamera
from guara_perception.app.commands.run import command as run_command
from guara_perception.app.commands.run import recording_size
from guara_perception.app.figures import figures
from guara_perception.app.main import run
from kinematics import RobotModel
from tests.forked import ForkedProcess
from tests.ports import free_endpoint as free_port_endpoint
from transport import open_node

PATIENCE = 180.0


@pytest.mark.slow
def test_scan_writes_a_scan_that_can_be_processed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, robot: RobotModel
) -> None:
    """A scan folder, figures beside it (drawn in the tests of figures), and a one-line summary."""
    drawn: list[Path] = []

    def draw(folder: Path, *_: object) -> list[Path]:
        drawn.append(folder)
        return drawn

    monkeypatch.setattr(figures, "draw_figures", draw)
    out = tmp_path / "scan"
    assert run(["scan", "--simulated", "--mode", "coarse", "-o", str(out)]) == 0
    printed = capsys.readouterr().out
    assert f"{out}: step 0, coarse" in printed and "pictures" in printed
    scan = gp.open_scan(out)
    assert (scan.mode, len(scan.stripes), scan.robot) == ("coarse", 35, robot.name)
    assert drawn == [tmp_path / "scan-figures"]


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("more", [[], ["--no-calibration"]])
def test_scan_says_which_setting_is_not_as_it_was_locked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, more: list[str]
) -> None:
    """A scan reports the changed setting; a scan for a calibration is refused."""
    monkeypatch.setattr(EmulatedCamera, "held", lambda self, locked: HeldSettings(automatic=("exposure",)))
    out = tmp_path / "scan"
    code = run(["scan", "--simulated", "--mode", "coarse", "-o", str(out), *more])
    printed = capsys.readouterr()
    assert "simulated camera: automatic exposure is on, it was locked at" in printed.err
    assert (code, out.exists()) == ((1, False) if more else (0, True))
    assert more or "automatic exposure is on" in printed.out


@pytest.mark.slow
def test_scan_refuses_a_folder_that_is_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """An existing folder is not overwritten."""
    assert run(["scan", "--simulated", "-o", str(tmp_path)]) == 2
    assert "exists; give another name" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["scan", "run"])
def test_without_calibration_live_commands_say_what_to_do(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Without a calibration, live commands fail and name the remedy."""
    assert run([command]) == 2
    assert "as written by `guara calibrate`" in capsys.readouterr().err


def test_a_real_robot_does_not_walk_on_assumed_values(
    tmp_path: Path, calibration_file: Path, capsys: pytest.CaptureFixture[str], robot: RobotModel
) -> None:
    """`run` refuses assumed values, exit 2; once they are measured, it proceeds to open the board."""
    folder = Path(shutil.copytree(robot.folder, tmp_path / "guara"))
    toml = folder / "robot.toml"
    text = toml.read_text()
    assumed = '\n[assumed]\n"sole" = "measure a foot"\n"frames.camera" = "calibrate"\n"stance.imu_sigma" = "hold it"\n'
    toml.write_text(text + assumed)
    assert run(["run", "-c", str(calibration_file), "--robot", str(folder)]) == 2
    error = capsys.readouterr().err
    assert "sole of 'guara' are assumed, not measured" in error and "not needed with --simulated" in error
    toml.write_text(text + assumed.replace('"sole" = "measure a foot"\n', ""))
    assert run(["run", "-c", str(calibration_file), "--robot", str(folder)]) == 1
    assert "no laser board" in capsys.readouterr().err


def test_without_a_board_a_scan_fails_and_says_so(
    tmp_path: Path, calibration_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit 1 with one line; no folder is left behind."""
    assert run(["scan", "-c", str(calibration_file), "-o", str(tmp_path / "scan")]) == 1
    assert "no laser board" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_what_a_recording_takes_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    """Size per hour, lossless or JPEG; giving both options is an error in either order."""
    assert run(["run", "--simulated", "--jpeg", "90", "--lossless", "--record", "walk.mcap"]) == 2
    assert run(["run", "--simulated", "--lossless", "--jpeg", "90", "--record", "walk.mcap"]) == 2
    assert "--lossless and --jpeg are mutually exclusive" in capsys.readouterr().err
    assert "lossless frames, about 35 GB an hour" in recording_size(None)
    assert "JPEG frames of quality 90, at most about 5 GB an hour" in recording_size(90)
    assert "more than 5 GB" in recording_size(95)


def defaults_of(path: Path, text: str) -> dict[str, object]:
    """Options that `guara run` reads from a node.toml with this text."""
    path.write_text(f'format = "guara-node/1"\n{text}')
    with run_command.make_context("run", ["--simulated", "--node", str(path), "--mode", "coarse"]) as context:
        return context.params


def test_options_that_are_set_once_stand_in_node_toml(tmp_path: Path) -> None:
    """Paths are relative to the file's folder, the command line overrides it, and earlier spellings still work."""
    text = 'mode = "standard"\nsecurity = "keys"\nros2 = true\ndomain = 7\nuplink = "tls/site:7447"\njpeg = 0'
    found = defaults_of(tmp_path / "node.toml", text)
    assert (found["mode"], found["ros2"], found["domain"]) == ("coarse", True, 7)
    assert found["security"] == tmp_path / "keys" and found["uplink"] == "tls/site:7447" and found["jpeg"] == 0
    with run_command.make_context("run", ["--lossless"]) as context:
        assert context.params["jpeg"] == 0


@pytest.mark.parametrize(
    ("text", "reported"),
    [
        ("speed = 3", "unknown speed; allowed: allow_insecure, calibration, camera, "),
        ('mode = "quick"', "mode is 'quick': 'quick' is not one of 'adaptive', 'standard', 'coarse'"),
        ("jpeg = 101", "101 is not in the range 0<=x<=100"),
        ("ros2 = 1", "ros2 is 1: "),
        ("name = true", "name is True: "),
        ("security = 3", "security is 3: "),
        ("mode = ", "not valid TOML"),
    ],
)
def test_a_wrong_node_toml_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, reported: str
) -> None:
    """Exit 2 with one line that names file and key and lists what is allowed."""
    path = tmp_path / "node.toml"
    path.write_text(f'format = "guara-node/1"\n{text}')
    assert run(["run", "--simulated", "--node", str(path)]) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"guara: {path}: ") and reported in said and said.count("\n") == 1
    path.write_text("mode = 'coarse'")
    assert run(["run", "--node", str(path)]) == 2 and "format must be 'guara-node/1'" in capsys.readouterr().err
    assert run(["run", "--node", str(tmp_path / "none")]) == 2 and "no such file" in capsys.readouterr().err


@pytest.mark.slow
def test_a_running_node_ends_cleanly(free_endpoint: str, tmp_path: Path) -> None:
    """The node publishes and records; on SIGTERM it exits 0 with a complete recording and the laser off."""
    recording = tmp_path / "walk.mcap"
    arguments = ["run", "--simulated", "--listen", free_endpoint, "--record", str(recording), "--jpeg", "80"]
    arguments += ["--mode", "coarse"]
    node = subprocess.Popen(
        [sys.executable, "-m", "guara_perception.app.main", *arguments], stdout=subprocess.PIPE, text=True
    )
    try:
        with gp.TerrainClient(free_endpoint, timeout=PATIENCE) as client:
            terrain = client.wait_for_step(0, timeout=PATIENCE)
            client.wait_for_step(0, timeout=PATIENCE, extent="map")
        node.send_signal(signal.SIGTERM)
        printed, _ = node.communicate(timeout=PATIENCE)
    finally:
        node.kill()
    assert node.returncode == 0
    assert printed.splitlines()[-1] == "stopped, laser off"
    assert f"recording to {recording}: JPEG frames of quality 80, at most about 5 GB an hour" in printed
    assert np.isfinite(terrain.elevation).any()
    assert gp.open_scan(recording, step=0).step == 0


@pytest.mark.slow
def test_a_killed_node_comes_up_and_goes_on_recording(free_endpoint: str, tmp_path: Path) -> None:
    """After kill -9, the same command records to the next file, and the truncated one can be recovered."""
    recording = tmp_path / "w.mcap"
    arguments = ["run", "--simulated", "--listen", free_endpoint, "--record", str(recording), "--mode", "coarse"]
    for end in (signal.SIGKILL, signal.SIGINT):
        node = ForkedProcess("-m", "guara_perception.app.main", *arguments)
        try:
            with gp.TerrainClient(free_endpoint, timeout=PATIENCE) as client:
                client.wait_for_step(1, timeout=PATIENCE)
            node.send_signal(end)
            printed, _ = node.communicate(timeout=PATIENCE)
        finally:
            node.kill()
    assert f"recording to {tmp_path / 'w-2.mcap'}" in printed
    assert f"incomplete files: 1; `guara convert {recording} NEW.mcap` makes the newest readable" in printed
    assert run(["convert", str(recording), str(tmp_path / "w-recovered.mcap")]) == 0
    for name in ("w-recovered.mcap", "w-2.mcap"):
        assert gp.open_scan(tmp_path / name, step=0).step == 0 and run(["info", str(tmp_path / name)]) == 0
    assert {path.name for path in tmp_path.iterdir()} == {"w.mcap", "w-2.mcap", "w-recovered.mcap"}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("more", "said"),
    [
        (["--record-limit", "50GB"], "--record-limit needs --record with a folder"),
        (["--record", "w.mcap", "--record-limit", "50GB"], "given: w.mcap"),
        (["--record", "walks", "--record-limit", "lots"], "allowed: 200MB or more"),
        (["--record", "walks", "--record-limit", "10MB"], "allowed: 200MB or more"),
        (["--record", "pyproject.toml"], "a file has this name"),
        (["--record", "/dev/null/walks"], "Not a directory"),
        (["--record", "none/w.mcap"], "No such file or directory"),
    ],
)
def test_a_place_that_cannot_be_recorded_to_is_refused(
    more: list[str], said: str, free_endpoint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Refused at the start, with what is allowed; nothing is left behind."""
    assert run(["run", "--simulated", "--listen", free_endpoint, *more]) != 0
    assert said in capsys.readouterr().err
    assert not Path("walks").exists() and not Path("w.mcap").exists()


@pytest.mark.parametrize(
    ("option", "given", "said"),
    [
        ("--name", "", "robot name '' cannot be part of a key"),
        ("--name", "a/b", "robot name 'a/b' cannot be part of a key"),
        ("--listen", "tcp/127.0.0.1:99999", "and a port of 0 ... 65535"),
    ],
)
def test_a_name_or_endpoint_that_cannot_be_is_refused_at_once(
    option: str, given: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Refused in one line, without waiting for a port to become free."""
    assert run(["run", "--simulated", option, given]) == 2
    told = capsys.readouterr().err
    assert said in told and told.count("\n") == 1


@pytest.mark.slow
def test_the_simulated_gait_speaks_under_the_name_of_the_robot(
    free_endpoint: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """`run --simulated --name lobo` publishes as lobo, and `listen` finds it; Ctrl-C leaves a complete recording."""
    recording = tmp_path / "walk.mcap"
    arguments = ["run", "--simulated", "--name", "lobo", "--mode", "coarse", "--listen", free_endpoint]
    arguments += ["--record", str(recording)]
    node = ForkedProcess("-m", "guara_perception.app.main", *arguments)
    try:
        with gp.TerrainClient(free_endpoint, robot="lobo", timeout=PATIENCE) as client:
            assert client.wait_for_step(0, timeout=PATIENCE).metadata["instance"] == "lobo"
            client.wait_for_step(1, timeout=PATIENCE)
        listen = ["listen", "--connect", free_endpoint, "--name", "lobo", "--count", "1"]
        assert run(listen) == 0 and capsys.readouterr().out.startswith("lobo footprint #")
        node.send_signal(signal.SIGINT)
        printed, _ = node.communicate(timeout=PATIENCE)
    finally:
        node.kill()
    assert node.returncode == 0 and printed.splitlines()[-1] == "stopped, laser off"
    assert gp.open_scan(recording, step=0).robot == "guara"
    assert run(["process", str(recording), "--step", "0", "-o", str(tmp_path / "again.npz")]) == 0
    assert re.search(r"^step 0, coarse, 90x108 cells of 5 mm, known \d+%, traversable \d+%, ", printed, re.MULTILINE)


@pytest.mark.heavy
@pytest.mark.slow
def test_an_uplink_serves_readers_elsewhere_too(free_endpoint: str) -> None:
    """`run --uplink` listens and connects: a planner here and a reader at the other router receive the same pause."""
    site = free_port_endpoint()
    arguments = ["run", "--simulated", "--mode", "coarse", "--listen", free_endpoint, "--uplink", site]
    with open_node(listen=site):
        node = subprocess.Popen(
            [sys.executable, "-m", "guara_perception.app.main", *arguments], stdout=subprocess.PIPE, text=True
        )
        try:
            with (
                gp.TerrainClient(free_endpoint, timeout=PATIENCE) as planner,
                gp.TerrainClient(site, timeout=PATIENCE) as reader,
            ):
                assert planner.wait_for_step(0, timeout=PATIENCE).extent == "footprint"
                assert reader.wait_for_step(0, timeout=PATIENCE).extent == "footprint"
                assert reader.summary(timeout=PATIENCE).robot == "guara"
            node.send_signal(signal.SIGINT)
            printed, _ = node.communicate(timeout=PATIENCE)
        finally:
            node.kill()
    assert node.returncode == 0
    assert printed.splitlines()[1] == f"guara: uplink to {site}; reconnects after a loss"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "reported"),
    [
        (["--uplink", "tcp/site.local:7447"], "is reachable from other machines and nothing protects it"),
        (["--uplink", "tcp/127.0.0.1:1", "--connect", "tcp/127.0.0.1:2"], "mutually exclusive"),
        (["--uplink", "site"], "is not valid"),
    ],
)
def test_an_uplink_that_cannot_be_is_refused(
    free_endpoint: str, arguments: list[str], reported: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit 2, one line."""
    assert (
        run(["run", "--simulated", *([] if "--connect" in arguments else ["--listen", free_endpoint]), *arguments]) == 2
    )
    error = capsys.readouterr().err
    assert reported in error and error.count("\n") == 1
