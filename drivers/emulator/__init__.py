"""An emulated laser board at the USB level, and a camera that looks at it.

`emulated_backend(EmulatedBoard())` is a pyusb backend for `LaserBoard(backend=...)`. Imports `board` and `cameras`.
"""

from __future__ import annotations

from drivers.emulator.backend import EmulatedBackend, emulated_backend
from drivers.emulator.board import EmulatedBoard
from drivers.emulator.config import EmulatorConfig
from drivers.emulator.emulated_camera import CameraFault, EmulatedCamera
from drivers.emulator.faults import Fault, FaultKind
from drivers.emulator.light import Switching
from drivers.emulator.shutter import Shutter
from drivers.emulator.views import BoardView, ExposureView
from drivers.timing import EmulatedClock

__all__ = [
    "EmulatedClock",
    "Shutter",
    "BoardView",
    "CameraFault",
    "EmulatedBackend",
    "EmulatedBoard",
    "EmulatedCamera",
    "EmulatorConfig",
    "ExposureView",
    "Fault",
    "FaultKind",
    "Switching",
    "emulated_backend",
]
