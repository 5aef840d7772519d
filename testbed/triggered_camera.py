"""A camera that exposes when the emulated board triggers it, and gives each frame a time of its own clock."""

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

# Seconds between two questions whether a shutter has opened.
POLL = 0.0005
# Seconds after an exposure before which no other may begin.
READ_OUT = 0.0002


class TriggersCamera(Protocol):
    """A board that triggers a camera: `BenchBoard`, or `ChipBus` with the firmware behind it."""

    def exposure(self, start: float, end: float) -> ExposureView:
        """Return what a camera that exposed from `start` to `end` [s] saw."""

    def openings(self, first: int = 0) -> tuple[Opening, ...]:
        """When the shutter opened and closed [s], from opening number `first` on."""


class EmulatedTriggeredCamera(Camera):
    """One frame for each opening of the shutter. Faults of the shutter are those of `Shutter`."""

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
            board: the board that triggers it, and whose laser and mirror it sees.
            shutter: the board's shutter, see `BenchBoard.shutter` and `Wiring.shutter`.
            render: makes the image of an exposure, from what the board did meanwhile and the camera's settings.
            latency: time from the end of the exposure to the arrival [s].
            fps: highest frame rate [1/s]; 0: as fast as exposure and read-out allow.
            clock_offset: offset of the camera's clock [s].
            clock_drift: relative error of the clock's rate; positive: it runs fast.
            name: name of the camera in messages.
        """
        self.name = name
        self._shortest = 1.0 / fps if fps > 0 else 0.0
        self._learn_limits(shutter.exposure, latency)
        self.dropped: frozenset[int] = frozenset()
        """Numbers of the frames, from 0, that are lost on their way."""
        self.automatic: set[str] = set()
        """Settings that another program has switched to automatic again; only `held` reports them."""
        self._board, self._shutter, self._render = board, shutter, render
        self._latency, self._clock_offset, self._clock_drift = latency, clock_offset, clock_drift
        self._settings = CameraSettings(exposure=shutter.exposure, gain=1.0, white_balance=5000.0, gamma=1.0)
        self._next: int | None = None

    def open(self) -> None:
        """Wait for triggers; does nothing when open."""
        if self._next is None:
            self._next = len(self._board.openings())

    def close(self) -> None:
        """Stop."""
        self._next = None

    def lock(self, settings: CameraSettings) -> CameraSettings:
        """Take the exposure; the other settings are fixed."""
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
            CameraTimeout: none arrives in time.
            CameraNotOpen: open it first.
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
        """Forget what has arrived."""
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
