"""Node as a systemd service: its unit, and its notifications to the service manager (sd_notify(3))."""

from __future__ import annotations

import logging
import os
import shlex
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from guara_perception.app.exit_codes import EXIT_BAD_INPUT, EXIT_CALIBRATION
from guara_perception.exceptions import InvalidInput
from transport.supervision import supervised

logger = logging.getLogger(__name__)
# Time without a notification after which systemd restarts a node [s]. A scan thread counts as hung after 30 s.
WATCHDOG_S = 20
# Time for stopping [s]; devices get 30 s to close before the node ends without them.
STOP_S = 40
# A node that starts more than BURST times within BURST_S [s] stays down until it is started by hand.
BURST, BURST_S = 5, 120
# Template of the unit.
UNIT = Path(__file__).with_suffix(".unit")


def unit(name: str, node: Path, user: str) -> str:
    """Text of the systemd unit of a node.

    Args:
        name: name of the service, and of its folders below /var/lib and /var/cache.
        node: node.toml of the node.
        user: user that the node runs as; not root.

    Raises:
        InvalidInput: the name or the user contains no letter or digit, or characters other than letters, digits, -
            and _; or the user is root.
    """
    for what, value in (("--name", name), ("--user", user)):
        if not value.replace("-", "").replace("_", "").isalnum() or not value.isascii():
            raise InvalidInput(f"{what} is {value!r}; allowed: letters, digits, - and _")
    if user == "root":
        raise InvalidInput("--user is 'root'; allowed: a separate user whose groups may use camera and board")
    # The program of this installation. Each `%` is doubled, since a single one begins a specifier of systemd.
    program = [sys.executable, "-m", "guara_perception.app.main"]
    return UNIT.read_text(encoding="utf-8").format(
        name=name,
        node=shlex.quote(str(node.absolute()).replace("%", "%%")),
        program=" ".join(shlex.quote(word.replace("%", "%%")) for word in program),
        user=user,
        watchdog=WATCHDOG_S,
        stop=STOP_S,
        burst=BURST,
        burst_s=BURST_S,
        bad_input=EXIT_BAD_INPUT,
        calibration=EXIT_CALIBRATION,
    )


def notify(*states: str) -> None:
    """Send states such as "READY=1" to the service manager; without one (no $NOTIFY_SOCKET) nothing is sent."""
    address = os.environ.get("NOTIFY_SOCKET")
    if not address:
        return
    # An address that begins with @ is in the abstract namespace of Linux.
    address = "\0" + address[1:] if address.startswith("@") else address
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as link:
            link.connect(address)
            link.send("\n".join(states).encode())
    except OSError as error:
        logger.warning("cannot notify the service manager of %s: %s", ", ".join(states), error)


@contextmanager
def service_manager(is_well: Callable[[], bool]) -> Iterator[None]:
    """Notify systemd while the block runs: ready, then the watchdog if systemd expects it, and stopping at the end.

    Args:
        is_well: returns True while the node works. Otherwise the watchdog is not notified, and systemd restarts the
            node.
    """
    is_over = threading.Event()
    microseconds = os.environ.get("WATCHDOG_USEC", "")
    # Half the watchdog's time, as sd_watchdog_enabled(3) advises.
    period = int(microseconds) * 1e-6 / 2.0 if microseconds.isdigit() else 0.0

    def watch() -> None:
        while not is_over.is_set():
            if is_well():
                notify("WATCHDOG=1")
            is_over.wait(period)

    notify("READY=1")
    thread = supervised("guara-watchdog", watch)
    if period:
        thread.start()
    try:
        yield
    finally:
        is_over.set()
        if period:
            thread.join()
        notify("STOPPING=1")
