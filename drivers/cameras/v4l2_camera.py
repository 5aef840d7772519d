"""V4L2 cameras through linuxpy: grey or YUYV (no MJPEG), with frame numbers and times from the kernel."""

from __future__ import annotations

import importlib
import select
import time
from typing import Any

import numpy as np

from drivers.cameras.camera import Camera, CameraSettings, HeldSettings, check_held, opened
from drivers.cameras.usb_identity import usb_identity
from drivers.errors import (
    CameraBackendMissing,
    CameraEnded,
    CameraError,
    CameraNotFound,
    CameraSettingRefused,
    CameraTimeout,
)
from drivers.frame import Frame, Image

BUFFERS = 8
# Accepted pixel formats, in order of preference. Every second byte of YUYV is the luminance.
PIXEL_FORMATS = ("GREY", "YUYV")
# Flag of a buffer with a damaged image, and modulus of the frame numbers.
DAMAGED, NUMBERS = 0x40, 1 << 32
# Unit of the exposure control [s], and relative tolerance of values that the driver may have rounded.
EXPOSURE_UNIT, TOLERANCE = 1e-4, 0.05
MANUAL_EXPOSURE = 1
# Per setting: control, unit of the control, control of the automatic mode, value that turns this mode off.
CONTROLS: dict[str, tuple[str, float, str, int]] = {
    "exposure": ("exposure_time_absolute", EXPOSURE_UNIT, "auto_exposure", MANUAL_EXPOSURE),
    "gain": ("gain", 1.0, "", 0),
    "white_balance": ("white_balance_temperature", 1.0, "white_balance_automatic", 0),
    "gamma": ("gamma", 1.0, "", 0),
}


class V4l2Camera(Camera):
    """Camera of the Linux video interface. Frames are (height, width) uint8 and are returned in order of exposure.

    Frame numbers and monotonic stamps come from the kernel. Lost and damaged frames leave gaps in the frame counter.
    """

    counts_frames = True

    def __init__(
        self,
        path: str = "/dev/video0",
        *,
        pixel_format: str | None = None,
        size: tuple[int, int] | None = None,
        fps: float | None = None,
        lag: float | None = None,
        video: Any = None,
    ) -> None:
        """Prepare the camera; nothing is opened yet.

        Args:
            path: path of the device.
            pixel_format: one of PIXEL_FORMATS; None = the first one that the camera supports.
            size: (width, height); None = the camera's current size.
            fps: frame rate [Hz]; None = the camera's current rate.
            lag: see `Camera`.
            video: module that replaces `linuxpy.video.device`; None = linuxpy.

        Raises:
            ValueError: the pixel format is not one of PIXEL_FORMATS.
        """
        if pixel_format is not None and pixel_format not in PIXEL_FORMATS:
            raise ValueError(f"pixel format is {pixel_format!r}, allowed: {', '.join(PIXEL_FORMATS)}")
        self.name = f"camera v4l2:{path}"
        self.lag = lag
        self._path, self._wanted, self._size, self._fps, self._video = path, pixel_format, size, fps, video
        self._device: Any = None
        self._capture: Any = None
        self._format: Any = None
        self._counter, self._last = -1, 0

    def open(self) -> None:
        """Open the device and start the acquisition; does nothing if the camera is open.

        Raises:
            CameraBackendMissing: linuxpy is not installed.
            CameraNotFound: the device does not exist or cannot be opened, or another program uses it.
            CameraSettingRefused: the camera lacks the pixel format or the size.
        """
        if self._capture is not None:
            return
        video = self._video or _load()
        try:
            self._device = video.Device(self._path)
            self._device.open()
            capture = video.VideoCapture(self._device, size=BUFFERS)
            self._set_format(capture)
            capture.open()
        except OSError as error:
            self.close()
            raise CameraNotFound(
                f"{self.name} cannot be opened ({error.strerror}): check path and cable, that your user is in group "
                "`video`, and that no other program uses it"
            ) from None
        except BaseException:
            self.close()
            raise
        self._capture, self._counter = capture, -1
        self.identity = usb_identity(self._path)

    def close(self) -> None:
        """Stop and release the device; does nothing if it is closed."""
        capture, self._capture = self._capture, None
        device, self._device = self._device, None
        if capture is not None:
            capture.close()
        if device is not None:
            device.close()

    def lock(self, settings: CameraSettings) -> CameraSettings:
        """Turn automatic modes off, apply the settings, and return the values read back.

        Raises:
            CameraSettingRefused: the camera lacks a setting, or reports a different value.
            CameraError: the camera rejects a value or does not respond.
            CameraNotOpen: the camera is not open.
        """
        opened(self._capture, self)
        held = {}
        for name, wanted in settings.given().items():
            control, unit, switch, off = CONTROLS[name]
            if switch:
                self._set(switch, off)
            held[name] = self._set(control, wanted / unit) * unit
        return CameraSettings(**held)

    def held(self, locked: CameraSettings) -> HeldSettings:
        """Read the locked settings and their automatic modes back; errors as in `Camera.held`."""
        opened(self._capture, self)
        controls = self._device.controls
        values, automatic = {}, []
        try:
            for name in locked.given():
                control, unit, switch, off = CONTROLS[name]
                values[name] = float(controls[control].value) * unit
                if switch and int(controls[switch].value) != off:
                    automatic.append(name)
        except OSError as error:
            raise self._ended(error) from None
        return HeldSettings(values=values, automatic=tuple(automatic))

    def grab(self, timeout: float) -> Frame:
        """Return the oldest frame; damaged frames are skipped and leave gaps in the counter. See `Camera.grab`."""
        capture = opened(self._capture, self)
        deadline = time.monotonic() + timeout
        while True:
            if not select.select([self._device], [], [], max(0.0, deadline - time.monotonic()))[0]:
                raise CameraTimeout(f"{self.name} delivered no frame within {timeout:g} s")
            try:
                taken = capture.buffer.raw_read()
            except OSError as error:
                raise self._ended(error) from None
            if taken.buff.flags & DAMAGED:
                continue
            self._counter = 0 if self._counter < 0 else self._counter + (taken.frame_nb - self._last) % NUMBERS
            self._last = taken.frame_nb
            return Frame(self._grey(taken.data), self._counter, taken.timestamp)

    def flush(self) -> None:
        """Discard waiting frames; CameraEnded if the camera was disconnected."""
        capture = opened(self._capture, self)
        try:
            while select.select([self._device], [], [], 0)[0]:
                capture.buffer.raw_read()
        except OSError as error:
            raise self._ended(error) from None

    def _ended(self, error: OSError) -> CameraEnded:
        return CameraEnded(f"{self.name} was disconnected ({error.strerror}): check its cable, then open it again")

    def _set_format(self, capture: Any) -> None:
        names = [entry.pixel_format.name for entry in capture.formats()]
        usable = [name for name in PIXEL_FORMATS if name in names and self._wanted in (None, name)]
        if not usable:
            raise CameraSettingRefused(
                f"{self.name} has the pixel formats {', '.join(names)}; allowed: "
                f"{self._wanted or ' or '.join(PIXEL_FORMATS)}. OpenCV reads other formats: give the path without "
                "`v4l2:`"
            )
        current = capture.get_format()
        size = self._size or (current.width, current.height)
        capture.set_format(*size, usable[0])
        self._format = capture.get_format()
        got = (self._format.width, self._format.height)
        if got != size or self._format.pixel_format.name != usable[0]:
            raise CameraSettingRefused(
                f"{self.name} was asked for {size[0]} x {size[1]} pixels of {usable[0]}, but delivers "
                f"{got[0]} x {got[1]} of {self._format.pixel_format.name}: see `v4l2-ctl --list-formats-ext`"
            )
        if self._fps is not None:
            capture.set_fps(self._fps)

    def _grey(self, data: bytes) -> Image:
        width, height = self._format.width, self._format.height
        pixel_bytes = 2 if self._format.pixel_format.name == "YUYV" else 1
        line = self._format.bytes_per_line or pixel_bytes * width
        rows = np.frombuffer(data, np.uint8, count=line * height).reshape(height, line)
        image: Image = rows[:, : pixel_bytes * width : pixel_bytes].copy()
        image.setflags(write=False)
        return image

    def _set(self, name: str, value: float) -> float:
        try:
            control = self._device.controls[name]
        except KeyError:
            raise CameraSettingRefused(
                f"{self.name} has no setting {name} (asked for {value:g}): leave it out (see `v4l2-ctl -L`)"
            ) from None
        try:
            control.value = round(value)
            held = float(control.value)
        except OSError as error:
            raise CameraError(
                f"{self.name} cannot set {name} to {value:g} ({error.strerror}): check its cable, and `v4l2-ctl -L`"
            ) from None
        # Rounding to integers is always allowed, because controls are integers.
        check_held(self.name, name, value, held, max(TOLERANCE * abs(value), 0.5), " (`v4l2-ctl -L`)")
        return held


def _load() -> Any:
    try:
        return importlib.import_module("linuxpy.video.device")
    except ImportError:
        raise CameraBackendMissing("the V4L2 camera driver needs linuxpy: pip install linuxpy") from None
