"""Host side of the emulated USB controller: enumeration, control transfers, and polling of reports."""

from __future__ import annotations

import errno
from collections import deque
from collections.abc import Callable
from typing import Any

from drivers.emulator.bus import BusError

# Offsets of the buffer controls in the controller's memory, and their bits (RP2040 data sheet, 4.1.2.5 and 4.1.3).
EP0_IN, EP0_OUT, EP1_IN = 0x80, 0x84, 0x88
AVAILABLE, STALL, DATA1 = 1 << 10, 1 << 11, 1 << 13
PACKET = 64
SUSPENDED = 1 << 4

ADDRESS = 7
ENUMERATION = (
    (0x80, 6, 0x0100, 0, 64),
    (0x00, 5, ADDRESS, 0, 0),
    (0x80, 6, 0x0100, 0, 18),
    (0x80, 6, 0x0200, 0, 9),
    (0x80, 6, 0x0200, 0, 255),
    (0x00, 9, 1, 0, 0),
)


class UsbHost:
    """USB host with one device. It counts wrong data toggles, because the emulator does not check them."""

    def __init__(self, mcu: Any, noticed: Callable[[], None]) -> None:
        """Prepare to enumerate the device when it appears.

        Args:
            mcu: the emulated RP2040.
            noticed: called when a report or a reply has arrived, or the device is enumerated.
        """
        self._controller = mcu.usb_ctrl
        self._noticed = noticed
        self.enumerated = False
        self.halted = False
        self.reports: deque[bytes] = deque()
        self.wants_report = False
        self.wrong_toggles = 0
        self._held: int | None = None
        self._report_data1 = self._packet_data1 = False
        self._answer: bytearray | None = None
        self._requests_left = list(ENUMERATION)
        self._as_built = self._controller.dpram_updated
        self._controller.dpram_updated = self._buffer_given
        self._controller.on_usb_enabled = self._controller.reset_device
        self._controller.on_reset_received = self._bus_was_reset
        self._controller.on_endpoint_write = self._packet_came
        self._controller.on_endpoint_read = self._packet_wanted

    def submit(self, setup: bytes, done: Callable[[bytes | BusError], None]) -> None:
        """Begin a control transfer; a pending one is abandoned."""
        self._setup, self._length, self._done = setup, int.from_bytes(setup[6:8], "little"), done
        self._to_host = bool(setup[0] & 0x80)
        self._answer, self._all_came, self._status_done = bytearray(), False, False
        self._packet_data1 = True
        alarm = self._controller.endpoint_write_alarms[0]
        alarm.alarm.cancel()
        alarm.buffers = []
        if setup[0] == 0x02 and setup[1] == 1 or setup[:2] == b"\x00\x09":
            self._report_data1 = False
        self._controller.send_setup_packet(setup)

    def abandon(self) -> None:
        """Abandon the pending control transfer."""
        self._answer = None

    def poll(self) -> None:
        """Request a report, which arrives now or later."""
        self.wants_report = True
        if self._held is not None:
            value, self._held, self.wants_report = self._held, None, False
            # The toggle changes now, although the report arrives later: the firmware may queue the next one before.
            self._report_data1 = not self._report_data1
            self._as_built(EP1_IN, value)

    def reset_bus(self) -> None:
        """Reset the bus and enumerate again."""
        self.enumerated = self.halted = self._report_data1 = False
        self._held = None
        self.reports.clear()
        self._controller.reset_device()

    def suspend(self, on: bool) -> None:
        """Suspend or resume the bus."""
        # The emulator cannot suspend the bus, so the status bit is set here, as the real controller would.
        if on:
            self._controller._sie_status |= SUSPENDED
        else:
            self._controller._sie_status &= ~SUSPENDED
        self._controller._sie_status_updated()

    def _buffer_given(self, offset: int, value: int) -> None:
        if offset == EP1_IN:
            self.halted = bool(value & STALL)
            self._held = None
            if value & AVAILABLE:
                self.wrong_toggles += bool(value & DATA1) != self._report_data1
                self._held = value
                if self.wants_report:
                    self.poll()
            else:
                self._as_built(offset, value)
            self._noticed()
            return
        if value & AVAILABLE and offset == EP0_IN:
            self.wrong_toggles += bool(value & DATA1) != self._packet_data1
            self._packet_data1 = not self._packet_data1
        if offset == EP0_IN and value & STALL:
            self._finish(BusError(errno.EPIPE, "Pipe error"))
            return
        self._as_built(offset, value)

    def _packet_came(self, endpoint: int, data: bytes) -> None:
        if endpoint:
            self.reports.append(bytes(data))
            self._noticed()
            return
        if self._answer is None:
            return
        self._answer += data
        self._all_came = not self._to_host or len(data) < PACKET or len(self._answer) >= self._length
        if self._all_came and (self._status_done or not self._to_host):
            self._finish(bytes(self._answer))

    def _packet_wanted(self, endpoint: int, size: int) -> None:
        if endpoint:
            return
        self._controller.endpoint_read_done(0, b"")
        self._status_done = True
        if self._answer is not None and self._all_came:
            self._finish(bytes(self._answer))

    def _finish(self, result: bytes | BusError) -> None:
        if self._answer is None:
            return
        self._answer = None
        self._done(result)
        self._noticed()

    def _bus_was_reset(self) -> None:
        self._requests_left = list(ENUMERATION)
        self._next_request(b"")

    def _next_request(self, result: bytes | BusError) -> None:
        if isinstance(result, BusError):
            return
        if not self._requests_left:
            self.enumerated = True
            self._noticed()
            return
        kind, request, *fields = self._requests_left.pop(0)
        self.submit(
            bytes([kind, request]) + b"".join(number.to_bytes(2, "little") for number in fields), self._next_request
        )
