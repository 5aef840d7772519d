"""Fixtures of the drivers' tests: an emulated board, a driver on it, and a camera that sees it."""

import dataclasses
import os
import time
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from drivers import BoardConfig, CameraSettings, LaserBoard, timing
from drivers.emulator import EmulatedClock, EmulatorConfig, ExposureView
from testbed.bench_board import BenchBoard, BenchCamera, bench_backend
from tests.forked import ForkedProcess

HEIGHT, WIDTH = 256, 320
ROOT = Path(__file__).resolve().parents[2]

PATIENCE = 180.0
"""[s] For anything that must happen at all; generous, because the machine may be loaded."""


class Scene:
    """Flat grey scene with noise, in which the laser draws one red row."""

    def __init__(self) -> None:
        self._noise = _noise()
        self._count = 0
        self.ambient = 40.0
        self.brightness = 150.0
        self.swallow = False

    @staticmethod
    def row_of(mirror_angle: float) -> float:
        """Row of the stripe at a mirror angle [rad]."""
        return 40.0 + (mirror_angle + 0.15) * 380.0

    def __call__(self, view: ExposureView, settings: CameraSettings) -> np.ndarray:
        gain = (settings.exposure or 0.002) / 0.002
        self._count += 1
        image = self._noise[self._count % 8] + np.int16(min(self.ambient * gain, 3000))
        row = round(self.row_of(view.mirror_angle))
        if view.laser_fraction > 0 and 2 <= row < HEIGHT - 2 and not self.swallow:
            image[row - 1 : row + 2, :, 2] += np.int16(min(self.brightness * gain * view.laser_fraction, 3000))
        return image.clip(0, 255).astype(np.uint8)


@cache
def _noise() -> np.ndarray:
    return np.random.default_rng(1).integers(-3, 4, (8, HEIGHT, WIDTH, 3), dtype=np.int16)


@pytest.fixture
def scene() -> Scene:
    return Scene()


def patient_config(**changes: object) -> EmulatorConfig:
    """Board with a longer watchdog, so that a loaded machine does not trip it in other tests."""
    config = EmulatorConfig(settle=0.001, mirror_speed=40.0)
    identity = dataclasses.replace(config.identity, watchdog=60.0)
    return dataclasses.replace(config, identity=identity, **changes)


@pytest.fixture
def emulated_time() -> Iterator[None]:
    """Devices on an emulated clock: nothing really waits, and a busy machine drops no frames."""
    with timing.on_clock(EmulatedClock()):
        yield


@pytest.fixture
def emulated() -> BenchBoard:
    return BenchBoard(patient_config())


@pytest.fixture
def another_board() -> BenchBoard:
    return BenchBoard(patient_config())


@pytest.fixture
def board(emulated: BenchBoard) -> Iterator[LaserBoard]:
    with LaserBoard(BoardConfig(timeout=0.05), backend=bench_backend(emulated)) as device:
        yield device


@pytest.fixture
def camera(emulated: BenchBoard, scene: Scene) -> Iterator[BenchCamera]:
    with BenchCamera(emulated, scene, fps=300.0, exposure=0.002, latency=0.0005) as device:
        yield device


@pytest.fixture
def firing_order() -> list[tuple[int, float]]:
    return [(index, -0.14 + 0.46 * index / 69) for index in range(70)]


def wait_until(condition: Callable[[], bool], patience: float = PATIENCE) -> None:
    """Wait until a condition holds; fail if it does not within `patience` [s]."""
    deadline = time.monotonic() + patience
    while not condition():
        if time.monotonic() > deadline:
            pytest.fail(f"the condition does not hold within {patience} s")
        # On the clock of the devices, which only advances while somebody waits on it, and for their threads.
        timing.sleep(0.005)
        time.sleep(0.001)


@pytest.fixture
def eventually() -> Callable[[Callable[[], bool]], None]:
    return wait_until


class EmulatorProcess:
    """Running process of `python -m testbed.remote_board`."""

    def __init__(self, listen: str) -> None:
        self.process = ForkedProcess("-m", "testbed.remote_board", "--listen", listen, folder=ROOT)
        fields = self.process.stdout.readline().split()
        assert fields[0] == "ready"
        self.address = fields[1]

    def stop(self) -> int:
        self.process.terminate()
        status = self.process.wait(PATIENCE)
        self.process.close()
        return status


@pytest.fixture
def emulator_process() -> Iterator[EmulatorProcess]:
    process = EmulatorProcess("127.0.0.1:0")
    yield process
    process.stop()


@pytest.fixture
def host() -> Iterator[Callable[..., ForkedProcess]]:
    """Factory that starts a Python program in its own process; processes are ended after the test."""
    started: list[ForkedProcess] = []

    def start(program: str, *arguments: str) -> ForkedProcess:
        environment = os.environ | {"PYTHONUNBUFFERED": "1"}
        started.append(ForkedProcess("-c", program, *arguments, environment=environment, folder=ROOT))
        return started[-1]

    yield start
    for process in started:
        process.close()
