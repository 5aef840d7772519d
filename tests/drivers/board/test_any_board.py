"""Guarantees of every board that can be tested without instruments: the driver's, the example's, and your own.

Point the laser at a wall, and name your own board as "module:Class" on PYTHONPATH in GUARA_BOARD:

    GUARA_BOARD=own_board:PicBoard PYTHONPATH=examples python -m pytest tests/drivers/board/test_any_board.py

"""

import importlib
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from drivers import AcquireOptions, Board, LaserBoard, SweepOptions, acquire, timing
from drivers.emulator import EmulatedClock
from drivers.errors import BoardNotOpen, BoardTooOld, MirrorNotHomed, MirrorOutOfRange
from testbed.bench_board import BenchBoard, BenchCamera, bench_backend

EXAMPLES = Path(__file__).parents[3] / "examples"
OWN = os.environ.get("GUARA_BOARD")
# Added to the limits that a board states [s].
MARGIN = 0.1
pytestmark = pytest.mark.slow


def made(source: str) -> Board:
    """Board of a class "module:Class"."""
    module, _, name = source.partition(":")
    return getattr(importlib.import_module(module), name)()


@pytest.fixture(params=[OWN] if OWN else ["emulated", "own_board:PicBoard"])
def make(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[], Board]]:
    """Factory of the board under test; the emulated board runs on an emulated clock."""
    with ExitStack() as stack:
        if request.param == "emulated":
            clock = EmulatedClock()
            stack.enter_context(timing.on_clock(clock))
            emulated = BenchBoard(clock=clock.monotonic)
            yield lambda: LaserBoard(backend=bench_backend(emulated))
        else:
            monkeypatch.syspath_prepend(str(EXAMPLES))
            yield lambda: made(request.param)


def test_it_is_dark_when_opened_and_when_closed(make: Callable[[], Board]) -> None:
    """Also if an exception leaves the block with the laser on; closing twice does nothing."""
    board = make()
    with pytest.raises(RuntimeError, match="the owner's mistake"), board:
        assert not board.status().laser_sensed
        board.laser_on()
        raise RuntimeError("the owner's mistake")
    board.close()
    board.open()
    board.open()
    assert not board.status().laser_sensed
    board.close()


def test_a_closed_board_says_so(make: Callable[[], Board]) -> None:
    """Commands to a closed board raise BoardNotOpen."""
    board = make()
    for ask in (board.status, board.laser_on, lambda: board.identity):
        with pytest.raises(BoardNotOpen):
            ask()


def test_its_limits_are_those_that_a_scan_relies_on(make: Callable[[], Board]) -> None:
    """The watchdog acts within 0.4 s, and the travel includes the angle 0 and at least one more step."""
    with make() as board:
        identity = board.identity
        assert 0.0 < identity.watchdog <= 0.4
        assert 0.0 < identity.laser_limit <= 10.0 and 0.0 < identity.laser_rest <= 1.0
        assert identity.min_step < identity.zero_step < identity.max_step and identity.step_angle > 0.0


def test_light_follows_the_command(make: Callable[[], Board]) -> None:
    """According to the sensor, and without a motion of the mirror."""
    with make() as board:
        for _ in range(3):
            status = board.laser_on()
            assert status.laser_commanded and status.laser_sensed
            assert board.status().laser_sensed
            assert not board.laser_off().laser_sensed
            assert not board.status().laser_sensed


def test_a_silent_host_goes_dark(make: Callable[[], Board]) -> None:
    """The laser goes off after the stated time, and the board is ready again once faults are cleared."""
    with make() as board:
        board.laser_on()
        timing.sleep(board.identity.watchdog + MARGIN)
        assert not board.status().laser_sensed
        board.ensure_ready()
        assert board.laser_on().laser_sensed


def test_light_has_an_end(make: Callable[[], Board]) -> None:
    """Whatever the host sends, the laser goes off at its limit; after a rest it can be switched on again."""
    with make() as board:
        board.laser_on()
        end = timing.monotonic() + board.identity.laser_limit + MARGIN
        while timing.monotonic() < end:
            status = board.status()
            timing.sleep(0.3 * board.identity.watchdog)
        assert not status.laser_sensed
        board.laser_off()
        timing.sleep(board.identity.laser_rest + MARGIN)
        board.ensure_ready()
        assert board.laser_on().laser_sensed


def test_the_mirror_goes_where_it_is_sent(make: Callable[[], Board]) -> None:
    """After homing, the mirror reaches every step of its travel at the right angle, with or without waiting."""
    with make() as board:
        identity = board.identity
        if not board.status().homed:
            with pytest.raises(MirrorNotHomed):
                board.go_to_step(identity.zero_step)
        assert board.ensure_ready().homed
        for step in (identity.max_step, identity.min_step, identity.zero_step):
            assert board.go_to_step(step) == pytest.approx(identity.angle_of(step))
            status = board.status()
            assert status.step == step and not status.moving
        board.go_to_step(identity.max_step, wait=False)
        status, since = board.still_since()
        assert status.step == identity.max_step and not status.moving and since <= timing.monotonic()
        assert board.go_to_angle(0.01) == pytest.approx(0.01, abs=identity.step_angle)
        assert board.home() == 0 and board.status().homed


@pytest.mark.parametrize("angle", [float("nan"), float("inf"), -3.0, 3.0])
def test_it_does_not_go_beyond_its_travel(make: Callable[[], Board], angle: float) -> None:
    """A step outside the travel is rejected, and the mirror does not move."""
    with make() as board:
        before = board.ensure_ready().step
        with pytest.raises(MirrorOutOfRange):
            board.go_to_angle(angle)
        for step in (board.identity.min_step - 1, board.identity.max_step + 1):
            with pytest.raises(MirrorOutOfRange):
                board.go_to_step(step)
        assert board.status().step == before


@pytest.mark.skipif(OWN is not None, reason="a process of its own would need the board twice")
def test_a_terminated_program_closes_its_board() -> None:
    """SIGTERM unwinds the `with` block of any board."""
    code = (
        "import os, signal\nfrom own_board import PicBoard\n"
        "class Told(PicBoard):\n    def close(self):\n        super().close()\n        print('closed', flush=True)\n"
        "with Told():\n    os.kill(os.getpid(), signal.SIGTERM)\n    signal.pause()\n"
    )
    environment = {**os.environ, "PYTHONPATH": str(EXAMPLES)}
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60, check=False)
    assert (done.stdout, done.returncode) == ("closed\n", 128 + signal.SIGTERM)


@pytest.mark.skipif(OWN is not None, reason="asked of a board that breaks its promise")
def test_a_board_without_a_watchdog_fails(tmp_path: Path) -> None:
    """This suite, run by the command above, detects a board without a watchdog."""
    (tmp_path / "careless.py").write_text(
        "import own_board\n\n\nclass Careless(own_board.PicBoard):\n"
        "    def __init__(self):\n        super().__init__()\n"
        "        ask = self._pic.ask\n"
        "        def hear(line):\n"
        "            self._pic.heard = own_board.time.monotonic()\n"
        "            return ask(line)\n"
        "        self._pic.ask = hear\n"
    )
    paths = os.pathsep.join(map(str, (tmp_path, EXAMPLES)))
    environment = {**os.environ, "GUARA_BOARD": "careless:Careless", "PYTHONPATH": paths}
    environment.pop("PYTEST_XDIST_WORKER", None)
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-n", "0", "-rf", __file__]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=180, check=False)
    failed = [line for line in done.stdout.splitlines() if line.startswith("FAILED ")]
    assert done.returncode == 1 and len(failed) == 1, done.stdout + done.stderr
    assert "test_a_silent_host_goes_dark" in failed[0]


def test_it_does_not_sweep_by_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    """A triggered camera needs a board with this protocol; the message says what to do."""
    monkeypatch.syspath_prepend(str(EXAMPLES))
    board = made(OWN or "own_board:PicBoard")
    emulated = BenchBoard()
    camera = BenchCamera(emulated, lambda view, settings: None, fps=30.0)  # type: ignore[arg-type, return-value]
    with pytest.raises(BoardTooOld, match="cannot run sweeps, which a triggered camera needs: let the camera run"):
        acquire(board, camera, [(0, 0.0)], AcquireOptions(sweep=SweepOptions()))
