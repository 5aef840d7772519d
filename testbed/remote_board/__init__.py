"""Emulated laser board in a separate process, started with `python -m testbed.remote_board`.

`remote_backend(address)` returns a pyusb backend that connects to it. Imports only `drivers` and `bench_board`.
"""

from __future__ import annotations

from testbed.remote_board.remote import RemoteBoard, remote_backend

__all__ = ["RemoteBoard", "remote_backend"]
