"""USB connection to the laser board: search, opening, single transfers, typed errors, and udev rule for access."""

from __future__ import annotations

import errno
import math
import threading
from collections.abc import Callable
from typing import Any, TypeVar

from drivers.board.board_config import BoardConfig
from drivers.board.protocol import (
    INTERFACE,
    PRODUCT_ID,
    REPORT_ENDPOINT,
    REPORT_SIZE,
    REQUEST_IN,
    VENDOR_ID,
    Request,
    split_argument,
)
from drivers.errors import (
    BadReply,
    BoardError,
    BoardInUse,
    BoardNotFound,
    BoardNotOpen,
    BoardPermissionDenied,
    BoardStalled,
    BoardTimeout,
    BoardTransferFailed,
    BoardUnplugged,
    NoUsbBackend,
)

_T = TypeVar("_T")
UDEV_RULE_FILE = "/etc/udev/rules.d/70-guara-laser-board.rules"


def default_backend() -> Any:
    """Return pyusb's libusb-1.0 backend, with the library from `libusb-package`.

    Raises:
        NoUsbBackend: the library cannot be loaded on this machine.
    """
    import libusb_package

    backend = libusb_package.get_libusb1_backend()
    if backend is None:
        raise NoUsbBackend(
            "libusb-1.0 could not be loaded from the package libusb-package: "
            "reinstall it (pip install --force-reinstall libusb-package)"
        )
    return backend


class UsbLink:
    """Connection to the control and interrupt endpoints of one laser board. Several threads may make transfers."""

    def __init__(self, config: BoardConfig, backend: Any = None) -> None:
        """Prepare the link; nothing is opened yet.

        Args:
            config: USB ids, serial number, and timeout of a control transfer.
            backend: pyusb backend; None = libusb.
        """
        self._config = config
        self._timeout_ms = max(1, round(config.timeout * 1e3))
        self._backend = backend
        self._device: Any = None
        self._control_lock = threading.Lock()
        self.serial = ""

    @property
    def is_open(self) -> bool:
        """True while a device is open."""
        return self._device is not None

    def open(self) -> None:
        """Find the board, configure it, and claim its interface.

        Raises:
            NoUsbBackend: libusb cannot be loaded.
            BoardNotFound: no board is plugged in, none has the configured serial number, or there are several and no
                serial number is configured.
            BoardPermissionDenied: this user may not open the board.
            BoardInUse: the board is already claimed, usually by another program.
            BoardUnplugged: the board was unplugged during the call.
            BoardError: the board cannot be opened for another reason, which the subclass gives.
        """
        import usb.core
        import usb.util

        if self._backend is None:
            self._backend = default_backend()
        ids = {"idVendor": self._config.vendor_id, "idProduct": self._config.product_id}
        found = self._call(lambda: list(usb.core.find(find_all=True, backend=self._backend, **ids)))
        device, serial = self._choose(found)
        try:
            self._call(lambda: self._configure(device))
            self._call(lambda: usb.util.claim_interface(device, INTERFACE))
        except BoardError:
            usb.util.dispose_resources(device)
            raise
        self._device, self.serial = device, serial

    def close(self) -> None:
        """Release the device; does nothing if it is closed."""
        import usb.util

        device, self._device = self._device, None
        if device is not None:
            usb.util.dispose_resources(device)

    def request(self, request: Request, argument: int, size: int, timeout: float = math.inf) -> bytes:
        """Make one command transfer and return the data of the reply.

        Args:
            request: command.
            argument: argument of the command, signed 32 bits.
            size: length of the reply [bytes].
            timeout: longest wait [s], limited to the configured timeout.

        Raises:
            BoardNotOpen: the board is not open.
            BoardError: the transfer failed; its subclass gives the cause.
        """
        device = self._held()
        value, index = split_argument(argument)
        timeout_ms = self._timeout_ms if timeout * 1e3 >= self._timeout_ms else max(1, round(timeout * 1e3))
        with self._control_lock:
            data = self._call(
                lambda: device.ctrl_transfer(REQUEST_IN, request, value, index, size, timeout_ms),
                f"the command {request.name}",
                timeout_ms,
            )
        return bytes(data)

    def read_report(self, timeout: float) -> bytes | None:
        """Wait for a report on the interrupt endpoint; return None if none arrives in time.

        Args:
            timeout: longest wait [s].

        Raises:
            BoardNotOpen: the board is not open.
            BoardStalled: the endpoint was stalled; its halt has been cleared, so that it can be read again.
            BoardError: the transfer failed; its subclass gives the cause.
        """
        device = self._held()
        try:
            data = self._call(
                lambda: device.read(REPORT_ENDPOINT, REPORT_SIZE, max(1, round(timeout * 1e3))),
                "reading a report",
            )
        except BoardTimeout:
            return None
        except BoardStalled as error:
            self._call(lambda: device.clear_halt(REPORT_ENDPOINT), "clearing a stall")
            raise BoardStalled(
                "the laser board stalled its report endpoint; the stall is cleared: read again"
            ) from error
        return bytes(data)

    def _held(self) -> Any:
        device = self._device
        if device is None:
            raise BoardNotOpen("the laser board is not open: use `with LaserBoard()`, or reconnect()")
        return device

    def _choose(self, found: list[Any]) -> tuple[Any, str]:
        wanted, wanted_serial = f"{self._config.vendor_id:04x}:{self._config.product_id:04x}", self._config.serial
        if not found:
            raise BoardNotFound(
                f"no laser board {wanted} on USB: check its cable and power; `lsusb -d {wanted}` must list it"
            )
        serials = [self._call(lambda device=device: device.serial_number or "") for device in found]  # type: ignore[misc]
        if wanted_serial is not None:
            for device, serial in zip(found, serials, strict=True):
                if serial == wanted_serial:
                    return device, serial
            raise BoardNotFound(
                f"no laser board {wanted} with serial number {wanted_serial!r}; present: {', '.join(serials)}"
            )
        if len(found) > 1:
            raise BoardNotFound(
                f"{len(found)} laser boards {wanted} are plugged in ({', '.join(serials)}): "
                "give the serial number of one"
            )
        return found[0], serials[0]

    def _configure(self, device: Any) -> None:
        import usb.core

        try:
            device.get_active_configuration()
        except usb.core.USBError as error:
            # pyusb's own error "configuration not set" has no errno. After any other error, the configuration must not
            # be set again, because that resets a board that another program may use.
            if error.errno is not None:
                raise
            device.set_configuration()

    def _call(self, transfer: Callable[[], _T], what: str = "opening", timeout_ms: int | None = None) -> _T:
        try:
            return transfer()
        except OSError as error:  # pyusb's errors derive from OSError
            raise self._typed(error, what, timeout_ms or self._timeout_ms) from error
        except ValueError as error:
            # pyusb raises "The device has no langid" if the user may not read a string of the device.
            if "langid" in str(error):
                raise self._denied() from error
            raise BadReply(f"{what}: the board's descriptors are unreadable ({error})") from error

    def _denied(self) -> BoardPermissionDenied:
        return BoardPermissionDenied(
            "the laser board is plugged in, but this user may not open it. Install the udev rule:\n"
            + udev_instructions(self._config.vendor_id, self._config.product_id)
        )

    def _typed(self, error: Exception, what: str, timeout_ms: int) -> BoardError:
        number = getattr(error, "errno", None)
        if number in (errno.EACCES, errno.EPERM):
            return self._denied()
        if number == errno.EBUSY:
            return BoardInUse(
                "another program uses the laser board: stop it (`guara run` and `guara scan` need it exclusively)"
            )
        if number in (errno.ENODEV, errno.ENOENT, errno.ESHUTDOWN):
            return BoardUnplugged(f"the laser board left the bus during {what}: check its cable, then reconnect()")
        if number == errno.ETIMEDOUT:
            return BoardTimeout(f"the laser board did not respond within {timeout_ms} ms ({what})")
        if number == errno.EPIPE:
            return BoardStalled(f"the laser board stalled {what}: its firmware does not know the request")
        return BoardTransferFailed(f"{what} failed on the bus ({error}): check cable and hub")


def udev_rule(vendor_id: int = VENDOR_ID, product_id: int = PRODUCT_ID) -> str:
    """Return the udev rule that lets the logged-in user and the group `plugdev` open the board."""
    return (
        f'SUBSYSTEM=="usb", ATTR{{idVendor}}=="{vendor_id:04x}", ATTR{{idProduct}}=="{product_id:04x}", '
        'MODE="0660", GROUP="plugdev", TAG+="uaccess"'
    )


def udev_instructions(vendor_id: int = VENDOR_ID, product_id: int = PRODUCT_ID) -> str:
    """Return the shell commands that install the udev rule."""
    return (
        f"echo '{udev_rule(vendor_id, product_id)}' | sudo tee {UDEV_RULE_FILE} && "
        "sudo udevadm control --reload-rules && sudo udevadm trigger # then unplug the board and plug it in again"
    )
