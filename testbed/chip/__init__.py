"""Firmware of the laser board on an emulated RP2040, with a USB host and emulated hardware at the pins.

Needs the extra `firmware` (rp2040py). `EmulatedBackend(ChipBus(chip))` is a pyusb backend for the driver.
"""

from __future__ import annotations

from testbed.chip.bus import ChipBus, ChipClock
from testbed.chip.chip import Chip, ChipMissing, load_firmware
from testbed.chip.world import Wiring

__all__ = ["Chip", "ChipBus", "ChipClock", "ChipMissing", "Wiring", "load_firmware"]
