"""An emulated laser board at the USB level, in this process or in one of its own, and a camera that looks at it.

`emulated_backend(EmulatedBoard())` is a pyusb backend for `LaserBoard(backend=...)`; `remote_backend(address)`
reaches a process started by `python -m drivers.emulator`.
"""

from __future__ import annotations

from drivers.emulator.backend import EmulatedBackend, emulated_backend
from drivers.emulator.board import EmulatedBoard
from drivers.emulator.camera import CameraFault, EmulatedCamera
from drivers.emulator.clock import EmulatedClock
from drivers.emulator.config import EmulatorConfig
from drivers.emulator.faults import Fault, FaultKind
from drivers.emulator.laser import Switching
from drivers.emulator.remote import RemoteBoard, remote_backend
from drivers.emulator.shutter import Shutter
from drivers.emulator.triggered_camera import EmulatedTriggeredCamera
from drivers.emulator.views import BoardView, ExposureView

__all__ = [
    "EmulatedClock",
    "EmulatedTriggeredCamera",
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
    "RemoteBoard",
    "Switching",
    "emulated_backend",
    "remote_backend",
]
