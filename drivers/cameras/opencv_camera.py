"""Cameras, video files and image sequences through OpenCV's VideoCapture (V4L2, GStreamer, FFmpeg, images).

The OpenCV wheels on PyPI have neither a FireWire (DC1394) nor a GenICam (Aravis) backend. A FireWire camera, such as
that of the original robot, needs other software; see docs/drivers.md, "FireWire cameras".
"""

from __future__ import annotations

import logging
import threading
from pathlib import Path
from typing import Any

from drivers import timing
from drivers.cameras.camera import Camera, CameraSettings, HeldSettings, check_held, opened
from drivers.cameras.usb_identity import usb_identity
from drivers.errors import (
    CameraBackendMissing,
    CameraEnded,
    CameraNotFound,
    CameraSettingRefused,
    CameraTimeout,
)
from drivers.frame import Frame

logger = logging.getLogger(__name__)
# Longest wait for a read in progress when closing [s]; OpenCV aborts a V4L2 read after 10 s.
LONGEST_READ = 15.0
BACKENDS = {"any": "CAP_ANY", "v4l2": "CAP_V4L2", "gstreamer": "CAP_GSTREAMER", "ffmpeg": "CAP_FFMPEG"}
BACKENDS |= {"images": "CAP_IMAGES", "firewire": "CAP_FIREWIRE"}
FIREWIRE_HELP = (
    "this OpenCV has no FireWire backend (no pip wheel has one): see docs/drivers.md, 'FireWire cameras', "
    "for alternatives"
)
V4L2_MANUAL_EXPOSURE = 1.0
# Per setting: property, unit of the property, name in messages, property of the automatic mode, value that turns it
# off.
CONTROLS = {
    "exposure": ("CAP_PROP_EXPOSURE", 1e-4, "exposure [100 us]", "CAP_PROP_AUTO_EXPOSURE", V4L2_MANUAL_EXPOSURE),
    "gain": ("CAP_PROP_GAIN", 1.0, "gain", "", 0.0),
    "white_balance": ("CAP_PROP_WB_TEMPERATURE", 1.0, "white balance [K]", "CAP_PROP_AUTO_WB", 0.0),
    "gamma": ("CAP_PROP_GAMMA", 1.0, "gamma", "", 0.0),
}
# Relative tolerances of values that the driver may have rounded.
TOLERANCE = 0.02
EXPOSURE_TOLERANCE = 0.05


class OpenCvCamera(Camera):
    """Camera, video file or image sequence read by OpenCV.

    A live camera is read by a background thread that keeps only the newest frame. Therefore `grab` has a timeout,
    unlike OpenCV's read, and frames do not wait in a driver queue. A file is read in `grab`, and no frame is dropped.
    """

    def __init__(
        self,
        source: int | str | Path,
        *,
        backend: str = "any",
        size: tuple[int, int] | None = None,
        fps: float | None = None,
        lag: float | None = None,
    ) -> None:
        """Prepare the camera; nothing is opened yet.

        Args:
            source: number of a camera, path of a device ("/dev/video0"), a video file or an image sequence
                ("frame_%03d.png"), URL of a stream, or a GStreamer pipeline.
            backend: "any", "v4l2", "gstreamer", "ffmpeg", "images" or "firewire". With "ffmpeg" and "images", every
                source except a camera number is read like a file.
            size: required (width, height) of a live camera; None = the camera's default. Ignored for files.
            fps: requested frame rate of a live camera [Hz]; None = the camera's default. Ignored for files.
            lag: see `Camera`; None means 0 for a file.

        Raises:
            ValueError: unknown backend.
        """
        if backend not in BACKENDS:
            raise ValueError(f"unknown backend {backend!r}, allowed: {', '.join(BACKENDS)}")
        self.name = f"camera {source}"
        self._source = source
        self._backend, self._size, self._fps = backend, size, fps
        self._is_file = _is_file(source, backend)
        self.lag = 0.0 if self._is_file and lag is None else lag
        self._capture: Any = None
        self._counter = 0
        self._newest: Frame | None = None
        self._failed = False
        self._changed = threading.Condition()
        self._reader: threading.Thread | None = None
        self._stop = threading.Event()

    def open(self) -> None:
        """Open the source; does nothing if it is open.

        Raises:
            CameraBackendMissing: the installed OpenCV lacks the backend.
            CameraNotFound: the source cannot be opened.
            CameraSettingRefused: the camera delivers another size than required.
        """
        if self._capture is not None:
            return
        import cv2

        number = getattr(cv2, BACKENDS[self._backend])
        self._check_backend(cv2, number)
        capture = cv2.VideoCapture()
        source = self._source if isinstance(self._source, int) else str(self._source)
        if not capture.open(source, number):
            raise CameraNotFound(
                f"{self.name} cannot be opened (backend {self._backend}): check path and cable, and that your user is "
                "in group `video`"
            )
        self._capture = capture
        try:
            self._request_format(cv2, capture)
        except CameraSettingRefused:
            self.close()
            raise
        self._counter, self._failed, self._newest = 0, False, None
        if not self._is_file:
            self.identity = usb_identity(f"/dev/video{source}" if isinstance(source, int) else source)
            self._stop.clear()
            self._reader = threading.Thread(target=self._read_forever, name=self.name, daemon=True)
            self._reader.start()

    def close(self) -> None:
        """Stop reading and release the source."""
        self._stop.set()
        if self._reader is not None:
            self._reader.join(LONGEST_READ)
            if self._reader.is_alive():
                # Releasing a capture that another thread is reading crashes the process.
                logger.error("%s: a read does not return; its thread runs until the program ends", self.name)
                self._capture = None
            self._reader = None
        if self._capture is not None:
            self._capture.release()
            self._capture = None

    def lock(self, settings: CameraSettings) -> CameraSettings:
        """Lock exposure, gain, white balance and gamma of a live camera; see `lock_settings`."""
        capture = opened(self._capture, self)
        if self._is_file and settings != CameraSettings():
            raise CameraSettingRefused(f"{self.name} is a file, whose frames exist already: {settings} cannot be set")
        return lock_settings(capture, settings, self.name)

    def held(self, locked: CameraSettings) -> HeldSettings:
        """Read the locked settings back; see `held_settings`."""
        return held_settings(opened(self._capture, self), locked)

    def grab(self, timeout: float) -> Frame:
        """Return the next frame of a file, or the newest frame of a live camera; errors as in `Camera.grab`."""
        capture = opened(self._capture, self)
        if self._is_file:
            frame = self._read(capture)
            if frame is None:
                raise CameraEnded(f"{self.name} has no frames left ({self._counter} were read)")
            return frame
        with self._changed:
            self._changed.wait_for(lambda: self._newest is not None or self._failed, timeout)
            frame, self._newest = self._newest, None
            failed = self._failed
        if frame is None and failed:
            raise CameraEnded(f"{self.name} stopped delivering frames: check its cable, then open it again")
        if frame is None:
            raise CameraTimeout(f"{self.name} delivered no frame within {timeout:g} s")
        return frame

    def flush(self) -> None:
        """Discard the waiting frame of a live camera."""
        opened(self._capture, self)
        with self._changed:
            self._newest = None

    def _read(self, capture: Any) -> Frame | None:
        if not capture.grab():
            return None
        stamp = timing.monotonic()
        good, image = capture.retrieve()
        if not good:
            return None
        # The array belongs to this frame alone, so no view is needed to make it read-only.
        image.setflags(write=False)
        frame = Frame(image, self._counter, stamp)
        self._counter += 1
        return frame

    def _read_forever(self) -> None:
        capture = self._capture
        while not self._stop.is_set():
            try:
                frame = self._read(capture)
            except BaseException:  # grab() must report any end of this thread
                logger.exception("%s: OpenCV failed to read", self.name)
                frame = None
            with self._changed:
                self._newest = frame
                self._failed = frame is None
                self._changed.notify_all()
            if frame is None:
                return

    def _check_backend(self, cv2: Any, number: int) -> None:
        if self._backend == "any" or cv2.videoio_registry.hasBackend(number):
            return
        if self._backend == "firewire":
            raise CameraBackendMissing(FIREWIRE_HELP)
        raise CameraBackendMissing(
            f"the installed OpenCV {cv2.__version__} was built without {self._backend}: choose another backend, or "
            "install an OpenCV that has it (a Linux distribution's usually has GStreamer)"
        )

    def _request_format(self, cv2: Any, capture: Any) -> None:
        if self._is_file:
            return
        if self._size is not None:
            capture.set(cv2.CAP_PROP_FRAME_WIDTH, self._size[0])
            capture.set(cv2.CAP_PROP_FRAME_HEIGHT, self._size[1])
            got = (int(capture.get(cv2.CAP_PROP_FRAME_WIDTH)), int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT)))
            if got != tuple(self._size):
                raise CameraSettingRefused(
                    f"{self.name} was asked for {self._size[0]} x {self._size[1]} pixels, but delivers "
                    f"{got[0]} x {got[1]}: ask for a size that it offers (`v4l2-ctl --list-formats-ext`)"
                )
        if self._fps is not None:
            capture.set(cv2.CAP_PROP_FPS, self._fps)


def _is_file(source: int | str | Path, backend: str) -> bool:
    if isinstance(source, int) or backend in ("v4l2", "gstreamer", "firewire"):
        return False
    if backend in ("images", "ffmpeg"):
        return True
    path = str(source)
    return not path.startswith("/dev/") and "!" not in path and "://" not in path


def lock_settings(capture: Any, settings: CameraSettings, name: str) -> CameraSettings:
    """Turn automatic modes off, apply the settings, and return the values read back from the camera.

    Args:
        capture: open `cv2.VideoCapture`.
        settings: settings to apply; None entries are not changed.
        name: name of the camera, for messages.

    Raises:
        CameraSettingRefused: the camera lacks a setting, or reports a different value.
    """
    held = {}
    for setting, wanted in settings.given().items():
        prop, unit, what, switch, manual = CONTROLS[setting]
        if switch:
            _set(capture, switch, manual, f"manual {what.partition(' [')[0]}", name)
        tolerance = EXPOSURE_TOLERANCE if setting == "exposure" else TOLERANCE
        held[setting] = _set(capture, prop, wanted / unit, what, name, tolerance) * unit
    return CameraSettings(**held)


def held_settings(capture: Any, locked: CameraSettings) -> HeldSettings:
    """Read the locked settings back from the camera. A value of 0 or less, except gain 0, counts as not reported.

    Args:
        capture: open `cv2.VideoCapture`.
        locked: settings to read; None entries are not read.
    """
    import cv2

    values, automatic = {}, []
    for setting in locked.given():
        prop, unit, _, switch, manual = CONTROLS[setting]
        got = capture.get(getattr(cv2, prop))
        if got > 0 or (setting == "gain" and got == 0):
            values[setting] = got * unit
        if switch and capture.get(getattr(cv2, switch)) != manual:
            automatic.append(setting)
    return HeldSettings(values=values, automatic=tuple(automatic))


def _set(capture: Any, prop: str, value: float, what: str, name: str, tolerance: float = TOLERANCE) -> float:
    import cv2

    taken = capture.set(getattr(cv2, prop), value)
    got = float(capture.get(getattr(cv2, prop)))
    if not taken:
        raise CameraSettingRefused(
            f"{name} has no setting {what} (asked for {value:g}): leave it out, or set it with "
            "the manufacturer's tool (see `v4l2-ctl -L`)"
        )
    # Rounding to integers is always allowed: most V4L2 controls are integers.
    check_held(name, what, value, got, max(tolerance * abs(value), 0.5), " (`v4l2-ctl -L`)")
    return got
