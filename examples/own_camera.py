"""Driver for a camera of your own, with five methods: here one that delivers the images of a folder in a loop.

    python examples/own_camera.py pictures

Put this file beside devices.toml and name it there, `source = "own_camera:FolderCamera"`; every command
accepts `--devices devices.toml`.
"""

import time
from pathlib import Path

import cv2
import numpy as np

from drivers import Camera, CameraSettings, Frame


class FolderCamera(Camera):
    """Camera that delivers the images of a folder, one every 33 ms."""

    name = "folder camera"
    lag = 0.0

    def __init__(self, folder: str = "pictures") -> None:
        """List the images of the folder."""
        self._paths = sorted(path for path in Path(folder).iterdir() if path.suffix in (".png", ".jpg"))
        self._number = 0

    def open(self) -> None:
        """Do nothing: there is no device."""

    def close(self) -> None:
        """Do nothing: there is no device."""

    def lock(self, settings: CameraSettings) -> CameraSettings:
        """Return no locked settings, since recorded images cannot be exposed again."""
        return CameraSettings()

    def grab(self, timeout: float) -> Frame:
        """Return the next image."""
        time.sleep(min(timeout, 0.033))
        path = self._paths[self._number % len(self._paths)]
        picture = cv2.imdecode(np.frombuffer(path.read_bytes(), np.uint8), cv2.IMREAD_COLOR)
        assert picture is not None
        self._number += 1
        return Frame(np.asarray(picture, np.uint8), self._number, time.monotonic())

    def flush(self) -> None:
        """Do nothing: no frame is waiting."""


def main(folder: str) -> None:
    """Grab three frames."""
    with FolderCamera(folder) as camera:
        for _ in range(3):
            frame = camera.grab(timeout=1.0)
            print(f"frame {frame.counter}: {frame.image.shape[1]}x{frame.image.shape[0]}")


if __name__ == "__main__":
    from arguments import call

    call(main)
