"""Free-running emulated camera that renders the exposures of an emulated board."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, replace
from typing import Protocol

from drivers import timing
from drivers.arrays import Image
from drivers.cameras.camera import Camera, CameraSettings, HeldSettings, opened, wait_until_due
from drivers.emulator.views import ExposureView
from drivers.frame import Frame, read_only


class Exposes(Protocol):
    """Interface of a board that emulated cameras can see, such as `EmulatedBoard`."""

    def exposure(self, start: float, end: float) -> ExposureView:
        """Return the state of the board during an exposure from `start` to `end` [s]."""


class EmulatedCamera(Camera):
    """Emulated camera that exposes at a fixed rate; a slow reader receives only the newest frame.

    The exposure of frame n starts n / fps after `open`. The frame arrives `latency` after the end of its exposure.
    """

    def __init__(
        self,
        board: Exposes,
        render: Callable[[ExposureView, CameraSettings], Image],
        *,
        fps: float = 30.0,
        exposure: float = 0.008,
        latency: float = 0.008,
        name: str = "emulated camera",
        identity: str = "emulated camera, serial EMU0001",
    ) -> None:
        """Prepare the camera; `open` starts the exposures.

        Args:
            board: board whose laser and mirror the camera sees.
            render: renders the image of an exposure from the state of the board and the settings of the camera.
            fps: frame rate [Hz].
            exposure: initial exposure time [s].
            latency: time from the end of an exposure to the arrival of its frame [s].
            name: name of the camera in messages.
            identity: see `Camera`.

        Raises:
            ValueError: `fps` or `exposure` is not above 0, the exposure is longer than a frame period, or `latency` is
                negative.
        """
        if not (fps > 0 and 0 < exposure <= 1 / fps and latency >= 0):
            raise ValueError(
                f"fps {fps}, exposure {exposure} s, latency {latency} s: fps must be above 0, exposure above 0 and at "
                "most 1 / fps, latency at least 0"
            )
        self.name, self.identity = name, identity
        self._board, self._render = board, render
        self._period, self._latency = 1.0 / fps, latency
        self._settings = CameraSettings(exposure=exposure, gain=1.0, white_balance=5000.0, gamma=1.0)
        self._exposure, self._delay = exposure, exposure + latency
        self.lag = self._delay
        self._start: float | None = None
        self._next = 0

    def open(self) -> None:
        """Start exposing; does nothing if the camera is open."""
        if self._start is None:
            self._start, self._next = timing.monotonic(), 0

    def close(self) -> None:
        """Stop exposing."""
        self._start = None

    def lock(self, settings: CameraSettings) -> CameraSettings:
        """Accept all settings, but limit the exposure to the frame period, as real cameras do."""
        opened(self._start, self)
        given = settings.given()
        if "exposure" in given:
            given["exposure"] = self._exposure = min(given["exposure"], self._period)
            self._delay = self._exposure + self._latency
        self._settings = replace(self._settings, **given)
        self.lag = self._delay
        return self._settings

    def held(self, locked: CameraSettings) -> HeldSettings:
        """Report all settings of the camera, whatever was locked."""
        return HeldSettings(values=asdict(self._settings))

    def grab(self, timeout: float) -> Frame:
        """Return the next frame, or the newest one if several have arrived since the last grab.

        Raises:
            CameraTimeout: no frame arrives in time.
            CameraNotOpen: the camera is not open.
        """
        start = opened(self._start, self)
        asked = timing.monotonic()
        number = self._next_number(asked)
        wait_until_due(self, start + number * self._period + self._delay - asked, timeout)
        frame = self._expose(number, start)
        self._next = number + 1
        return frame

    def flush(self) -> None:
        """Discard the frames that have already arrived."""
        self._next = max(self._next, self._arrived(timing.monotonic()) + 1)

    def _arrived(self, now: float) -> int:
        return max(0, int((now - opened(self._start, self) - self._delay) / self._period))

    def _next_number(self, now: float) -> int:
        return max(self._next, self._arrived(now))

    def _expose(self, number: int, start: float) -> Frame:
        begin = start + number * self._period
        image = self._render(self._board.exposure(begin, begin + self._exposure), self._settings)
        return Frame(read_only(image), number, begin + self._delay)
