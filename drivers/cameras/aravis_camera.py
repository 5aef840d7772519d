"""GigE Vision and USB3 Vision cameras through Aravis: triggered or free-running, raw frames, device timestamps."""

from __future__ import annotations

import logging
import time
from typing import Any

import numpy as np

from drivers import timing
from drivers.cameras.aravis_library import glib_error, load_aravis
from drivers.cameras.aravis_settings import held_settings, lock_settings
from drivers.cameras.bayer import PATTERNS, red_pixels
from drivers.cameras.camera import Camera, CameraSettings, HeldSettings, opened
from drivers.errors import CameraEnded, CameraError, CameraNotFound, CameraSettingRefused, CameraTimeout
from drivers.frame import Frame, Image

logger = logging.getLogger(__name__)
# Number of buffers: enough that no frame is lost while the host is busy for 0.2 s at 120 frames per second.
BUFFERS = 24
# Accepted pixel formats, one byte per pixel, in order of preference; names of the Pixel Format Naming Convention.
MONO = "Mono8"
BAYER = ("BayerRG8", "BayerGR8", "BayerGB8", "BayerBG8")
PIXEL_FORMATS = (MONO, *BAYER)
# Block ids of GigE Vision 1.x run from 1 to 65535 and wrap to 1.
SHORT_IDS = 65535
# Minimum time from the end of an exposure to the start of the next [s]; the camera's maximum frame rate may require
# more.
READ_OUT = 0.0002


class AravisCamera(Camera):
    """GenICam camera with (height, width) uint8 frames: grey, red pixels of a Bayer mosaic, or all its pixels (`raw`).

    The red pixels form an image of half the width and height. Only they see a red laser; interpolation between them
    takes time and increases the errors (`python -m benchmarks light mosaics`).

    Complete frames are returned in the order of exposure. A frame with lost packets is dropped, which leaves a gap in
    the frame counter.

    Attributes:
        pixel_format: pixel format of the frames; empty before `open`.
    """

    counts_frames = True

    def __init__(
        self,
        device: str = "",
        *,
        trigger: str | None = None,
        exposure_output: str | None = None,
        pixel_format: str | None = None,
        size: tuple[int, int] | None = None,
        fps: float | None = None,
        lag: float | None = None,
        raw: bool = False,
    ) -> None:
        """Prepare the camera; nothing is opened yet.

        Args:
            device: name of the camera (see `find_aravis_cameras`) or network address; "" = the first one found.
            trigger: input line connected to the board's TRIGGER, such as "Line1", whose rising edge starts an exposure;
                None = free-running.
            exposure_output: output line connected to the board's EXPOSURE_ACTIVE, such as "Line2", which is active
                during exposure; None = output lines are not configured.
            pixel_format: one of PIXEL_FORMATS; None = grey if available, otherwise a Bayer mosaic.
            size: (width, height) of the frames, centred on the sensor; None = the whole sensor.
            fps: frame rate of a free-running camera [Hz]; None = unchanged.
            lag: see `Camera`.
            raw: return all pixels of a mosaic instead of the red ones.

        Raises:
            ValueError: unknown pixel format.
        """
        if pixel_format is not None and pixel_format not in PIXEL_FORMATS:
            raise ValueError(f"pixel format is {pixel_format!r}, allowed: {', '.join(PIXEL_FORMATS)}")
        self.name = f"camera aravis:{device}" if device else "camera aravis"
        self.triggered = trigger is not None
        self.lag = lag
        self._wanted, self._trigger, self._exposure_output = device, trigger, exposure_output
        self._wanted_format, self._size, self._fps = pixel_format, size, fps
        self._raw = raw
        self._aravis: Any = None
        self._camera: Any = None
        self._stream: Any = None
        self._counter, self._last_id = -1, 0
        self.pixel_format = ""

    def open(self) -> None:
        """Find the camera, configure it and start the acquisition; does nothing if the camera is open.

        Raises:
            CameraBackendMissing: Aravis or its Python binding cannot be loaded.
            CameraNotFound: there is no such camera, or another program uses it.
            CameraSettingRefused: the camera cannot be set up; for example, it lacks the trigger line, the output line,
                the size or the pixel format.
        """
        if self._camera is not None:
            return
        self._aravis = load_aravis()
        try:
            self._camera = self._find()
            self._set_up(self._camera)
        except glib_error() as error:
            self.close()
            raise CameraSettingRefused(f"{self.name} cannot be set up: {_text_of(error)}") from None
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Stop and release the camera."""
        camera, self._camera = self._camera, None
        if camera is not None and self._stream is not None:
            try:
                camera.stop_acquisition()
            except glib_error() as error:
                logger.warning("%s: %s", self.name, _text_of(error))
        self._stream = None

    def lock(self, settings: CameraSettings) -> CameraSettings:
        """Turn automatic modes off, apply the settings, and return the values read back; see `lock_settings`.

        Raises:
            CameraSettingRefused: the camera lacks a setting, does not allow a value, or reads back another value.
            CameraError: the camera does not respond or reports an error.
            CameraNotOpen: the camera is not open.
        """
        camera = opened(self._camera, self)
        try:
            held = lock_settings(camera, self._aravis, settings, self.name)
            self._learn_period(camera)
        except glib_error() as error:
            raise CameraError(f"{self.name} cannot be set ({_text_of(error)}): check its cable and power") from None
        return held

    def held(self, locked: CameraSettings) -> HeldSettings:
        """Read the locked settings and their automatic modes back from the camera.

        Raises:
            CameraEnded: the camera does not respond.
            CameraNotOpen: the camera is not open.
        """
        camera = opened(self._camera, self)
        try:
            return held_settings(camera, self._aravis, locked)
        except glib_error() as error:
            raise CameraEnded(
                f"{self.name} does not respond ({_text_of(error)}): check its cable and power, then open it again"
            ) from None

    def grab(self, timeout: float) -> Frame:
        """Return the oldest complete frame.

        Raises:
            CameraTimeout: no complete frame arrived in time; also raised after a USB camera was disconnected.
            CameraEnded: a network camera was disconnected.
            CameraNotOpen: the camera is not open.
        """
        opened(self._camera, self)
        deadline = time.monotonic() + timeout
        while True:
            left = max(0.0, deadline - time.monotonic())
            buffer = self._stream.timeout_pop_buffer(round(left * 1e6)) if left else self._stream.try_pop_buffer()
            if buffer is None:
                if self._is_gone():
                    raise CameraEnded(f"{self.name} was disconnected: check its cable and power, then open it again")
                raise CameraTimeout(f"{self.name} delivered no frame within {timeout:g} s")
            frame = self._frame(buffer)
            self._stream.push_buffer(buffer)
            if frame is not None:
                return frame

    @property
    def waiting(self) -> int:
        """Number of frames, complete or not, that are waiting to be read."""
        opened(self._camera, self)
        return int(self._stream.get_n_buffers()[1])

    def flush(self) -> None:
        """Discard waiting frames."""
        opened(self._camera, self)
        while (buffer := self._stream.try_pop_buffer()) is not None:
            self._stream.push_buffer(buffer)

    def _find(self) -> Any:
        self._aravis.update_device_list()
        try:
            camera = self._aravis.Camera.new(self._wanted or None)
        except glib_error() as error:
            raise self._not_there(_text_of(error)) from None
        if camera.is_gv_device() and not camera.get_device().is_controller():
            raise self._not_there("control access was denied")
        return camera

    def _not_there(self, reason: str) -> CameraNotFound:
        return CameraNotFound(
            f"{self.name} cannot be opened ({reason}): `guara doctor --cameras` lists the cameras found; check cable, "
            "power and network address, and that no other program uses it"
        )

    def _set_up(self, camera: Any) -> None:
        if camera.get_device_id():
            self.name = f"camera aravis:{camera.get_device_id()}"
        names, serial = (camera.get_vendor_name(), camera.get_model_name()), camera.get_device_serial_number()
        self.identity = " ".join(filter(None, names)) + (f", serial {serial}" if serial else "")
        camera.set_acquisition_mode(self._aravis.AcquisitionMode.CONTINUOUS)
        self._choose_format(camera)
        self._choose_region(camera)
        if self._exposure_output is not None:
            self._wire_exposure_output(camera, self._exposure_output)
        if self._trigger is None:
            camera.clear_triggers()
            if self._fps is not None:
                camera.set_frame_rate(self._fps)
        else:
            _check_choice("trigger", self._trigger, camera.dup_available_trigger_sources(), self.name)
            camera.set_trigger(self._trigger)
        self._learn_period(camera)
        self._begin(camera)

    def _wire_exposure_output(self, camera: Any, line: str) -> None:
        for feature, value in {"LineSelector": line, "LineMode": "Output", "LineSource": "ExposureActive"}.items():
            if not camera.is_feature_available(feature):
                raise CameraSettingRefused(
                    f"{self.name} has no {feature}: leave exposure_output out, and set its output to ExposureActive "
                    "with the manufacturer's software"
                )
            _check_choice(feature, value, camera.dup_available_enumerations_as_strings(feature), self.name)
            camera.set_string(feature, value)

    def _choose_format(self, camera: Any) -> None:
        there = camera.dup_available_pixel_formats_as_strings()
        usable = [name for name in PIXEL_FORMATS if name in there]
        if self._wanted_format is not None:
            _check_choice("pixel format", self._wanted_format, usable, self.name)
        elif not usable:
            raise CameraSettingRefused(
                f"{self.name} has the pixel formats {', '.join(there)}; allowed: {', '.join(PIXEL_FORMATS)}"
            )
        self.pixel_format = self._wanted_format or usable[0]
        camera.set_pixel_format_from_string(self.pixel_format)

    @property
    def _takes_red(self) -> bool:
        return self.pixel_format in PATTERNS and not self._raw

    def _choose_region(self, camera: Any) -> None:
        sensor = tuple(camera.get_sensor_size())
        scale = 2 if self._takes_red else 1
        width, height = sensor if self._size is None else (scale * self._size[0], scale * self._size[1])
        # An offset by an odd number of rows or columns would change the pattern of the mosaic.
        left, top = ((sensor[axis] - (width, height)[axis]) // 2 // 2 * 2 for axis in (0, 1))
        if left < 0 or top < 0:
            raise CameraSettingRefused(
                f"{self.name} was asked for {width} x {height} pixels, but its sensor has {sensor[0]} x {sensor[1]}"
            )
        camera.set_region(left, top, width, height)
        got = tuple(camera.get_region())[2:]
        if got != (width, height):
            raise CameraSettingRefused(
                f"{self.name} was asked for {width} x {height} pixels, but delivers {got[0]} x {got[1]}"
            )

    def _learn_period(self, camera: Any) -> None:
        exposure = camera.get_exposure_time() * 1e-6 if camera.is_exposure_time_available() else 0.0
        fastest = float(camera.get_frame_rate_bounds()[1]) if camera.is_frame_rate_available() else 0.0
        self.trigger_period = max(exposure + READ_OUT, 1.0 / fastest if fastest > 0 else 0.0)

    def _begin(self, camera: Any) -> None:
        self._counter, self._last_id = -1, 0
        self._stream = camera.create_stream(None, None)
        payload = camera.get_payload()
        for _ in range(BUFFERS):
            self._stream.push_buffer(self._aravis.Buffer.new_allocate(payload))
        camera.start_acquisition()

    def _is_gone(self) -> bool:
        """Return True if a network camera no longer answers its heartbeat, False for other cameras."""
        # Aravis's signal for this would deadlock: closing the camera joins the signal's thread while holding the GIL.
        return self._camera.is_gv_device() and not self._camera.get_device().is_controller()

    def _frame(self, buffer: Any) -> Frame | None:
        """Convert a buffer to a frame; None if the buffer is incomplete."""
        if buffer.get_status() != self._aravis.BufferStatus.SUCCESS:
            logger.info("%s: dropped a frame with status %s", self.name, buffer.get_status().value_nick)
            return None
        stamp = timing.monotonic()
        if not self.triggered:
            # Subtract the time that the frame has waited to be read.
            stamp -= max(0.0, time.time() - buffer.get_system_timestamp() * 1e-9)
        shape = (buffer.get_image_height(), buffer.get_image_width())
        # `get_data` copies, so the frame owns its memory.
        image: Image = np.frombuffer(buffer.get_data(), np.uint8, count=shape[0] * shape[1]).reshape(shape)
        if self._takes_red:
            image = red_pixels(image, self.pixel_format)
            image.setflags(write=False)
        self._count(buffer.get_frame_id())
        taken = buffer.get_timestamp()
        return Frame(image, self._counter, stamp, taken * 1e-9 if taken else None)

    def _count(self, number: int) -> None:
        """Continue the counter across the wrap of the camera's block ids."""
        if self._counter < 0:
            self._counter = 0
        elif number > self._last_id:
            self._counter += number - self._last_id
        else:
            self._counter += (number - self._last_id) % SHORT_IDS
        self._last_id = number


def _check_choice(what: str, value: str, allowed: list[str], name: str) -> None:
    if value not in allowed:
        raise CameraSettingRefused(f"{name} was asked for {what} {value!r}; allowed: {', '.join(allowed)}")


def _text_of(error: Exception) -> str:
    return str(getattr(error, "message", error))
