"""USB descriptors of the emulated board, and their conversion to the objects that pyusb backends return."""

from __future__ import annotations

import struct
from types import SimpleNamespace
from typing import Any

from drivers.board.protocol import INTERFACE, MANUFACTURER, PRODUCT, PRODUCT_ID, REPORT_ENDPOINT, REPORT_SIZE, VENDOR_ID

DEVICE, CONFIGURATION, STRING, INTERFACE_KIND, ENDPOINT_KIND = 1, 2, 3, 4, 5
# String descriptor 0: English (United States), 0x0409.
LANGUAGE = b"\x04\x03\x09\x04"
# Layout of each type of descriptor, and the names (as in the USB specification) of the fields after length and type.
LAYOUTS = {
    DEVICE: (
        struct.Struct("<BBHBBBBHHHBBBB"),
        "bcdUSB bDeviceClass bDeviceSubClass bDeviceProtocol bMaxPacketSize0 "
        "idVendor idProduct bcdDevice iManufacturer iProduct iSerialNumber bNumConfigurations",
    ),
    CONFIGURATION: (
        struct.Struct("<BBHBBBBB"),
        "wTotalLength bNumInterfaces bConfigurationValue iConfiguration bmAttributes bMaxPower",
    ),
    INTERFACE_KIND: (
        struct.Struct("<BBBBBBBBB"),
        "bInterfaceNumber bAlternateSetting bNumEndpoints "
        "bInterfaceClass bInterfaceSubClass bInterfaceProtocol iInterface",
    ),
    ENDPOINT_KIND: (struct.Struct("<BBBBHB"), "bEndpointAddress bmAttributes wMaxPacketSize bInterval"),
}


def descriptor(kind: int, index: int, serial: str) -> bytes | None:
    """Return a descriptor of the emulated board, or None if the board has no such descriptor.

    Args:
        kind: type of the descriptor (high byte of wValue).
        index: index of the descriptor (low byte of wValue).
        serial: serial number of the board.
    """
    if kind == STRING:
        return _string(index, serial)
    if index != 0:
        return None
    if kind == DEVICE:
        return _packed(DEVICE, 0x0200, 0, 0, 0, 64, VENDOR_ID, PRODUCT_ID, 0x0100, 1, 2, 3, 1)
    if kind == CONFIGURATION:
        inner = _packed(INTERFACE_KIND, INTERFACE, 0, 1, 0xFF, 0, 1, 0)
        inner += _packed(ENDPOINT_KIND, REPORT_ENDPOINT, 3, REPORT_SIZE, 1)
        return _packed(CONFIGURATION, LAYOUTS[CONFIGURATION][0].size + len(inner), 1, 1, 0, 0x80, 250) + inner
    return None


def parse(data: bytes, kind: int, **further: Any) -> SimpleNamespace:
    """Parse the first descriptor of a type in the data of a device; `further` attributes are added to the result.

    Raises:
        IndexError: there is no such descriptor.
    """
    layout, names = LAYOUTS[kind]
    values = layout.unpack(_first(data, kind))
    fields = dict(zip(("bLength", "bDescriptorType", *names.split()), values, strict=True))
    return SimpleNamespace(**fields, **further)


def _packed(kind: int, *values: int) -> bytes:
    layout, _ = LAYOUTS[kind]
    return layout.pack(layout.size, kind, *values)


def _first(data: bytes, kind: int) -> bytes:
    at = 0
    while at + 1 < len(data) and data[at] > 1:
        if data[at + 1] == kind:
            return data[at : at + data[at]]
        at += data[at]
    raise IndexError(f"the device sent no descriptor of type {kind}")


def _string(index: int, serial: str) -> bytes | None:
    if index == 0:
        return LANGUAGE
    text = {1: MANUFACTURER, 2: PRODUCT, 3: serial}.get(index)
    if text is None:
        return None
    body = text.encode("utf-16-le")
    return bytes((len(body) + 2, STRING)) + body
