"""The laser board's real firmware on an emulated RP2040, with a USB host and what is wired to the pins.

Needs the extra `firmware` (rp2040py). `ChipBus` puts pyusb and the driver on it: `EmulatedBackend(ChipBus(chip))`.
"""

from __future__ import annotations

from testbed.chip.bus import ChipBus, ChipClock
from testbed.chip.chip import Chip, ChipMissing, load_firmware
from testbed.chip.world import Wiring

__all__ = ["Chip", "ChipBus", "ChipClock", "ChipMissing", "Wiring", "load_firmware"]
