"""TCP proxy with a limited data rate, which emulates a slow link on one machine."""

from __future__ import annotations

import socket
import threading
import time
from types import TracebackType
from typing import Self

# Size of a read, and of each of the kernel's buffers, which must be small to make the link slow [byte].
BLOCK, BUFFER = 16384, 65536


class SlowLink:
    """Proxy that forwards each connection to an endpoint, with the same data rate in both directions.

    Attributes:
        endpoint: Zenoh endpoint of the proxy, to which clients connect instead of the real one.
        passed: amount of data forwarded so far, in both directions together [byte].
    """

    def __init__(self, target: str, rate: float) -> None:
        """Start to listen on a free port.

        Args:
            target: Zenoh endpoint on this machine, over TCP or TLS.
            rate: data rate in each direction [byte/s].
        """
        host, _, port = target.rpartition(":")
        self._target, self._rate = int(port), rate
        self._lock = threading.Lock()
        self._is_closed = False
        self.passed = 0
        self._server = socket.create_server(("127.0.0.1", 0))
        self._sockets = [self._server]
        self.endpoint = f"{host}:{self._server.getsockname()[1]}"
        threading.Thread(target=self._serve, daemon=True).start()

    def __enter__(self) -> Self:
        """Return the link."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the link."""
        self.close()

    def _serve(self) -> None:
        while True:
            try:
                near, _ = self._server.accept()
                far = socket.create_connection(("127.0.0.1", self._target))
            except OSError:
                if self._is_closed:
                    return
                # The target does not listen, so close the client's connection too.
                near.close()
                continue
            with self._lock:
                self._sockets += [near, far]
                if self._is_closed:
                    return
            for source, sink in ((near, far), (far, near)):
                source.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER)
                source.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, BUFFER)
                threading.Thread(target=self._pump, args=(source, sink), daemon=True).start()

    def _pump(self, source: socket.socket, sink: socket.socket) -> None:
        due = time.monotonic()
        try:
            while data := source.recv(BLOCK):
                due = max(due, time.monotonic()) + len(data) / self._rate
                time.sleep(max(0.0, due - time.monotonic()))
                sink.sendall(data)
                with self._lock:
                    self.passed += len(data)
        except OSError:
            pass
        # One side has closed the connection; close it for the other side too.
        for end in (source, sink):
            _shut(end)

    def cut(self) -> None:
        """Cut all current connections; new ones are accepted."""
        with self._lock:
            ends, self._sockets = self._sockets[1:], self._sockets[:1]
        for end in ends:
            _shut(end)
            end.close()

    def close(self) -> None:
        """Cut all connections and stop listening; may be called twice."""
        with self._lock:
            self._is_closed = True
            ends, self._sockets = self._sockets, []
        for end in ends:
            _shut(end)
            end.close()


def _shut(end: socket.socket) -> None:
    """Shut a socket down, which ends reads in other threads; closing it does not."""
    try:
        end.shutdown(socket.SHUT_RDWR)
    except OSError:
        return
