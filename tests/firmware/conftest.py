"""The board under test: emulated in Python, the firmware's logic on this machine, the firmware on its chip."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from drivers.board.protocol import Request
from testbed.chip import Chip, ChipMissing, load_firmware
from tests.firmware.boards import HELLO, Bench, ChipBoard, HostBoard, PythonBoard

FIRMWARE = Path(__file__).resolve().parents[2] / "firmware"
LOGIC = ("board.c", "light.c", "mirror.c", "sweep.c", "records.c", "host.c")
WARNINGS = "-std=c11 -O1 -g -Wall -Wextra -Wconversion -Werror".split()
SANITIZER = "-fsanitize=undefined -fno-sanitize-recover=all".split()


@pytest.fixture(scope="session")
def image() -> bytes:
    return load_firmware(FIRMWARE / "guara_board.uf2")


@pytest.fixture
def new_chip(image: bytes) -> Callable[[], Chip]:
    """Powers an emulated chip up; skips where the emulator is not installed."""

    def make() -> Chip:
        try:
            return Chip(image)
        except ChipMissing as missing:
            pytest.skip(str(missing))

    return make


@pytest.fixture(scope="session")
def library(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    """The logic as a shared library of this machine."""
    if shutil.which("gcc") is None:
        pytest.skip("gcc is not installed: the firmware's logic cannot be compiled for this machine")
    target = tmp_path_factory.mktemp("logic") / "board.so"
    subprocess.run(
        ["gcc", *WARNINGS, *SANITIZER, "-shared", "-fPIC", *[str(FIRMWARE / name) for name in LOGIC], "-o", target],
        check=True,
    )
    return ctypes.CDLL(str(target))


@pytest.fixture(params=["python", "logic", pytest.param("chip", marks=pytest.mark.chip)])
def bench(request: pytest.FixtureRequest) -> Bench:
    if request.param == "python":
        return Bench(PythonBoard())
    if request.param == "logic":
        return Bench(HostBoard(request.getfixturevalue("library")))
    try:
        return Bench(ChipBoard(request.getfixturevalue("image")))
    except ChipMissing as missing:
        pytest.skip(str(missing))


@pytest.fixture
def session(bench: Bench) -> Bench:
    """A board with a session begun."""
    bench.ask(Request.HELLO, HELLO)
    return bench
