"""Emulated board with the complete protocol 1.2 and injectable faults, and a free-running camera with faults.

`bench_backend(BenchBoard())` returns a pyusb backend for `LaserBoard(backend=...)`, like
`drivers.emulator.emulated_backend` for a board without sweeps and faults.
"""

from __future__ import annotations

from testbed.bench_board.board import BenchBoard, BoardView
from testbed.bench_board.bus import FaultyBus, bench_backend
from testbed.bench_board.camera import BenchCamera, CameraFault
from testbed.bench_board.faults import Fault, FaultKind
from testbed.bench_board.shutter import Shutter

__all__ = [
    "BenchBoard",
    "BenchCamera",
    "BoardView",
    "CameraFault",
    "Fault",
    "FaultKind",
    "FaultyBus",
    "Shutter",
    "bench_backend",
]
