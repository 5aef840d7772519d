"""An emulated laser board in a process of its own, as a program has its board: `python -m testbed.remote_board`.

`remote_backend(address)` is a pyusb backend that reaches it; imports `drivers` alone.
"""

from __future__ import annotations

from testbed.remote_board.remote import RemoteBoard, remote_backend

__all__ = ["RemoteBoard", "remote_backend"]
