"""One bench for three boards: emulated in Python, the firmware's logic on this machine, the firmware on its chip."""

from __future__ import annotations

import ctypes
from typing import Protocol

import pytest

from drivers.board.board_records import BoardIdentity, BoardStatus
from drivers.board.protocol import IDENTITY_SIZE, PROTOCOL_MAJOR, PROTOCOL_MINOR, REQUEST_IN, Request, split_argument
from drivers.emulator import EmulatorConfig
from testbed.bench_board import BenchBoard, Fault, FaultKind
from testbed.chip import Chip, ChipBus

HELLO = PROTOCOL_MAJOR << 8 | PROTOCOL_MINOR


class Board(Protocol):
    """What every board of the suite must let a test do."""

    def raw(self, request: int, argument: int = 0) -> bytes | None:
        """The answer to a command, None when it stalled."""

    def report(self) -> bytes | None:
        """The oldest report that was not fetched."""

    def wait(self, seconds: float) -> None:
        """Let time pass."""

    @property
    def lit(self) -> bool:
        """Whether the laser really shines."""

    @property
    def position(self) -> float:
        """Where the mirror really is, in steps from the home switch."""

    def inject(self, fault: str, amount: float = 0.0) -> None:
        """`stuck_on`, `dead`, `no_home`, `hot` (amount: degrees), `lost_steps` (amount: steps)."""

    def wire(self, *, exposure: float, miss_from: int | None = None) -> None:
        """Connect EXPOSURE_ACTIVE of a camera with this exposure [s] that misses triggers from a number on."""

    def mend(self) -> None:
        """Remove every fault but steps that were lost."""

    def replug(self) -> None:
        """Pull the plug and put it in again."""


class Bench:
    """A board under test, with the questions the suite asks of it."""

    def __init__(self, board: Board) -> None:
        self.board = board

    def identity(self) -> BoardIdentity:
        data = self.board.raw(Request.IDENTIFY)
        assert data is not None
        return BoardIdentity.unpack(data)

    def ask(self, request: Request, argument: int = 0) -> BoardStatus:
        data = self.board.raw(request, argument)
        assert data is not None
        status = BoardStatus.unpack(data)
        assert status.request == request
        return status

    def status_report(self) -> BoardStatus | None:
        data = self.board.report()
        return None if data is None else BoardStatus.unpack(data)

    def forget_reports(self) -> None:
        while self.board.report() is not None:
            pass

    def until_dark(self, patience: float) -> float:
        """Seconds that pass until the laser is dark."""
        for milliseconds in range(round(patience * 1e3)):
            if not self.board.lit:
                return milliseconds / 1e3
            self.board.wait(0.001)
        pytest.fail(f"the laser still shines after {patience} s")

    def until_still(self, patience: float = 3.0) -> BoardStatus:
        for _ in range(round(patience / 0.002)):
            status = self.ask(Request.STATUS)
            if not status.moving:
                return status
            self.board.wait(0.002)
        pytest.fail(f"the mirror still moves after {patience} s")

    def home(self) -> BoardStatus:
        self.ask(Request.HOME)
        return self.until_still()


class PythonBoard:
    """`testbed.bench_board.BenchBoard`, on the test's own clock."""

    def __init__(self) -> None:
        self.now = 100.0
        self.emulated = BenchBoard(EmulatorConfig(), clock=lambda: self.now)

    def raw(self, request: int, argument: int = 0) -> bytes | None:
        return self.emulated.serve(request, argument)

    def report(self) -> bytes | None:
        return self.emulated.next_report()

    def wait(self, seconds: float) -> None:
        self.now += seconds

    @property
    def lit(self) -> bool:
        return self.emulated.view().laser_on

    @property
    def position(self) -> float:
        identity = self.emulated.config.identity
        return identity.zero_step + self.emulated.view().mirror_angle / identity.step_angle

    def inject(self, fault: str, amount: float = 0.0) -> None:
        kinds = {
            "stuck_on": FaultKind.LASER_STUCK_ON,
            "dead": FaultKind.LASER_STUCK_OFF,
            "no_home": FaultKind.NO_HOME_SWITCH,
            "hot": FaultKind.HOT,
            "lost_steps": FaultKind.LOST_STEP,
        }
        if fault == "hot":
            self.emulated.mend()
        request = Request.GO_TO if fault == "lost_steps" else None
        self.emulated.inject(Fault(kinds[fault], request, amount=round(amount)))

    def wire(self, *, exposure: float, miss_from: int | None = None) -> None:
        shutter = self.emulated.shutter
        shutter.wired, shutter.exposure = True, exposure
        shutter.missed = frozenset() if miss_from is None else frozenset(range(miss_from, 1000))

    def mend(self) -> None:
        self.emulated.mend()

    def replug(self) -> None:
        self.emulated.unplug()
        self.now += 0.1
        self.emulated.replug()


class World(ctypes.Structure):
    """`world_t` of firmware/host.c."""

    _fields_ = [
        *[(name, ctypes.c_uint64) for name in ("now", "last_beat", "last_request", "lit_since", "switched_at")],
        ("longest_after_request", ctypes.c_uint64),
        *[(name, ctypes.c_uint64) for name in ("step_at", "sweep_at", "tick_at", "exposure_at")],
        ("position", ctypes.c_int32),
        ("temperature", ctypes.c_int16),
        *[(name, ctypes.c_bool) for name in ("laser", "supply", "lit", "seen", "trigger", "exposure")],
        *[(name, ctypes.c_bool) for name in ("stuck_on", "dead", "no_home", "no_exposure", "wired")],
        *[
            (name, ctypes.c_uint32)
            for name in ("exposure_delay_us", "exposure_us", "triggers", "beats", "switchings", "miss_from")
        ],
    ]


class HostBoard:
    """The firmware's logic, compiled for this machine with the sanitizer of undefined behaviour."""

    def __init__(self, library: ctypes.CDLL) -> None:
        self.library = library
        library.host_run.restype = ctypes.c_uint64
        library.host_run.argtypes = [ctypes.c_uint64, ctypes.c_bool]
        library.host_request.argtypes = [ctypes.c_uint8, ctypes.c_int32, ctypes.c_char_p]
        library.host_power_up.argtypes = [ctypes.c_uint64, ctypes.c_int32]
        self.world = World.in_dll(library, "world")
        self.answer = ctypes.create_string_buffer(64)
        # Shortly before a clock of 32 bits wraps, so that nothing can rely on small numbers.
        library.host_power_up(2**32 - 5_000_000, 700)

    def raw(self, request: int, argument: int = 0) -> bytes | None:
        length = self.library.host_request(request, argument, self.answer)
        return self.answer.raw[:length] if length else None

    def report(self) -> bytes | None:
        length = self.library.board_report(self.answer)
        return self.answer.raw[:length] if length else None

    def wait(self, seconds: float) -> None:
        self.library.host_run(round(seconds * 1e6), False)

    @property
    def lit(self) -> bool:
        return bool(self.world.lit)

    @property
    def position(self) -> float:
        return float(self.world.position)

    def inject(self, fault: str, amount: float = 0.0) -> None:
        if fault == "hot":
            self.world.temperature = round(amount * 10)
        elif fault == "lost_steps":
            self.world.position -= round(amount)
        else:
            setattr(self.world, fault, True)

    def wire(self, *, exposure: float, miss_from: int | None = None) -> None:
        self.world.wired, self.world.exposure_us = True, round(exposure * 1e6)
        self.world.miss_from = 0xFFFFFFFF if miss_from is None else self.world.triggers + miss_from

    def mend(self) -> None:
        self.world.temperature = 300
        self.world.stuck_on = self.world.dead = self.world.no_home = False

    def replug(self) -> None:
        self.library.host_power_up(0, self.world.position)


class ChipBoard:
    """The whole firmware on an emulated RP2040, reached over its USB."""

    def __init__(self, image: bytes) -> None:
        self.chip = Chip(image)
        self.bus = ChipBus(self.chip)

    def raw(self, request: int, argument: int = 0) -> bytes | None:
        try:
            return self.bus.control(REQUEST_IN, request, *split_argument(argument), IDENTITY_SIZE, 1.0)
        except OSError as stall:
            assert "Pipe" in str(stall)
            return None

    def report(self) -> bytes | None:
        try:
            return self.bus.interrupt(32, 0.003)
        except OSError as silence:
            assert "timed out" in str(silence)
            return None

    def wait(self, seconds: float) -> None:
        self.chip.run(seconds)

    @property
    def lit(self) -> bool:
        return self.chip.world.lit

    @property
    def position(self) -> float:
        return float(self.chip.world.position)

    def inject(self, fault: str, amount: float = 0.0) -> None:
        if fault == "hot":
            self.chip.wiring.temperature = amount
        elif fault == "lost_steps":
            self.chip.world.position -= round(amount)
        else:
            setattr(self.chip.wiring, fault, True)
        self.chip.rewire()

    def wire(self, *, exposure: float, miss_from: int | None = None) -> None:
        shutter = self.chip.wiring.shutter
        shutter.wired, shutter.exposure = True, exposure
        shutter.missed = frozenset() if miss_from is None else frozenset(range(miss_from, 1000))
        self.chip.rewire()

    def mend(self) -> None:
        wiring = self.chip.wiring
        wiring.temperature = 30.0
        wiring.stuck_on = wiring.dead = wiring.no_home = False
        self.chip.rewire()

    def replug(self) -> None:
        self.chip.unplug()
        self.chip.run(0.1)
        self.chip.replug()
        self.bus.await_device()
