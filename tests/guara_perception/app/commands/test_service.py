"""`guara service`, and the notifications of a running node to systemd over a real notify socket."""

import shutil
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from guara_perception.app.exit_codes import EXIT_CALIBRATION
from guara_perception.app.main import run
from guara_perception.app.service import notify, service_manager
from tests.ports import free_endpoint as free_port_endpoint

PATIENCE = 120.0


@pytest.fixture
def manager(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> socket.socket:
    """Socket on which systemd would listen to a service."""
    link = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    link.bind(str(tmp_path / "notify"))
    link.settimeout(PATIENCE)
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
    return link


def test_the_unit_is_one_that_systemd_takes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """`systemd-analyze verify` accepts the unit and rates its exposure as low; without it, only the text is tested."""
    node = tmp_path / "my node.toml"
    node.write_text('format = "guara-node/1"\n')
    assert run(["service", "install", "--node", str(node), "--units", str(tmp_path), "--user", "daemon"]) == 0
    printed = capsys.readouterr().out
    unit = tmp_path / "guara.service"
    text = unit.read_text()
    assert "systemctl enable --now guara" in printed and "useradd" not in printed
    assert f"run --node '{node}'" in text and "RestartPreventExitStatus=2 4" in text and "User=daemon" in text
    if analyze := shutil.which("systemd-analyze"):
        verified = subprocess.run([analyze, "verify", unit], capture_output=True, text=True, timeout=60, check=False)
        assert (verified.returncode, verified.stderr) == (0, "")
        judged = subprocess.run(
            [analyze, "security", "--offline=true", "--threshold=40", unit],
            capture_output=True,
            timeout=60,
            check=False,
        )
        assert judged.returncode == 0


def test_another_unit_is_not_replaced(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "node.toml").write_text('format = "guara-node/1"\n')
    (tmp_path / "guara.service").write_text("[Unit]\n")
    command = ["service", "install", "--node", str(tmp_path / "node.toml"), "--units", str(tmp_path)]
    assert run(command) == 2
    assert "exists and differs; give --force" in capsys.readouterr().err
    assert run([*command, "--force", "--user", "no-such-user"]) == 0
    assert "useradd --system" in capsys.readouterr().out
    assert run([*command, "--user", "no-such-user"]) == 0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--name", "a b"], "--name is 'a b'; allowed: letters"),
        (["--name", "../x"], "--name is '../x'"),
        (["--user", "root"], "--user is 'root'; allowed: a separate user"),
    ],
)
def test_bad_names_are_refused(options: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["service", "print", *options]) == 2
    assert message in capsys.readouterr().err


def test_a_unit_needs_its_node_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["service", "install", "--node", str(tmp_path / "none.toml"), "--units", str(tmp_path)]) == 2
    assert "none.toml: no such file; the service reads its options from this file" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_signs_of_life_end_when_the_node_is_not_well(manager: socket.socket, monkeypatch: pytest.MonkeyPatch) -> None:
    """READY, a watchdog notification while the node works, none afterwards, then STOPPING."""
    monkeypatch.setenv("WATCHDOG_USEC", "20000")
    asked = [False, False, True]
    with service_manager(lambda: bool(asked) and asked.pop()):
        assert manager.recv(100) == b"READY=1"
        assert manager.recv(100) == b"WATCHDOG=1"
        while asked:
            pass
    assert manager.recv(100) == b"STOPPING=1"


def test_without_a_manager_nothing_is_sent(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    """Without a service manager nothing is sent; a socket that is gone is logged."""
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    notify("READY=1")
    assert not caplog.records
    monkeypatch.setenv("NOTIFY_SOCKET", "@guara-no-such-socket")
    notify("READY=1")
    assert "cannot notify the service manager of READY=1" in caplog.text


@pytest.mark.slow
def test_a_node_tells_systemd_how_it_is(manager: socket.socket, monkeypatch: pytest.MonkeyPatch) -> None:
    """READY when it listens, watchdog notifications, its last scan as status, and STOPPING on SIGTERM with exit 0."""
    monkeypatch.setenv("WATCHDOG_USEC", "1000000")
    command = [
        sys.executable,
        "-m",
        "guara_perception.app.main",
        "run",
        "--simulated",
        "--listen",
        free_port_endpoint(),
    ]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as node:
        try:
            told = [manager.recv(1000).decode()]
            while not any(each.startswith("STATUS=step 0") for each in told) or "WATCHDOG=1" not in told:
                told.append(manager.recv(1000).decode())
            assert told[0] == "READY=1"
            node.send_signal(signal.SIGTERM)
            while told[-1] != "STOPPING=1":
                told.append(manager.recv(1000).decode())
            assert node.wait(PATIENCE) == 0
        finally:
            node.kill()


def test_a_check_names_every_mistake_at_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Mistakes in node.toml, in the files that it names and in a security folder; no device is opened."""
    (tmp_path / "devices.toml").write_text('format = "guara-devices/1"\n[camera]\nsource = "0"\nfsp = 3\n')
    node = tmp_path / "node.toml"
    node.write_text(
        'format = "guara-node/1"\nmode = "quick"\nros = true\ndevices = "devices.toml"\ncalibration = "none.json"\n'
        'security = "keys"\n'
    )
    assert run(["run", "--node", str(node), "--check"]) == 2
    error = capsys.readouterr().err
    assert "5 errors" in error
    for part in ("mode is 'quick'", "unknown ros;", "unknown fsp;", "none.json", "keys contains no certificate"):
        assert part in error
    assert run(["run", "--node", str(node)]) == 2
    assert "2 errors" in capsys.readouterr().err


def test_a_check_finds_what_a_start_would_refuse(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Options that are otherwise checked only at the start are each reported."""
    node = tmp_path / "node.toml"
    node.write_text(
        'format = "guara-node/1"\nsimulated = true\nname = "r e x"\nlisten = "tcp/0.0.0.0:7447"\nros2_tf = true\n'
        'method = "best"\nrecord_limit = "5 apples"\nworld = "none.toml"\n'
    )
    assert run(["run", "--node", str(node), "--check"]) == 2
    error = capsys.readouterr().err
    assert "6 errors" in error
    for part in (
        "robot name 'r e x' cannot",
        "'tcp/0.0.0.0:7447' is reachable from other machines",
        "--ros2-tf and --ros2-unknown require --ros2",
        "method is 'best'",
        "--record-limit is '5 apples'",
        "none.toml: no such world file",
    ):
        assert part in error
    node.write_text('format = "guara-node/1"\nsimulated = true\nconnect = "tcp/site:1"\nuplink = "tcp/site:2"\n')
    assert run(["run", "--node", str(node), "--check"]) == 2
    assert "are mutually exclusive" in capsys.readouterr().err


def test_a_sound_configuration_is_told(
    tmp_path: Path, calibration_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """No device is opened; a robot that does not match the calibration has its own exit code."""
    node = tmp_path / "node.toml"
    node.write_text(f'format = "guara-node/1"\ncalibration = "{calibration_file}"\n')
    assert run(["run", "--node", str(node), "--check"]) == 0
    assert "the configuration is sound" in capsys.readouterr().out


def test_a_calibration_that_does_not_fit_has_a_code_of_its_own(
    monkeypatch: pytest.MonkeyPatch, calibration_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A service manager must not restart the node; `process` exits with the code of bad input."""
    from guara_perception.app.node import devices
    from guara_perception.exceptions import CalibrationMismatch

    def refuse(*_: object, **__: object) -> None:
        raise CalibrationMismatch("calibration of another robot")

    monkeypatch.setattr(devices, "choose_rig", refuse)
    assert run(["run", "-c", str(calibration_file)]) == EXIT_CALIBRATION
    assert "calibration of another robot" in capsys.readouterr().err
