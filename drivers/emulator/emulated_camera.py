"""Free-running emulated camera that renders each exposure of an emulated board."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Protocol

from drivers import timing
from drivers.arrays import Image
from drivers.cameras.camera import Camera, CameraSettings, HeldSettings, opened
from drivers.emulator.views import ExposureView
from drivers.errors import CameraTimeout
from drivers.frame import Frame, read_only


class Exposes(Protocol):
    """Interface of a board that cameras can expose: `EmulatedBoard` or `RemoteBoard`."""

    def exposure(self, start: float, end: float) -> ExposureView:
        """View of an exposure from `start` to `end` [s]."""


@dataclass(frozen=True, slots=True)
class CameraFault:
    """Fault of the frames `first` ... `first + count - 1` of an `EmulatedCamera`.

    Attributes:
        kind: "drop" (the frame never arrives), "repeat" (the previous frame is repeated with its number), "freeze" (the
            previous image is repeated with a new number), "silence" (no frame arrives meanwhile), "resize" (half the
            size), "brighten" (twice the exposure).
        first: number of the first frame.
        count: number of frames.

    Raises:
        ValueError: unknown kind.
    """

    kind: str
    first: int
    count: int = 1

    def __post_init__(self) -> None:
        """Check the kind."""
        if self.kind not in KINDS:
            raise ValueError(f"unknown camera fault {self.kind!r}, allowed: {', '.join(KINDS)}")

    def holds(self, number: int) -> bool:
        """True if frame `number` has the fault."""
        return self.first <= number < self.first + self.count


KINDS = ("drop", "repeat", "freeze", "silence", "resize", "brighten")


class EmulatedCamera(Camera):
    """Camera that exposes at a fixed rate; a slow reader gets only the newest frame.

    Frame n is exposed from `start + n / fps` for `exposure` and arrives `latency` later.

    Attributes:
        faults: faults of its frames.
        automatic: settings in automatic mode, as if switched by another program; affects only `held`.
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
        """Prepare the camera.

        Args:
            board: the board whose laser and mirror it sees.
            render: renders the image of an exposure from the state of the board and the camera's settings.
            fps: frame rate [Hz].
            exposure: initial exposure time [s].
            latency: time from the end of the exposure to the arrival [s].
            name: name of the camera in messages.
            identity: see `Camera`.

        Raises:
            ValueError: fps or exposure is not above 0, or the exposure is longer than a frame.
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
        self.faults: list[CameraFault] = []
        self.automatic: set[str] = set()
        self._start: float | None = None
        self._next = 0
        self._last: Frame | None = None

    def open(self) -> None:
        """Start exposing; does nothing when open."""
        if self._start is None:
            self._start, self._next = timing.monotonic(), 0

    def close(self) -> None:
        """Stop."""
        self._start = None

    def lock(self, settings: CameraSettings) -> CameraSettings:
        """Accept all settings; an exposure longer than a frame is reduced to it, as by real cameras."""
        self._started()
        given = settings.given()
        if "exposure" in given:
            given["exposure"] = self._exposure = min(given["exposure"], self._period)
            self._delay = self._exposure + self._latency
        self._settings = replace(self._settings, **given)
        self.lag = self._delay
        return self._settings

    def held(self, locked: CameraSettings) -> HeldSettings:
        """Report all settings, and those in `automatic` as automatic."""
        return HeldSettings(values=asdict(self._settings), automatic=tuple(self.automatic))

    def grab(self, timeout: float) -> Frame:
        """Return the next frame, or the newest if several have arrived since the last grab.

        Raises:
            CameraTimeout: no frame in time.
            CameraNotOpen: the camera is not open.
        """
        start = self._started()
        asked = timing.monotonic()
        number = max(self._next, self._arrived(asked))
        for fault in sorted(self.faults, key=lambda fault: fault.first):
            if fault.kind in ("drop", "silence") and fault.holds(number):
                number = fault.first + fault.count
        wait = start + number * self._period + self._delay - asked
        if wait > timeout:
            timing.sleep(timeout)
            raise CameraTimeout(f"{self.name} brought no frame within {timeout:g} s")
        if wait > 0:
            timing.sleep(wait)
        frame = self._expose(number, start)
        self._next = number + 1
        self._last = frame
        return frame

    def flush(self) -> None:
        """Discard the frames that have arrived."""
        self._started()
        self._next = max(self._next, self._arrived(timing.monotonic()) + 1)

    def _started(self) -> float:
        return opened(self._start, self)

    def _arrived(self, now: float) -> int:
        return max(0, int((now - self._started() - self._delay) / self._period))

    def _expose(self, number: int, start: float) -> Frame:
        begin = start + number * self._period
        stamp = begin + self._delay
        kinds = {fault.kind for fault in self.faults if fault.holds(number)} if self.faults else ()
        if self._last is not None and "repeat" in kinds:
            return self._last
        if self._last is not None and "freeze" in kinds:
            return Frame(self._last.image, number, stamp)
        settings = self._settings
        if "brighten" in kinds:
            settings = replace(settings, exposure=2 * self._exposure)
        image = self._render(self._board.exposure(begin, begin + self._exposure), settings)
        if "resize" in kinds:
            image = image[::2, ::2]
        return Frame(read_only(image), number, stamp)
