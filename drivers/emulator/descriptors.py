"""The USB descriptors of the emulated board, as pyusb's backends hand them out."""

from __future__ import annotations

from types import SimpleNamespace

from drivers.protocol import INTERFACE, MANUFACTURER, PRODUCT, PRODUCT_ID, REPORT_ENDPOINT, VENDOR_ID

# String descriptor 0: English (United States), 0x0409.
LANGUAGE = b"\x04\x03\x09\x04"


def device_descriptor(address: int) -> SimpleNamespace:
    """The device descriptor of the board at a bus address."""
    return SimpleNamespace(
        bLength=18,
        bDescriptorType=1,
        bcdUSB=0x0200,
        bDeviceClass=0,
        bDeviceSubClass=0,
        bDeviceProtocol=0,
        bMaxPacketSize0=64,
        idVendor=VENDOR_ID,
        idProduct=PRODUCT_ID,
        bcdDevice=0x0100,
        iManufacturer=1,
        iProduct=2,
        iSerialNumber=3,
        bNumConfigurations=1,
        address=address,
        bus=1,
        port_number=address,
        port_numbers=(address,),
        speed=2,
    )


def configuration_descriptor() -> SimpleNamespace:
    """The only configuration."""
    return SimpleNamespace(
        bLength=9,
        bDescriptorType=2,
        wTotalLength=9 + 9 + 7,
        bNumInterfaces=1,
        bConfigurationValue=1,
        iConfiguration=0,
        bmAttributes=0x80,
        bMaxPower=250,
        extra_descriptors=[],
    )


def interface_descriptor() -> SimpleNamespace:
    """The only interface."""
    return SimpleNamespace(
        bLength=9,
        bDescriptorType=4,
        bInterfaceNumber=INTERFACE,
        bAlternateSetting=0,
        bNumEndpoints=1,
        bInterfaceClass=0xFF,
        bInterfaceSubClass=0,
        bInterfaceProtocol=1,
        iInterface=0,
        extra_descriptors=[],
    )


def endpoint_descriptor() -> SimpleNamespace:
    """The interrupt endpoint for reports."""
    return SimpleNamespace(
        bLength=7,
        bDescriptorType=5,
        bEndpointAddress=REPORT_ENDPOINT,
        bmAttributes=3,
        wMaxPacketSize=32,
        bInterval=1,
        bRefresh=0,
        bSynchAddress=0,
        extra_descriptors=[],
    )


def string_descriptor(index: int, serial: str) -> bytes | None:
    """String descriptor `index`, None when there is none."""
    if index == 0:
        return LANGUAGE
    text = {1: MANUFACTURER, 2: PRODUCT, 3: serial}.get(index)
    if text is None:
        return None
    body = text.encode("utf-16-le")
    return bytes((len(body) + 2, 3)) + body
