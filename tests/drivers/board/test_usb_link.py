"""Search for and opening of the board, through the real pyusb."""

import errno

import pytest
import usb.core

from drivers import BoardConfig, LaserBoard
from drivers.board.protocol import Request
from drivers.board.usb_link import UsbLink, default_backend, udev_rule
from drivers.emulator import EmulatorConfig
from drivers.errors import (
    BadReply,
    BoardInUse,
    BoardNotFound,
    BoardNotOpen,
    BoardPermissionDenied,
    BoardTransferFailed,
    NoUsbBackend,
)
from testbed.bench_board import BenchBoard, Fault, FaultKind, bench_backend


def test_real_libusb_loads_and_finds_no_board() -> None:
    """The libusb of libusb-package works on this machine; ids that no device has give BoardNotFound."""
    with pytest.raises(BoardNotFound, match="no laser board 1209:ffff on USB: check its cable"):
        LaserBoard(BoardConfig(product_id=0xFFFF)).open()


def test_missing_libusb_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    """If the library cannot be loaded, the message names the package to reinstall."""
    import libusb_package

    monkeypatch.setattr(libusb_package, "get_libusb1_backend", lambda: None)
    with pytest.raises(NoUsbBackend, match="libusb-package"):
        default_backend()


def test_permission_denied_holds_the_udev_rule() -> None:
    """A user without permission gets the rule to install."""
    emulated = BenchBoard()
    emulated.inject(Fault(FaultKind.NO_PERMISSION, "open"))
    with pytest.raises(BoardPermissionDenied) as caught:
        LaserBoard(backend=bench_backend(emulated)).open()
    assert udev_rule() in str(caught.value)
    assert isinstance(caught.value, PermissionError)


def test_pyusb_without_langid_counts_as_permission_denied(monkeypatch: pytest.MonkeyPatch) -> None:
    """pyusb's ValueError about langids means that strings may not be read; the message says so."""

    def unreadable(*_: object) -> str:
        raise ValueError("The device has no langid (permission issue, no string descriptors supported ...)")

    monkeypatch.setattr("usb.util.get_string", unreadable)
    with pytest.raises(BoardPermissionDenied):
        LaserBoard(backend=bench_backend(BenchBoard())).open()


def test_unreadable_descriptors_are_a_bad_reply(monkeypatch: pytest.MonkeyPatch) -> None:
    """Any other ValueError of pyusb while opening means invalid descriptors."""

    def broken(*_: object) -> str:
        raise ValueError("odd")

    monkeypatch.setattr("usb.util.get_string", broken)
    with pytest.raises(BadReply, match=r"descriptors are unreadable \(odd\)"):
        LaserBoard(backend=bench_backend(BenchBoard())).open()


def test_second_program_finds_the_board_in_use(board: LaserBoard, emulated: BenchBoard) -> None:
    """Two drivers cannot open one board; the second one raises BoardInUse."""
    backend = board._link._backend
    with pytest.raises(BoardInUse, match="another program uses"):
        LaserBoard(backend=backend).open()
    board.close()
    with LaserBoard(backend=backend) as other:
        assert other.status().laser_sensed is False


def test_board_is_chosen_by_serial_number() -> None:
    """With several boards, the serial number decides; without one, the message lists those present."""
    boards = [BenchBoard(EmulatorConfig(serial=serial)) for serial in ("A7", "B9")]
    backend = bench_backend(*boards)
    with pytest.raises(BoardNotFound, match=r"2 laser boards 1209:0001 are plugged in \(A7, B9\)"):
        LaserBoard(backend=backend).open()
    with pytest.raises(BoardNotFound, match="serial number 'C1'; present: A7, B9"):
        LaserBoard(BoardConfig(serial="C1"), backend=backend).open()
    with LaserBoard(BoardConfig(serial="B9"), backend=backend) as board:
        assert board.serial == "B9"
        board.laser_on()
        assert boards[1].view().laser_on and not boards[0].view().laser_on


def test_closed_link_says_how_to_open() -> None:
    """A transfer on a closed link raises BoardNotOpen, not AttributeError."""
    link = UsbLink(BoardConfig(), bench_backend(BenchBoard()))
    with pytest.raises(BoardNotOpen, match="with LaserBoard"):
        link.request(Request.STATUS, 0, 26)
    with pytest.raises(BoardNotOpen):
        link.read_report(0.01)


@pytest.mark.parametrize("number", [errno.EIO, errno.EOVERFLOW, None])
def test_any_other_bus_error_keeps_its_words(monkeypatch: pytest.MonkeyPatch, number: int | None) -> None:
    """Errors without a class of their own contain libusb's text."""
    link = UsbLink(BoardConfig(), bench_backend(BenchBoard()))
    link.open()

    def fail(*_: object) -> None:
        raise usb.core.USBError("Strange thing", -1, number)

    monkeypatch.setattr(link._device, "ctrl_transfer", fail)
    with pytest.raises(BoardTransferFailed, match=r"STATUS failed on the bus .*Strange thing"):
        link.request(Request.STATUS, 0, 26)
    link.close()


def test_device_without_configuration_is_given_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """A board that the kernel has not configured is configured when it is opened."""
    backend = bench_backend(BenchBoard())
    chosen: list[int] = []
    monkeypatch.setattr(backend, "get_configuration", lambda handle: chosen[-1] if chosen else 0)
    monkeypatch.setattr(backend, "set_configuration", lambda handle, value: chosen.append(value))
    with LaserBoard(backend=backend) as board:
        assert board.status().homed is False
    assert chosen == [1]
