"""Protocol between the emulator process and its clients: one JSON object per line over a local socket."""

from __future__ import annotations

import json
import socket
from pathlib import Path
from typing import Any

LOOPBACK = "127.0.0.1"


def parse_address(address: str) -> tuple[str, int] | str:
    """Parse an address to (host, port), or to the path of a Unix socket.

    Args:
        address: "127.0.0.1:PORT" or "unix:PATH".

    Raises:
        ValueError: the address has another form, for example another host.
    """
    if address.startswith("unix:"):
        return address.removeprefix("unix:")
    host, _, port = address.rpartition(":")
    if host != LOOPBACK or not port.isdigit():
        raise ValueError(f"emulator address {address!r}, allowed: '{LOOPBACK}:PORT' and 'unix:PATH'")
    return host, int(port)


def listen(address: str) -> tuple[socket.socket, str]:
    """Open a listening socket; return it with the address for clients, in which port 0 is replaced by the real port."""
    where = parse_address(address)
    if isinstance(where, str):
        Path(where).unlink(missing_ok=True)
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        listener.bind(where)
        listener.listen()
        return listener, address
    listener = socket.create_server(where)
    return listener, f"{LOOPBACK}:{listener.getsockname()[1]}"


class Channel:
    """Connection that transfers JSON objects in both directions."""

    def __init__(self, connection: socket.socket) -> None:
        """Wrap a connected socket."""
        self._socket = connection
        self._file = connection.makefile("rb")

    @classmethod
    def connect(cls, address: str, timeout: float = 5.0) -> Channel:
        """Connect to an emulator process.

        Raises:
            OSError: no process listens there.
        """
        where = parse_address(address)
        if isinstance(where, str):
            connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
            connection.settimeout(timeout)
            connection.connect(where)
        else:
            connection = socket.create_connection(where, timeout)
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.settimeout(None)
        return cls(connection)

    def send(self, message: dict[str, Any]) -> None:
        """Send one object."""
        self._socket.sendall(json.dumps(message).encode() + b"\n")

    def receive(self) -> dict[str, Any] | None:
        """Receive the next object; return None if the other side has closed the connection."""
        line = self._file.readline()
        if not line:
            return None
        message: dict[str, Any] = json.loads(line)
        return message

    def close(self) -> None:
        """Close the connection."""
        self._file.close()
        self._socket.close()
