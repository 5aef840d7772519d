"""Process of a `FakeGigeCamera`; it ends when its standard input is closed."""

from __future__ import annotations

import argparse
import ctypes
import sys
import tempfile
import threading
from typing import Any, BinaryIO

from drivers.cameras.aravis_library import load_aravis
from testbed.gige import genicam
from testbed.gige.wire import EXPOSE, REQUEST, STATE, read_exactly

# Longest wait until the fake camera of Aravis notices a trigger [s], and rate at which it checks for one [Hz].
PATIENCE, POLL_RATE = 5.0, 1000.0
FILL = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_uint32, ctypes.c_uint32, ctypes.c_uint32)


class Fake:
    """Fake camera of Aravis that delivers the image given last."""

    def __init__(self, interface: str, serial: str, size: tuple[int, int], lost_packets: float = 0.0) -> None:
        """Start the camera.

        Args:
            interface: address of the network interface.
            serial: serial number of the camera.
            size: width and height of the sensor [px].
            lost_packets: share of packets that are lost.

        Raises:
            OSError: the address is in use, or does not belong to an interface of this machine.
        """
        aravis = load_aravis()
        with tempfile.NamedTemporaryFile("w", suffix=".xml") as file:
            file.write(genicam.description())
            file.flush()
            self._gige = aravis.GvFakeCamera.new_full(interface, serial, file.name)
        if not self._gige.is_running():
            raise OSError(f"cannot start a GigE Vision camera on {interface}: it is in use, or is not an interface")
        self._gige.set_property("gvsp-lost-ratio", lost_packets)
        self._camera = self._gige.get_fake_camera()
        start = {
            genicam.SENSOR_WIDTH: size[0],
            genicam.SENSOR_HEIGHT: size[1],
            genicam.WIDTH: size[0],
            genicam.HEIGHT: size[1],
            genicam.EXPOSURE: 10_000,
            genicam.EXPOSURE_AUTO: genicam.AUTOMATICS["Continuous"],
            genicam.GAIN_AUTO: genicam.AUTOMATICS["Continuous"],
            genicam.FRAME_PERIOD: 40_000,
        }
        for address, value in start.items():
            self._camera.write_register(address, value)
        self._library = _library()
        self._picture, self._taken_at = b"", 0
        self._filled = threading.Event()
        # A reference must be kept: the camera calls the function from its own thread, and the binding keeps none.
        self._fill_pointer = FILL(self._fill)
        self._library.arv_fake_camera_set_fill_pattern(_address(self._camera), self._fill_pointer, None)

    def expose(self, taken_at: int, picture: bytes) -> bool:
        """Trigger an exposure; return True if the camera was waiting for the trigger.

        Args:
            taken_at: start of the exposure on the camera's clock [ns].
            picture: pixels of the image.
        """
        if not all(self._register(address) for address in (genicam.ACQUISITION, genicam.TRIGGER_MODE)):
            return False
        if self._register(genicam.TRIGGER_SOURCE) != genicam.LINE1:
            return False
        self._picture, self._taken_at = picture, taken_at
        self._filled.clear()
        self._library.arv_fake_camera_set_trigger_frequency(_address(self._camera), POLL_RATE)
        self._camera.write_register(genicam.TRIGGER_NOW, 1)
        return self._filled.wait(PATIENCE)

    def state(self, answer: int) -> bytes:
        """Return the current settings in the form of `STATE`; `answer` is the result of the request."""
        addresses = (
            genicam.WIDTH,
            genicam.HEIGHT,
            genicam.PIXEL_FORMAT,
            genicam.EXPOSURE,
            genicam.GAIN,
            genicam.LINE_SOURCE,
        )
        return STATE.pack(answer, *(self._register(address) for address in addresses))

    def _register(self, address: int) -> int:
        return int(self._camera.read_register(address)[1])

    def _fill(self, buffer: int, user: int, exposure: int, gain: int, pixel_format: int) -> None:
        if self._picture:
            # The size is computed, because the buffer reports its size only when it is full.
            size = min(self._register(genicam.WIDTH) * self._register(genicam.HEIGHT), len(self._picture))
            ctypes.memmove(self._library.arv_buffer_get_data(buffer, None), self._picture, size)
            self._library.arv_buffer_set_timestamp(buffer, self._taken_at)
        self._filled.set()


def _address(thing: Any) -> int:
    pointer = ctypes.pythonapi.PyCapsule_GetPointer
    pointer.restype, pointer.argtypes = ctypes.c_void_p, [ctypes.py_object, ctypes.c_char_p]
    return int(pointer(thing.__gpointer__, None))


def _library() -> ctypes.CDLL:
    library = ctypes.CDLL("libaravis-0.8.so.0")
    library.arv_buffer_get_data.restype = ctypes.c_void_p
    library.arv_buffer_get_data.argtypes = [ctypes.c_void_p, ctypes.c_void_p]
    library.arv_buffer_set_timestamp.argtypes = [ctypes.c_void_p, ctypes.c_uint64]
    library.arv_fake_camera_set_fill_pattern.argtypes = [ctypes.c_void_p, FILL, ctypes.c_void_p]
    library.arv_fake_camera_set_trigger_frequency.argtypes = [ctypes.c_void_p, ctypes.c_double]
    return library


def serve(fake: Fake, requests: BinaryIO, answers: BinaryIO) -> None:
    """Answer requests until their stream ends."""
    while (head := read_exactly(requests, REQUEST.size)) is not None:
        kind, taken_at, length = REQUEST.unpack(head)
        picture = read_exactly(requests, length)
        if picture is None:
            return
        answers.write(fake.state(fake.expose(taken_at, picture) if kind == EXPOSE else 1))
        answers.flush()


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(prog="python -m testbed.gige", description=__doc__)
    parser.add_argument("--interface", default="127.0.0.1", help="address of the network interface")
    parser.add_argument("--serial", default="GUARA1", help="serial number of the camera")
    parser.add_argument("--width", type=int, default=640, help="width of the sensor [px]")
    parser.add_argument("--height", type=int, default=512, help="height of the sensor [px]")
    parser.add_argument("--lost-packets", type=float, default=0.0, help="share of packets that are lost")
    arguments = parser.parse_args()
    size = (arguments.width, arguments.height)
    try:
        fake = Fake(arguments.interface, arguments.serial, size, arguments.lost_packets)
    except OSError as error:
        sys.exit(str(error))
    sys.stdout.buffer.write(fake.state(1))
    sys.stdout.buffer.flush()
    serve(fake, sys.stdin.buffer, sys.stdout.buffer)


if __name__ == "__main__":
    main()
