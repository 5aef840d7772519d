"""Laser board emulated at the USB level, and an emulated camera that sees it.

`emulated_backend(EmulatedBoard())` is a pyusb backend for `LaserBoard(backend=...)`. Imports `drivers.board`,
`drivers.cameras` and the files directly in `drivers`.
"""

from __future__ import annotations

from drivers.emulator.backend import EmulatedBackend as EmulatedBackend
from drivers.emulator.backend import emulated_backend as emulated_backend
from drivers.emulator.board import EmulatedBoard as EmulatedBoard
from drivers.emulator.config import EmulatorConfig as EmulatorConfig
from drivers.emulator.emulated_camera import EmulatedCamera as EmulatedCamera
from drivers.emulator.views import ExposureView as ExposureView
from drivers.timing import EmulatedClock as EmulatedClock
