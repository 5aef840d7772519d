"""Camera that plays the frames of an iterable: of a scan, a recording, a generator."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from drivers import timing
from drivers.arrays import Image
from drivers.cameras.camera import Camera, CameraSettings, opened
from drivers.errors import CameraEnded, CameraSettingRefused, CameraTimeout
from drivers.frame import Frame, read_only


class ReplayCamera(Camera):
    """Plays frames in their order; each grab takes the next, so nothing is ever dropped.

    It opens no files: the caller opens a scan (a folder) or a recording (MCAP) and gives its frames as an iterable.
    Frames must come in the order in which `acquire` asks for them. An iterable that can be iterated again (a list)
    starts over when the camera is reopened.
    """

    lag = 0.0

    def __init__(self, frames: Iterable[Image | Frame], *, fps: float | None = None, name: str = "replay") -> None:
        """Prepare the camera.

        Args:
            frames: images, numbered from 0; or frames, which keep their numbers. All are stamped when they are grabbed.
            fps: frames per second at which images become available; None: at once.
            name: name of the camera, for messages.

        Raises:
            ValueError: fps is not above 0.
        """
        if fps is not None and not fps > 0:
            raise ValueError(f"fps is {fps}, it must be above 0 (None: without waiting)")
        self.name = name
        self._frames = frames
        self._period = 0.0 if fps is None else 1.0 / fps
        self._iterator: Iterator[Image | Frame] | None = None
        self._counter = 0
        self._due = 0.0

    def open(self) -> None:
        """Start at the first frame; does nothing when the camera is open."""
        if self._iterator is None:
            self._iterator = iter(self._frames)
            self._counter = 0
            self._due = timing.monotonic() + self._period

    def close(self) -> None:
        """Stop."""
        self._iterator = None

    def lock(self, settings: CameraSettings) -> CameraSettings:
        """Refuse every setting, since the frames are already taken; asking for none is fine.

        Raises:
            CameraSettingRefused: something was asked for.
        """
        if settings != CameraSettings():
            raise CameraSettingRefused(f"{self.name} replays frames already taken: {settings} cannot be set")
        return settings

    def grab(self, timeout: float) -> Frame:
        """The next frame.

        Raises:
            CameraTimeout: at this frame rate the next frame comes later than `timeout` [s].
            CameraEnded: there is no further frame.
            CameraNotOpen: the camera is not open.
        """
        frames = opened(self._iterator, self)
        wait = self._due - timing.monotonic()
        if wait > timeout:
            timing.sleep(timeout)
            raise CameraTimeout(f"{self.name} brought no frame within {timeout:g} s")
        if wait > 0:
            timing.sleep(wait)
        try:
            item = next(frames)
        except StopIteration:
            raise CameraEnded(f"{self.name} has no frame after the {self._counter} it played") from None
        self._due = max(self._due + self._period, timing.monotonic() - self._period)
        counter, self._counter = self._counter, self._counter + 1
        if isinstance(item, Frame):
            return Frame(item.image, item.counter, timing.monotonic())
        return Frame(read_only(item), counter, timing.monotonic())

    def flush(self) -> None:
        """Do nothing: a frame arrives only when it is grabbed."""
