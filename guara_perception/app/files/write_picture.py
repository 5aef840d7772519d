"""Image writer that raises OSError if the file cannot be written, where `cv2.imwrite` only returns False."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2

from guara_perception.arrays import Image


def write_picture(path: Path, picture: Image, options: Sequence[int] = ()) -> None:
    """Write an image in the format given by the suffix of the path.

    Args:
        path: file to write.
        picture: (h, w) or (h, w, 3) BGR image.
        options: options of `cv2.imencode`.

    Raises:
        OSError: the file cannot be written.
    """
    path.write_bytes(cv2.imencode(path.suffix, picture, list(options))[1].tobytes())
