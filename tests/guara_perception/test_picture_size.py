"""Sizes in the headers of picture files, as OpenCV writes them and as others do; harmful headers are refused."""

from __future__ import annotations

import io
import struct

import cv2
import numpy as np
import pytest
from PIL import Image

import guara_perception as gp
from guara_perception.images import decode_picture

KINDS = [(suffix, 3, np.uint8) for suffix in (".png", ".jpg", ".bmp", ".tiff", ".ppm")]
KINDS += [(suffix, 1, np.uint8) for suffix in (".png", ".jpg", ".bmp", ".tiff", ".pgm")]
KINDS += [(".png", 3, np.uint16), (".tiff", 3, np.uint16), (".ppm", 3, np.uint16)]
KINDS += [(".png", 1, np.uint16), (".tiff", 1, np.uint16), (".pgm", 1, np.uint16)]


@pytest.mark.parametrize(("suffix", "channels", "dtype"), KINDS)
def test_what_opencv_writes_is_read_back(suffix: str, channels: int, dtype: type) -> None:
    """Grey and colour, 8 and 16 bit, where the format has them."""
    picture = np.random.default_rng(1).integers(0, np.iinfo(dtype).max, (37, 53, channels), dtype=dtype).squeeze()
    content = bytes(cv2.imencode(suffix, picture)[1])
    found = decode_picture(content, "p")
    assert found.dtype == dtype and found.shape[:2] == (37, 53)
    if suffix != ".jpg":
        assert np.array_equal(found, picture)


def test_headers_that_opencv_does_not_write() -> None:
    """Comments in a PGM; a big-endian TIFF."""
    assert decode_picture(b"P5\n# made by a camera\n# of 1998\n2 2\n255\n" + bytes(4), "p").shape == (2, 2)
    stream = io.BytesIO()
    Image.fromarray(np.ones((4, 9), ">u2")).save(stream, format="TIFF")
    assert stream.getvalue()[:4] == b"MM\0*" and decode_picture(stream.getvalue(), "p").shape == (4, 9)


def tiff(*entries: tuple[int, int, int]) -> bytes:
    """Little-endian TIFF of a directory with entries (tag, type, value), and nothing else."""
    packed = b"".join(struct.pack("<HHII", tag, kind, 1, value) for tag, kind, value in entries)
    return b"II*\0" + struct.pack("<IH", 8, len(entries)) + packed + bytes(4)


HUGE_TIFF = tiff((256, 4, 10**6), (257, 4, 10**4), (258, 3, 8), (259, 3, 1), (262, 3, 1), (273, 4, 8), (279, 4, 8))


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"P5 100000 100000 255\n", "(10000000000 pixels) exceeds limit"),
        (b"P5 4001 4000 255\n", "the picture has 4001 x 4000 px; allowed: 1 ... 16000000 px in total"),
        (b"BM" + bytes(12) + struct.pack("<Iii", 40, 50_000, -50_000), "not a readable picture"),
        (HUGE_TIFF, "(10000000000 pixels) exceeds limit"),
        (b"BM" + bytes(12) + struct.pack("<Iii", 40, -5, 5), "not a readable picture"),
        (b"II*\0" + struct.pack("<IH", 8, 60_000), "not a readable picture"),
        (b"II*\0\xff\xff\xff\xff", "not a readable picture"),
        (b"BM", "not a readable picture (2 bytes); it must be PNG, JPEG, BMP, TIFF or PGM"),
        (b"P5 640 480", "not a readable picture"),
        (
            bytes(cv2.imencode(".tiff", np.ones((9, 9), np.float32))[1]),
            "pixel type is float32; allowed: uint8 or uint16",
        ),
    ],
)
def test_harmful_headers(content: bytes, reason: str) -> None:
    """Refused before anything is decoded, or by what was decoded."""
    with pytest.raises(gp.FileFormatError) as refused:
        decode_picture(content, "p")
    assert reason in str(refused.value)
