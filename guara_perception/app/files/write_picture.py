"""Writer of pictures; OpenCV's own prints to the terminal and only returns False when the disk is full."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2

from guara_perception.arrays import Image


def write_picture(path: Path, picture: Image, options: Sequence[int] = ()) -> None:
    """Write a picture in the format that the suffix names.

    Args:
        path: path of the file to write.
        picture: (h, w) or (h, w, 3) BGR.
        options: options of `cv2.imencode`.

    Raises:
        OSError: it cannot be written.
    """
    path.write_bytes(cv2.imencode(path.suffix, picture, list(options))[1].tobytes())
