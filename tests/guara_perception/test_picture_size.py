"""Sizes in the headers of picture files, as OpenCV writes them and as others do; harmful headers are refused."""

from __future__ import annotations

import struct

import cv2
import numpy as np
import pytest

import guara_perception as gp
from guara_perception.files import decode_picture
from guara_perception.picture_size import picture_size

KINDS = [(suffix, 3, np.uint8) for suffix in (".png", ".jpg", ".bmp", ".tiff", ".ppm")]
KINDS += [(suffix, 1, np.uint8) for suffix in (".png", ".jpg", ".bmp", ".tiff", ".pgm")]
KINDS += [(".png", 3, np.uint16), (".tiff", 3, np.uint16), (".ppm", 3, np.uint16)]
KINDS += [(".png", 1, np.uint16), (".tiff", 1, np.uint16), (".pgm", 1, np.uint16)]


@pytest.mark.parametrize(("suffix", "channels", "dtype"), KINDS)
def test_what_opencv_writes_is_read_back(suffix: str, channels: int, dtype: type) -> None:
    """Grey and colour, 8 and 16 bit, where the format has them."""
    picture = np.random.default_rng(1).integers(0, np.iinfo(dtype).max, (37, 53, channels), dtype=dtype).squeeze()
    content = bytes(cv2.imencode(suffix, picture)[1])
    assert picture_size(content) == (53, 37)
    found = decode_picture(content, "p")
    assert found.dtype == dtype and found.shape[:2] == (37, 53)
    if suffix != ".jpg":
        assert np.array_equal(found, picture)


def test_headers_that_opencv_does_not_write() -> None:
    """Comments in a PGM, a BMP from top to bottom, a big-endian TIFF."""
    assert picture_size(b"P5\n# made by a camera\n# of 1998\n640 480\n255\n") == (640, 480)
    assert picture_size(b"BM" + bytes(12) + struct.pack("<Iii", 40, 640, -480)) == (640, 480)
    entries = struct.pack(">HHIHH", 256, 3, 1, 640, 0) + struct.pack(">HHII", 257, 4, 1, 480)
    assert picture_size(b"MM\0*" + struct.pack(">IH", 8, 2) + entries) == (640, 480)


HUGE_TIFF = b"II*\0" + struct.pack("<IH", 8, 2) + struct.pack("<HHII", 256, 4, 1, 10**6) * 1
HUGE_TIFF += struct.pack("<HHII", 257, 4, 1, 10**6)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"P5 100000 100000 255\n", "a picture of 100000 x 100000 px, allowed: 16000000 px in all"),
        (b"BM" + bytes(12) + struct.pack("<Iii", 40, 50_000, -50_000), "a picture of 50000 x 50000 px"),
        (HUGE_TIFF, "a picture of 1000000 x 1000000 px"),
        (b"BM" + bytes(12) + struct.pack("<Iii", 40, -5, 5), "a picture of -5 x 5 px"),
        (b"II*\0" + struct.pack("<IH", 8, 60_000), "not a readable picture"),
        (b"II*\0\xff\xff\xff\xff", "not a readable picture"),
        (b"BM", "not a readable picture (2 bytes), it must be PNG, JPEG, BMP, TIFF or PGM"),
        (b"P5 640 480", "not a readable picture"),
        (bytes(cv2.imencode(".tiff", np.ones((9, 9), np.float32))[1]), "a picture of float32, allowed: 8 or 16 bit"),
    ],
)
def test_harmful_headers(content: bytes, reason: str) -> None:
    """Refused before anything is decoded, or by what was decoded."""
    with pytest.raises(gp.FileFormatError) as refused:
        decode_picture(content, "p")
    assert reason in str(refused.value)
