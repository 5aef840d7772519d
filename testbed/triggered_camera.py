"""Emulated camera that is triggered by the emulated board and stamps each frame with its own clock."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from typing import Protocol

from drivers import timing
from drivers.arrays import Image
from drivers.cameras.camera import Camera, CameraSettings, HeldSettings, opened
from drivers.emulator.views import ExposureView
from drivers.errors import CameraTimeout
from drivers.frame import Frame, read_only
from testbed.bench_board.shutter import Opening, Shutter

# Interval of checks for an opening of the shutter [s].
POLL = 0.0005
# Shortest time between two exposures [s].
READ_OUT = 0.0002


class TriggersCamera(Protocol):
    """Board that triggers a camera: `BenchBoard`, or `ChipBus` with the firmware."""

    def exposure(self, start: float, end: float) -> ExposureView:
        """Return the state of laser and mirror during an exposure from `start` to `end` [s]."""

    def openings(self, first: int = 0) -> tuple[Opening, ...]:
        """Openings (start, end) of the shutter [s], from number `first` on."""


class EmulatedTriggeredCamera(Camera):
    """Camera that delivers one frame for each opening of the shutter; `Shutter` has its faults."""

    triggered = True

    def __init__(
        self,
        board: TriggersCamera,
        shutter: Shutter,
        render: Callable[[ExposureView, CameraSettings], Image],
        *,
        latency: float = 0.004,
        fps: float = 0.0,
        clock_offset: float = 1234.5,
        clock_drift: float = 2e-5,
        name: str = "emulated triggered camera",
    ) -> None:
        """Prepare the camera.

        Args:
            board: board that triggers the camera, and whose laser and mirror it sees.
            shutter: shutter of the board, as in `BenchBoard.shutter` and `Wiring.shutter`.
            render: renders the image of an exposure, given the state of the board and the settings of the camera.
            latency: time from the end of the exposure to the arrival of the frame [s].
            fps: highest frame rate [1/s]; 0 = limited only by exposure and read-out.
            clock_offset: offset of the camera's clock [s].
            clock_drift: relative rate error of the clock; positive = it runs fast.
            name: name of the camera in messages.
        """
        self.name = name
        self._shortest = 1.0 / fps if fps > 0 else 0.0
        self._learn_limits(shutter.exposure, latency)
        self.dropped: frozenset[int] = frozenset()
        """Numbers of lost frames, from 0."""
        self.automatic: set[str] = set()
        """Settings in automatic mode, as if switched by another program; affects only `held`."""
        self._board, self._shutter, self._render = board, shutter, render
        self._latency, self._clock_offset, self._clock_drift = latency, clock_offset, clock_drift
        self._settings = CameraSettings(exposure=shutter.exposure, gain=1.0, white_balance=5000.0, gamma=1.0)
        self._next: int | None = None

    def open(self) -> None:
        """Start to wait for triggers; does nothing if the camera is open."""
        if self._next is None:
            self._next = len(self._board.openings())

    def close(self) -> None:
        """Close the camera."""
        self._next = None

    def lock(self, settings: CameraSettings) -> CameraSettings:
        """Set the exposure; the other settings are fixed."""
        if settings.exposure is not None:
            self._shutter.exposure = settings.exposure
            self._settings = CameraSettings(exposure=settings.exposure, gain=1.0, white_balance=5000.0, gamma=1.0)
            self._learn_limits(settings.exposure, self._latency)
        return self._settings

    def held(self, locked: CameraSettings) -> HeldSettings:
        """Report all settings, and those in `automatic` as automatic."""
        return HeldSettings(values=asdict(self._settings), automatic=tuple(self.automatic))

    def grab(self, timeout: float) -> Frame:
        """Return the next frame.

        Raises:
            CameraTimeout: no frame arrives in time.
            CameraNotOpen: the camera is not open.
        """
        deadline = timing.monotonic() + timeout
        while True:
            number = self._started()
            found = self._board.openings(number)
            now = timing.monotonic()
            if found and found[0][1] + self._latency <= now:
                self._next = number + 1
                if number not in self.dropped:
                    return self._frame(number, *found[0])
                continue
            if now >= deadline:
                raise CameraTimeout(f"{self.name} delivered no frame within {timeout:g} s")
            timing.sleep(min(POLL, deadline - now))

    def flush(self) -> None:
        """Discard the frames that have arrived."""
        self._started()
        self._next = len(self._board.openings())

    def _learn_limits(self, exposure: float, latency: float) -> None:
        self.lag = exposure + latency
        self.trigger_period = max(exposure + READ_OUT, self._shortest)

    def _started(self) -> int:
        return opened(self._next, self)

    def _frame(self, number: int, start: float, end: float) -> Frame:
        image = self._render(self._board.exposure(start, end), self._settings)
        device_time = self._clock_offset + start * (1.0 + self._clock_drift)
        return Frame(read_only(image), number, end + self._latency, device_time)
