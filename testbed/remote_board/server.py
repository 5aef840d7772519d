"""Server that gives other processes access to an emulated board: USB transfers, views of its state, faults."""

from __future__ import annotations

import socket
import threading
from dataclasses import asdict
from typing import Any

from drivers.board.protocol import Request
from drivers.emulator.bus import BusError
from testbed.bench_board import BenchBoard, FaultyBus
from testbed.bench_board.faults import Fault, FaultKind
from testbed.remote_board.wire import Channel, listen


class EmulatorServer:
    """Server on a local socket, with one thread per client.

    As with real hardware, the end of a client process does not change the board. Only the client's claim on the
    interface is released, as the kernel does when a process ends.
    """

    def __init__(self, board: BenchBoard, address: str = "127.0.0.1:0") -> None:
        """Start to listen; `address` as in `wire.parse_address`, with port 0 for any free port."""
        self._board = board
        self._bus = FaultyBus(board)
        self._listener, self.address = listen(address)

    def serve_forever(self) -> None:
        """Accept clients until `close`."""
        while True:
            try:
                connection, _ = self._listener.accept()
            except OSError:
                return
            threading.Thread(target=self._serve, args=(connection,), daemon=True).start()

    def close(self) -> None:
        """Stop listening."""
        # Shutting the socket down ends accept() in another thread; closing it does not.
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()

    def _serve(self, connection: socket.socket) -> None:
        if connection.family == socket.AF_INET:
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        channel = Channel(connection)
        holds_claim = False
        try:
            while (message := channel.receive()) is not None:
                try:
                    answer = self._answer(message)
                    if message["op"] in ("claim", "release"):
                        holds_claim = message["op"] == "claim"
                except BusError as error:
                    answer = {"errno": error.errno, "text": error.strerror}
                channel.send(answer | {"number": message["number"]})
        except OSError:
            return
        finally:
            if holds_claim:
                self._bus.release()
            channel.close()

    def _control(self, message: dict[str, Any]) -> bytes:
        request_type, request, value, index, length = message["setup"]
        return self._bus.control(request_type, request, value, index, length, message["timeout"])

    def _answer(self, message: dict[str, Any]) -> dict[str, Any]:
        match message["op"]:
            case "present":
                return {"value": self._bus.present()}
            case "open":
                self._bus.open()
            case "claim":
                self._bus.claim()
            case "release":
                self._bus.release()
            case "control":
                return {"data": self._control(message).hex()}
            case "command":
                request_type, request, value, index = message["setup"]
                self._bus.command(request_type, request, value, index, message["timeout"])
            case "interrupt":
                return {"data": self._bus.interrupt(message["length"], message["timeout"]).hex()}
            case "view":
                return asdict(self._board.view(message["at"]))
            case "exposure":
                return asdict(self._board.exposure(message["start"], message["end"]))
            case "switchings":
                return {"value": [[event.time, event.on] for event in self._board.switchings()]}
            case "inject":
                self._board.inject(decode_fault(message["fault"]))
            case "mend":
                self._board.mend()
            case "unplug":
                self._board.unplug()
            case "replug":
                self._board.replug()
            case unknown:
                raise BusError(0, f"the emulator does not know the operation {unknown!r}")
        return {}


def encode_fault(fault: Fault) -> dict[str, Any]:
    """Convert a fault to JSON."""
    request = fault.request.name if isinstance(fault.request, Request) else fault.request
    return {
        "kind": fault.kind.value,
        "request": request,
        "skip": fault.skip,
        "count": fault.count,
        "amount": fault.amount,
    }


def decode_fault(fields: dict[str, Any]) -> Fault:
    """Convert the result of `encode_fault` back to a fault."""
    request = fields["request"]
    return Fault(
        FaultKind(fields["kind"]),
        Request[request] if request in Request.__members__ else request,
        fields["skip"],
        fields["count"],
        fields["amount"],
    )
