"""Emulated laser board, and an emulated camera that sees it.

`LaserBoard(backend=emulated_backend(EmulatedBoard()))` controls the emulated board. Imports `drivers.board`,
`drivers.cameras` and the files directly in `drivers`.
"""

from __future__ import annotations

from drivers.emulator.board import EmulatedBoard as EmulatedBoard
from drivers.emulator.config import EmulatorConfig as EmulatorConfig
from drivers.emulator.emulated_camera import EmulatedCamera as EmulatedCamera
from drivers.emulator.link import emulated_backend as emulated_backend
from drivers.emulator.views import ExposureView as ExposureView
from drivers.timing import EmulatedClock as EmulatedClock
