"""Camera that plays the frames of an iterable, such as those of a scan or a recording."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from drivers import timing
from drivers.arrays import Image
from drivers.cameras.camera import Camera, CameraSettings, opened, wait_until_due
from drivers.errors import CameraEnded, CameraSettingRefused
from drivers.frame import Frame, read_only


class ReplayCamera(Camera):
    """Camera that returns the frames of an iterable in order, without dropping any.

    For a scan, the frames must be in the order in which `drivers.acquire` grabs them. If the iterable can be iterated
    again, like a list, the replay starts over when the camera is reopened.
    """

    lag = 0.0

    def __init__(self, frames: Iterable[Image | Frame], *, fps: float | None = None, name: str = "replay") -> None:
        """Prepare the camera.

        Args:
            frames: images, which are numbered from 0, or frames, which keep their numbers. All are stamped when they
                are grabbed.
            fps: rate at which the frames become available [Hz]; None = immediately.
            name: name of the camera in messages.

        Raises:
            ValueError: `fps` is not above 0.
        """
        if fps is not None and not fps > 0:
            raise ValueError(f"fps is {fps}; it must be above 0 (None: without waiting)")
        self.name = name
        self._frames = frames
        self._period = 0.0 if fps is None else 1.0 / fps
        self._iterator: Iterator[Image | Frame] | None = None
        self._counter = 0
        self._due = 0.0

    def open(self) -> None:
        """Start at the first frame; does nothing if the camera is open."""
        if self._iterator is None:
            self._iterator = iter(self._frames)
            self._counter = 0
            self._due = timing.monotonic() + self._period

    def close(self) -> None:
        """Stop the replay."""
        self._iterator = None

    def lock(self, settings: CameraSettings) -> CameraSettings:
        """Accept only empty settings, because the frames exist already.

        Raises:
            CameraSettingRefused: a setting is not None.
        """
        if settings != CameraSettings():
            raise CameraSettingRefused(f"{self.name} replays existing frames: {settings} cannot be set")
        return settings

    def grab(self, timeout: float) -> Frame:
        """Return the next frame.

        Raises:
            CameraTimeout: the next frame is not due within `timeout` [s].
            CameraEnded: there are no more frames.
            CameraNotOpen: the camera is not open.
        """
        frames = opened(self._iterator, self)
        wait_until_due(self, self._due - timing.monotonic(), timeout)
        try:
            item = next(frames)
        except StopIteration:
            raise CameraEnded(f"{self.name} has no frames left ({self._counter} were played)") from None
        self._due = max(self._due + self._period, timing.monotonic() - self._period)
        counter, self._counter = self._counter, self._counter + 1
        if isinstance(item, Frame):
            return Frame(item.image, item.counter, timing.monotonic())
        return Frame(read_only(item), counter, timing.monotonic())

    def flush(self) -> None:
        """Do nothing, because a replay drops no frames."""
