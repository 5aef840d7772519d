"""`FakeGigeCamera`: starts the process of the fake camera, triggers it, and supplies its images."""

from __future__ import annotations

import subprocess
import sys
import threading
from dataclasses import dataclass
from types import TracebackType
from typing import Self

import numpy as np

from drivers.cameras.bayer import PATTERNS, mosaic
from drivers.errors import CameraNotFound
from drivers.frame import Image
from testbed.gige.genicam import FORMATS
from testbed.gige.wire import ASK, EXPOSE, REQUEST, STATE, read_exactly

RED = 2
NAMES = {number: name for name, number in FORMATS.items()}
# Longest wait for the process to end by itself [s].
GOODBYE = 5.0


@dataclass(frozen=True, slots=True)
class FakeState:
    """Settings of the fake camera.

    Attributes:
        size: width and height of the frames [px].
        pixel_format: name of the pixel format.
        exposure: exposure time [s].
        gain: gain [dB].
        shows_exposure: True if the output line is active during exposures.
    """

    size: tuple[int, int]
    pixel_format: str
    exposure: float
    gain: int
    shows_exposure: bool


class FakeGigeCamera:
    """Emulated camera on loopback, which exists during the `with` block; thread-safe.

    `AravisCamera(fake.name, trigger="Line1")` opens the camera.
    """

    def __init__(
        self,
        *,
        serial: str = "GUARA1",
        interface: str = "127.0.0.1",
        size: tuple[int, int] = (640, 512),
        lost_packets: float = 0.0,
    ) -> None:
        """Store the settings; the camera starts with the `with` block.

        Args:
            serial: serial number of the camera.
            interface: address of the network interface.
            size: width and height of the sensor [px].
            lost_packets: share of packets that are lost.
        """
        self._command = [sys.executable, "-m", "testbed.gige", "--interface", interface, "--serial", serial]
        self._command += ["--width", str(size[0]), "--height", str(size[1])]
        self._command += ["--lost-packets", str(lost_packets)]
        self.name = interface
        """Name by which `AravisCamera` opens it."""
        self._process: subprocess.Popen[bytes] | None = None
        self._lock = threading.Lock()

    def __enter__(self) -> Self:
        """Start the process of the camera.

        Raises:
            CameraBackendMissing: Aravis is not installed.
            CameraNotFound: the process cannot start.
        """
        from drivers.cameras.aravis_library import load_aravis

        load_aravis()
        self._process = subprocess.Popen(
            self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE
        )
        assert self._process.stdout is not None and self._process.stderr is not None
        if read_exactly(self._process.stdout, STATE.size) is None:
            reason = self._process.stderr.read().decode(errors="replace").strip()
            self.__exit__(None, None, None)
            raise CameraNotFound(f"the fake GigE camera did not start: {reason}")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the process of the camera."""
        process, self._process = self._process, None
        if process is None:
            return
        for stream in (process.stdin, process.stdout, process.stderr):
            assert stream is not None
            stream.close()
        try:
            process.wait(GOODBYE)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()

    @property
    def state(self) -> FakeState:
        """Current settings."""
        return self._ask(ASK)[1]

    def expose(self, picture: Image, taken_at: float) -> bool:
        """Trigger an exposure; return True if the camera was waiting for the trigger and sends the image.

        Args:
            picture: (height, width, 3) BGR or (height, width), uint8. A mono camera delivers the red channel of a
                colour image, as behind a band-pass filter; a Bayer camera delivers its mosaic.
            taken_at: start of the exposure on the camera's clock [s].
        """
        state = self.state
        if picture.shape[:2] != state.size[::-1]:
            return False
        if picture.ndim == 3:
            in_colours = state.pixel_format in PATTERNS
            picture = mosaic(picture, state.pixel_format) if in_colours else picture[:, :, RED]
        return self._ask(EXPOSE, round(taken_at * 1e9), np.ascontiguousarray(picture).tobytes())[0]

    def _ask(self, kind: bytes, taken_at: int = 0, picture: bytes = b"") -> tuple[bool, FakeState]:
        with self._lock:
            process = self._process
            if process is None or process.stdin is None or process.stdout is None:
                raise CameraNotFound("the fake GigE camera is not running: use `with fake:`")
            process.stdin.write(REQUEST.pack(kind, taken_at, len(picture)) + picture)
            process.stdin.flush()
            answer = read_exactly(process.stdout, STATE.size)
        if answer is None:
            raise CameraNotFound("the process of the fake GigE camera has ended")
        done, width, height, pixel_format, exposure, gain, line = STATE.unpack(answer)
        return bool(done), FakeState((width, height), NAMES[pixel_format], exposure * 1e-6, gain, bool(line))
