"""Pyusb backend whose only devices are emulated boards; the driver and pyusb run unchanged.

Only this module of the emulator imports pyusb.
"""

from __future__ import annotations

import errno
from array import array
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import ParamSpec, TypeVar

import usb.backend
import usb.core

from drivers.emulator import descriptors
from drivers.emulator.board import EmulatedBoard
from drivers.emulator.bus import CLEAR_FEATURE, SET_CONFIGURATION, TO_DEVICE, TO_ENDPOINT, Bus, BusError

_T = TypeVar("_T")
_P = ParamSpec("_P")

# Timeout of standard requests, such as reading a descriptor [s].
DESCRIPTOR_TIMEOUT = 1.0

# libusb's error code for each errno.
LIBUSB_CODES = {
    errno.EIO: -1,
    errno.EACCES: -3,
    errno.ENODEV: -4,
    errno.EBUSY: -6,
    errno.ETIMEDOUT: -7,
    errno.EPIPE: -9,
}


class EmulatedBackend(usb.backend.IBackend):
    """Pyusb backend for one or more emulated buses, each with one board."""

    def __init__(self, *buses: Bus) -> None:
        """Provide the boards on these buses."""
        self._buses = buses

    def enumerate_devices(self) -> Iterator[int]:
        """Iterate over the numbers of the buses whose boards are plugged in."""
        return (number for number, bus in enumerate(self._buses) if bus.present())

    def get_parent(self, dev: int) -> None:
        """Return None: hubs are not emulated."""
        return None

    def get_device_descriptor(self, dev: int) -> SimpleNamespace:
        """Return the device descriptor, with the position of the device on the bus."""
        data, number = self._descriptor(dev, descriptors.DEVICE, 18), dev + 1
        place = {"address": number, "bus": 1, "port_number": number, "port_numbers": (number,), "speed": 2}
        return descriptors.parse(data, descriptors.DEVICE, **place)

    def get_configuration_descriptor(self, dev: int, config: int) -> SimpleNamespace:
        """Return configuration descriptor 0; IndexError for any other."""
        _only_zero(config)
        return descriptors.parse(self._configuration(dev), descriptors.CONFIGURATION, extra_descriptors=[])

    def get_interface_descriptor(self, dev: int, intf: int, alt: int, config: int) -> SimpleNamespace:
        """Return interface descriptor 0; IndexError for any other."""
        _only_zero(intf, alt, config)
        return descriptors.parse(self._configuration(dev), descriptors.INTERFACE_KIND, extra_descriptors=[])

    def get_endpoint_descriptor(self, dev: int, ep: int, intf: int, alt: int, config: int) -> SimpleNamespace:
        """Return endpoint descriptor 0; IndexError for any other."""
        _only_zero(ep, intf, alt, config)
        further = {"bRefresh": 0, "bSynchAddress": 0, "extra_descriptors": []}
        return descriptors.parse(self._configuration(dev), descriptors.ENDPOINT_KIND, **further)

    def _descriptor(self, dev: int, kind: int, length: int) -> bytes:
        return _translated(self._buses[dev].control, 0x80, 6, kind << 8, 0, length, DESCRIPTOR_TIMEOUT)

    def _configuration(self, dev: int) -> bytes:
        return self._descriptor(dev, descriptors.CONFIGURATION, 255)

    def open_device(self, dev: int) -> Bus:
        """Open the board; the returned handle is its bus."""
        bus = self._buses[dev]
        _translated(bus.open)
        return bus

    def close_device(self, dev_handle: Bus) -> None:
        """Close the board and release its interface, as the kernel does."""
        dev_handle.release()

    def set_configuration(self, dev_handle: Bus, config_value: int) -> None:
        """Set configuration 1, the only one."""
        if config_value != 1:
            raise usb.core.USBError("Entity not found", -5, errno.ENOENT)
        _translated(dev_handle.command, TO_DEVICE, SET_CONFIGURATION, config_value, 0, DESCRIPTOR_TIMEOUT)

    def get_configuration(self, dev_handle: Bus) -> int:
        """Return the number of the current configuration."""
        return _translated(dev_handle.control, 0x80, 8, 0, 0, 1, DESCRIPTOR_TIMEOUT)[0]

    def claim_interface(self, dev_handle: Bus, intf: int) -> None:
        """Claim the interface."""
        _translated(dev_handle.claim)

    def release_interface(self, dev_handle: Bus, intf: int) -> None:
        """Release the interface."""
        dev_handle.release()

    def clear_halt(self, dev_handle: Bus, ep: int) -> None:
        """Clear a stall of an endpoint and reset its data toggle."""
        _translated(dev_handle.command, TO_ENDPOINT, CLEAR_FEATURE, 0, ep, DESCRIPTOR_TIMEOUT)

    def ctrl_transfer(
        self,
        dev_handle: Bus,
        bmRequestType: int,
        bRequest: int,
        wValue: int,
        wIndex: int,
        data: array[int],
        timeout: int,
    ) -> int:
        """Make a control transfer. A transfer with data from the host stalls, because the board has no such request."""
        setup = bmRequestType, bRequest, wValue, wIndex
        if bmRequestType & 0x80:
            return _fill(data, _translated(dev_handle.control, *setup, len(data), timeout / 1e3))
        if len(data):
            raise usb.core.USBError("Pipe error", -9, errno.EPIPE)
        _translated(dev_handle.command, *setup, timeout / 1e3)
        return 0

    def intr_read(self, dev_handle: Bus, ep: int, intf: int, buff: array[int], timeout: int) -> int:
        """Read a record from the interrupt endpoint; overflow error if the record is longer than the buffer."""
        return _fill(buff, _translated(dev_handle.interrupt, len(buff), timeout / 1e3))


def emulated_backend(*boards: EmulatedBoard) -> EmulatedBackend:
    """Make a pyusb backend with the given emulated boards plugged in."""
    return EmulatedBackend(*(Bus(board) for board in boards))


def _fill(buffer: array[int], answer: bytes) -> int:
    if len(answer) > len(buffer):
        raise usb.core.USBError("Overflow", -8, errno.EOVERFLOW)
    buffer[: len(answer)] = array("B", answer)
    return len(answer)


def _only_zero(*numbers: int) -> None:
    if any(numbers):
        raise IndexError(f"the emulated board has only index 0 of each kind of descriptor; asked for {numbers}")


def _translated(transfer: Callable[_P, _T], *arguments: _P.args, **options: _P.kwargs) -> _T:
    try:
        return transfer(*arguments, **options)
    except BusError as error:
        code = LIBUSB_CODES.get(error.errno or errno.EIO, -99)
        kind = usb.core.USBTimeoutError if error.errno == errno.ETIMEDOUT else usb.core.USBError
        raise kind(error.strerror, code, error.errno) from error
