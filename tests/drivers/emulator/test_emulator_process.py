"""The emulator in its own process, reached over a local socket by the same backend."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from drivers import BoardConfig, LaserBoard
from drivers.board.protocol import Request
from drivers.errors import BoardInUse, BoardStalled, BoardUnplugged
from testbed.bench_board import BenchBoard, Fault, FaultKind
from testbed.remote_board import RemoteBoard, remote_backend
from testbed.remote_board.__main__ import main
from testbed.remote_board.server import EmulatorServer, decode_fault, encode_fault
from testbed.remote_board.wire import parse_address
from tests.drivers.conftest import PATIENCE


def test_driver_works_on_a_board_in_another_process(emulator_process) -> None:
    """Laser and mirror can be commanded over the socket, and the state read from outside is the true one."""
    far = RemoteBoard(emulator_process.address)
    with LaserBoard(backend=remote_backend(emulator_process.address)) as board:
        board.ensure_ready()
        reached = board.go_to_angle(0.12)
        board.laser_on()
        view = far.view()
        assert view.laser_on and not view.moving
        assert view.mirror_angle == pytest.approx(reached, abs=1e-9)
        assert far.view(view.laser_since - 0.001).laser_on is False
        assert far.exposure(view.laser_since, view.laser_since + 0.001).laser_fraction == 1.0
    assert not far.view().laser_on
    assert [event.on for event in far.switchings()] == [False, True, False]
    far.close()


def test_faults_are_injected_from_outside(emulator_process) -> None:
    """Stall, unplug and replug over the socket cause the same errors as within the process."""
    far = RemoteBoard(emulator_process.address)
    config = BoardConfig(attempts=1)
    with LaserBoard(config, backend=remote_backend(emulator_process.address)) as board:
        far.inject(Fault(FaultKind.STALL, Request.STATUS))
        with pytest.raises(BoardStalled):
            board.status()
        far.inject(Fault(FaultKind.STALL, Request.STATUS))
        far.mend()
        board.status()
        far.unplug()
        with pytest.raises(BoardUnplugged):
            board.status()
        far.replug()
        board.ensure_ready()


def test_a_dead_emulator_is_an_unplugged_board(emulator_process) -> None:
    """If the process ends, the driver raises BoardUnplugged."""
    with LaserBoard(backend=remote_backend(emulator_process.address)) as board:
        emulator_process.process.kill()
        emulator_process.process.wait(PATIENCE)
        with pytest.raises(BoardUnplugged):
            board.status()


def test_claim_of_a_vanished_host_is_given_back(emulator_process, host, eventually) -> None:
    """When a process ends, its claim is released as by the kernel, and the next process can open the device."""
    program = (
        "import sys, time\nfrom drivers import LaserBoard\nfrom testbed.remote_board import remote_backend\n"
        "board = LaserBoard(backend=remote_backend(sys.argv[1])); board.open(); print('open'); time.sleep(60)"
    )
    process = host(program, emulator_process.address)
    assert process.stdout.readline() == "open\n"
    backend = remote_backend(emulator_process.address)
    with pytest.raises(BoardInUse):
        LaserBoard(backend=backend).open()
    process.kill()
    process.wait(PATIENCE)

    def opens() -> bool:
        try:
            with LaserBoard(backend=backend):
                return True
        except BoardInUse:
            return False

    eventually(opens)


@pytest.mark.slow
def test_unix_socket_and_clean_end(tmp_path: Path) -> None:
    """The emulator also listens on a path, and ends with status 0 on SIGTERM."""
    address = f"unix:{tmp_path}/board"
    process = subprocess.Popen(
        [sys.executable, "-m", "testbed.remote_board", "--listen", address, "--serial", "U1"],
        stdout=subprocess.PIPE,
        text=True,
        cwd=Path(__file__).resolve().parents[3],
    )
    assert process.stdout is not None
    assert process.stdout.readline() == f"ready {address}\n"
    with LaserBoard(backend=remote_backend(address)) as board:
        assert board.serial == "U1"
    process.send_signal(signal.SIGTERM)
    assert process.wait(PATIENCE) == 0
    process.stdout.close()


@pytest.mark.parametrize("address", ["0.0.0.0:80", "localhost:80", "127.0.0.1", "127.0.0.1:x", "board"])
def test_other_addresses_are_refused(address: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Only this machine can reach the emulator; the command prints what is allowed and ends with status 2."""
    with pytest.raises(ValueError, match=r"allowed: '127\.0\.0\.1:PORT' and 'unix:PATH'"):
        parse_address(address)
    assert main(["--listen", address]) == 2
    assert "allowed:" in capsys.readouterr().err


def test_unknown_operation_is_answered_with_an_error() -> None:
    """A client of another version gets an error, not silence."""
    server = EmulatorServer(BenchBoard())
    with pytest.raises(OSError, match="does not know the operation 'dance'"):
        server._answer({"op": "dance"})
    server.close()


@pytest.mark.parametrize(
    "fault",
    [
        Fault(FaultKind.LOST_STEP, Request.GO_TO, skip=3, count=2, amount=40),
        Fault(FaultKind.STALL, "report"),
        Fault(FaultKind.HOT, amount=70),
    ],
)
def test_faults_survive_the_socket(fault: Fault) -> None:
    """A fault is the same after it was sent over the socket."""
    assert decode_fault(encode_fault(fault)) == fault
