"""The USB descriptors of the emulated board as bytes, and any device's bytes as pyusb's backends hand them out."""

from __future__ import annotations

import struct
from types import SimpleNamespace

from drivers.board.protocol import INTERFACE, MANUFACTURER, PRODUCT, PRODUCT_ID, REPORT_ENDPOINT, REPORT_SIZE, VENDOR_ID

DEVICE, CONFIGURATION, STRING = 1, 2, 3
INTERFACE_KIND, ENDPOINT_KIND = 4, 5
LANGUAGE = b"\x04\x03\x09\x04"  # string descriptor 0: English (United States), 0x0409

DEVICE_LAYOUT = struct.Struct("<BBHBBBBHHHBBBB")
DEVICE_FIELDS = (
    "bLength bDescriptorType bcdUSB bDeviceClass bDeviceSubClass bDeviceProtocol bMaxPacketSize0 "
    "idVendor idProduct bcdDevice iManufacturer iProduct iSerialNumber bNumConfigurations"
).split()
CONFIGURATION_LAYOUT = struct.Struct("<BBHBBBBB")
CONFIGURATION_FIELDS = (
    "bLength bDescriptorType wTotalLength bNumInterfaces bConfigurationValue iConfiguration bmAttributes bMaxPower"
).split()
INTERFACE_LAYOUT = struct.Struct("<BBBBBBBBB")
INTERFACE_FIELDS = (
    "bLength bDescriptorType bInterfaceNumber bAlternateSetting bNumEndpoints "
    "bInterfaceClass bInterfaceSubClass bInterfaceProtocol iInterface"
).split()
ENDPOINT_LAYOUT = struct.Struct("<BBBBHB")
ENDPOINT_FIELDS = "bLength bDescriptorType bEndpointAddress bmAttributes wMaxPacketSize bInterval".split()


def descriptor(kind: int, index: int, serial: str) -> bytes | None:
    """Return a descriptor of the emulated board, None when there is no such descriptor.

    Args:
        kind: type of the descriptor, the high byte of wValue.
        index: which one of them, the low byte.
        serial: the board's serial number.
    """
    if kind == STRING:
        return _string(index, serial)
    if index != 0:
        return None
    if kind == DEVICE:
        ids = (VENDOR_ID, PRODUCT_ID, 0x0100)
        return DEVICE_LAYOUT.pack(DEVICE_LAYOUT.size, DEVICE, 0x0200, 0, 0, 0, 64, *ids, 1, 2, 3, 1)
    if kind == CONFIGURATION:
        interface = INTERFACE_LAYOUT.pack(INTERFACE_LAYOUT.size, INTERFACE_KIND, INTERFACE, 0, 1, 0xFF, 0, 1, 0)
        endpoint = ENDPOINT_LAYOUT.pack(ENDPOINT_LAYOUT.size, ENDPOINT_KIND, REPORT_ENDPOINT, 3, REPORT_SIZE, 1)
        size = CONFIGURATION_LAYOUT.size
        total = size + len(interface) + len(endpoint)
        return CONFIGURATION_LAYOUT.pack(size, CONFIGURATION, total, 1, 1, 0, 0x80, 250) + interface + endpoint
    return None


def parse_device(data: bytes, address: int) -> SimpleNamespace:
    """Return a device descriptor with the device's address on the bus."""
    fields = dict(zip(DEVICE_FIELDS, DEVICE_LAYOUT.unpack_from(data), strict=True))
    return SimpleNamespace(**fields, address=address, bus=1, port_number=address, port_numbers=(address,), speed=2)


def parse_configuration(data: bytes) -> SimpleNamespace:
    """Return the configuration descriptor at the beginning of what a device sends."""
    fields = dict(zip(CONFIGURATION_FIELDS, CONFIGURATION_LAYOUT.unpack_from(data), strict=True))
    return SimpleNamespace(**fields, extra_descriptors=[])


def parse_interface(data: bytes) -> SimpleNamespace:
    """Return the first interface descriptor of a configuration."""
    fields = dict(zip(INTERFACE_FIELDS, INTERFACE_LAYOUT.unpack(_first(data, INTERFACE_KIND)), strict=True))
    return SimpleNamespace(**fields, extra_descriptors=[])


def parse_endpoint(data: bytes) -> SimpleNamespace:
    """Return the first endpoint descriptor of a configuration."""
    fields = dict(zip(ENDPOINT_FIELDS, ENDPOINT_LAYOUT.unpack(_first(data, ENDPOINT_KIND)), strict=True))
    return SimpleNamespace(**fields, bRefresh=0, bSynchAddress=0, extra_descriptors=[])


def _first(data: bytes, kind: int) -> bytes:
    at = 0
    while at + 1 < len(data) and data[at] > 1:
        if data[at + 1] == kind:
            return data[at : at + data[at]]
        at += data[at]
    raise IndexError(f"the configuration holds no descriptor of type {kind}")


def _string(index: int, serial: str) -> bytes | None:
    if index == 0:
        return LANGUAGE
    text = {1: MANUFACTURER, 2: PRODUCT, 3: serial}.get(index)
    if text is None:
        return None
    body = text.encode("utf-16-le")
    return bytes((len(body) + 2, STRING)) + body
