"""Converts the linked image for a Pico: adds the checksum of the second stage and divides it into UF2 blocks.

`python pack.py IMAGE.bin FIRMWARE.uf2`
"""

from __future__ import annotations

import struct
import sys
from pathlib import Path

BOOT2_SIZE = 256
FLASH_START = 0x10000000
PAGE = 256
FAMILY_RP2040 = 0xE48BFF56
FAMILY_PRESENT = 0x2000


def boot_checksum(data: bytes) -> int:
    """Return the CRC-32 that the boot ROM requires (RP2040 data sheet 2.8.1.3.1): 0x04C11DB7, not reflected."""
    crc = 0xFFFFFFFF
    for byte in data:
        crc ^= byte << 24
        for _ in range(8):
            crc = (crc << 1 ^ 0x04C11DB7 if crc & 0x80000000 else crc << 1) & 0xFFFFFFFF
    return crc


def sealed(image: bytes) -> bytes:
    """Return the image with the checksum of its first 252 bytes after them.

    Raises:
        ValueError: the second stage is too long.
    """
    body = image[: BOOT2_SIZE - 4]
    if any(image[BOOT2_SIZE - 4 : BOOT2_SIZE]):
        raise ValueError(f"the second stage is longer than {BOOT2_SIZE - 4} bytes")
    return body + struct.pack("<I", boot_checksum(body)) + image[BOOT2_SIZE:]


def to_uf2(image: bytes) -> bytes:
    """Return the image as UF2 blocks of 256 bytes for the RP2040's flash."""
    pages = [image[start : start + PAGE].ljust(PAGE, b"\0") for start in range(0, len(image), PAGE)]
    blocks = []
    for number, page in enumerate(pages):
        head = struct.pack(
            "<8I",
            0x0A324655,
            0x9E5D5157,
            FAMILY_PRESENT,
            FLASH_START + PAGE * number,
            PAGE,
            number,
            len(pages),
            FAMILY_RP2040,
        )
        blocks.append(head + page.ljust(476, b"\0") + struct.pack("<I", 0x0AB16F30))
    return b"".join(blocks)


def from_uf2(uf2: bytes) -> bytes:
    """Return the image in UF2 blocks, from the beginning of the flash.

    Raises:
        ValueError: not UF2, or not in order.
    """
    image = bytearray()
    for start in range(0, len(uf2), 512):
        block = uf2[start : start + 512]
        magic, second, _, address, size = struct.unpack_from("<5I", block)
        if (magic, second) != (0x0A324655, 0x9E5D5157) or address != FLASH_START + len(image):
            raise ValueError(f"block {start // 512} is not the next one of a UF2 file")
        image += block[32 : 32 + size]
    return bytes(image)


if __name__ == "__main__":
    source, target = (Path(name) for name in sys.argv[1:])
    target.write_bytes(to_uf2(sealed(source.read_bytes())))
    sys.stdout.write(f"{target.name}: {source.stat().st_size} bytes of flash\n")
