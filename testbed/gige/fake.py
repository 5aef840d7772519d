"""`FakeGigeCamera`: starts the process of the fake camera, pulls its trigger line and hands it pictures."""

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
# Seconds for the process to end by itself.
GOODBYE = 5.0


@dataclass(frozen=True, slots=True)
class FakeState:
    """How the fake camera is set.

    Attributes:
        size: width and height of its frames [px].
        pixel_format: name of their pixel format.
        exposure: exposure time [s].
        gain: gain [dB].
        shows_exposure: whether its output line shows when it exposes.
    """

    size: tuple[int, int]
    pixel_format: str
    exposure: float
    gain: int
    shows_exposure: bool


class FakeGigeCamera:
    """A camera on loopback while the `with` block lasts; thread-safe.

    `AravisCamera(fake.name, trigger="Line1")` opens it.
    """

    def __init__(
        self,
        *,
        serial: str = "GUARA1",
        interface: str = "127.0.0.1",
        size: tuple[int, int] = (640, 512),
        lost_packets: float = 0.0,
    ) -> None:
        """Prepare.

        Args:
            serial: number of the camera.
            interface: address of the network's interface.
            size: width and height of the sensor [px].
            lost_packets: share of the packets that never arrive.
        """
        self._command = [sys.executable, "-m", "testbed.gige", "--interface", interface, "--serial", serial]
        self._command += ["--width", str(size[0]), "--height", str(size[1])]
        self._command += ["--lost-packets", str(lost_packets)]
        self.name = interface
        """Name by which `AravisCamera` opens it."""
        self._process: subprocess.Popen[bytes] | None = None
        self._lock = threading.Lock()

    def __enter__(self) -> Self:
        """Start its process.

        Raises:
            CameraBackendMissing: Aravis is not installed.
            CameraNotFound: its process cannot start.
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
        """End its process."""
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
        """How it is set now."""
        return self._ask(ASK)[1]

    def expose(self, picture: Image, taken_at: float) -> bool:
        """Pull the trigger line; return whether the camera waited for it and sends the picture.

        Args:
            picture: (height, width, 3) BGR as a renderer draws it, or (height, width), uint8. A grey
                camera sees the red plane of a colour picture, as behind a band-pass filter; a Bayer camera its mosaic.
            taken_at: when the exposure began on the camera's own clock [s].
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
                raise CameraNotFound("the fake GigE camera is not there: use `with fake:`")
            process.stdin.write(REQUEST.pack(kind, taken_at, len(picture)) + picture)
            process.stdin.flush()
            answer = read_exactly(process.stdout, STATE.size)
        if answer is None:
            raise CameraNotFound("the process of the fake GigE camera has ended")
        done, width, height, pixel_format, exposure, gain, line = STATE.unpack(answer)
        return bool(done), FakeState((width, height), NAMES[pixel_format], exposure * 1e-6, gain, bool(line))
