"""The emulated backend, used through pyusb as by any USB tool."""

import pytest
import usb.core
import usb.util

from drivers.board.protocol import INTERFACE, PRODUCT_ID, REPORT_ENDPOINT, VENDOR_ID
from drivers.emulator import EmulatorConfig
from testbed.bench_board import BenchBoard, bench_backend


@pytest.fixture
def device() -> usb.core.Device:
    found = usb.core.find(
        backend=bench_backend(BenchBoard(EmulatorConfig(serial="S-42"))), idVendor=VENDOR_ID, idProduct=PRODUCT_ID
    )
    assert found is not None
    return found


def test_descriptors_are_those_of_the_document(device: usb.core.Device) -> None:
    """One configuration, one vendor-specific interface, one interrupt endpoint IN of 32 bytes."""
    assert (device.idVendor, device.idProduct, device.bNumConfigurations) == (0x1209, 0x0001, 1)
    configuration = device.get_active_configuration()
    assert configuration.bConfigurationValue == 1 and configuration.bNumInterfaces == 1
    interface = configuration[(0, 0)]
    assert (interface.bInterfaceNumber, interface.bInterfaceClass) == (INTERFACE, 0xFF)
    (endpoint,) = interface.endpoints()
    assert endpoint.bEndpointAddress == REPORT_ENDPOINT and endpoint.wMaxPacketSize == 32
    assert usb.util.endpoint_type(endpoint.bmAttributes) == usb.util.ENDPOINT_TYPE_INTR


def test_strings_are_read_by_standard_requests(device: usb.core.Device) -> None:
    """Manufacturer, product and serial number are UTF-16 descriptors."""
    assert usb.util.get_string(device, 1) == "Guara"
    assert device.product == "Guara laser board"
    assert device.serial_number == "S-42"


def test_whole_descriptor_can_be_printed(device: usb.core.Device) -> None:
    """`print(device)`, as in a bug report, shows the essentials."""
    text = str(device)
    assert "1209" in text and "Interrupt" in text and "S-42" in text


@pytest.mark.parametrize(("kind", "request_"), [(0xC0, 0x99), (0x40, 0x10), (0x80, 0x06)])
def test_unknown_transfers_stall(device: usb.core.Device, kind: int, request_: int) -> None:
    """A request outside the protocol fails with EPIPE, as on a real device."""
    with pytest.raises(usb.core.USBError) as caught:
        device.ctrl_transfer(kind, request_, 0x0309, 0, 8)
    assert caught.value.errno == 32 and caught.value.backend_error_code == -9


def test_silent_interrupt_endpoint_times_out(device: usb.core.Device) -> None:
    """Without a report, pyusb's time-out error is raised."""
    with pytest.raises(usb.core.USBTimeoutError):
        device.read(REPORT_ENDPOINT, 32, 10)


def test_unplugged_board_is_not_listed() -> None:
    """Enumeration finds only the devices on the bus."""
    board = BenchBoard()
    backend = bench_backend(board)
    board.unplug()
    assert usb.core.find(backend=backend, idVendor=VENDOR_ID) is None
    board.replug()
    assert usb.core.find(backend=backend, idVendor=VENDOR_ID) is not None


def test_only_configuration_one_can_be_set(device: usb.core.Device) -> None:
    """Configuration 1 can be set, any other is rejected."""
    device.set_configuration(1)
    with pytest.raises(usb.core.USBError):
        device._ctx.backend.set_configuration(device._ctx.handle, 2)
