"""Sizes of pictures by the headers of their files, before anything is decoded."""

from __future__ import annotations

import re
import struct

PICTURE_FORMATS = "PNG, JPEG, BMP, TIFF or PGM"
TIFF_BEGINNINGS = (b"II*\0", b"MM\0*")
# Tags of width and height in a TIFF file, and its types of whole numbers.
TIFF_WIDTH, TIFF_HEIGHT = 256, 257
TIFF_TYPES = {3: "H", 4: "I"}
# Magic number, width, height and largest value of a PGM or PPM file, with comments between.
PORTABLE = re.compile(rb"P[2356]" + 3 * rb"(?:\s+|\s*#[^\n]*\n\s*)+(\d{1,9})" + rb"\s")


def picture_size(content: bytes) -> tuple[int, int] | None:
    """Width and height [px] as the header of the file says; None when it is none of the formats."""
    try:
        if content[:8] == b"\x89PNG\r\n\x1a\n" and content[12:16] == b"IHDR":
            width, height = struct.unpack(">II", content[16:24])
        elif content[:2] == b"BM":
            is_old = struct.unpack("<I", content[14:18])[0] == 12
            width, height = struct.unpack("<HH", content[18:22]) if is_old else struct.unpack("<ii", content[18:26])
            height = abs(height)
        elif content[:4] in TIFF_BEGINNINGS:
            return _tiff_size(content)
        elif found := PORTABLE.match(content[:4096]):
            width, height = int(found[1]), int(found[2])
        elif content[:2] == b"\xff\xd8":
            return _jpeg_size(content)
        else:
            return None
    except struct.error:
        return None
    return width, height


def _tiff_size(content: bytes) -> tuple[int, int] | None:
    order = "<" if content[:2] == b"II" else ">"
    (start,) = struct.unpack(order + "I", content[4:8])
    (count,) = struct.unpack(order + "H", content[start : start + 2])
    size: dict[int, int] = {}
    for entry in range(start + 2, start + 2 + 12 * count, 12):
        tag, kind, _ = struct.unpack(order + "HHI", content[entry : entry + 8])
        if tag in (TIFF_WIDTH, TIFF_HEIGHT) and kind in TIFF_TYPES:
            letter = TIFF_TYPES[kind]
            (size[tag],) = struct.unpack_from(order + letter, content, entry + 8)
    return (size[TIFF_WIDTH], size[TIFF_HEIGHT]) if len(size) == 2 else None


def _jpeg_size(content: bytes) -> tuple[int, int] | None:
    offset = 2
    while offset + 9 <= len(content):
        if content[offset] != 0xFF:
            return None
        marker = content[offset + 1]
        if marker == 0xFF:
            offset += 1
        # JPEG's marker SOF, which the size follows: all of C0 to CF but the tables C4 and CC and the reserved C8.
        elif 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            height, width = struct.unpack(">HH", content[offset + 5 : offset + 9])
            return width, height
        elif marker == 0x01 or 0xD0 <= marker <= 0xD9:
            offset += 2
        else:
            offset += 2 + int(struct.unpack(">H", content[offset + 2 : offset + 4])[0])
    return None
