"""The committed firmware is what its source compiles to, in the form that a Pico takes."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from testbed.chip import load_firmware
from tests.firmware.conftest import FIRMWARE

sys.path.insert(0, str(FIRMWARE))
from pack import boot_checksum, from_uf2, sealed, to_uf2  # noqa: E402

COMPILER = "arm-none-eabi-gcc"


@pytest.mark.slow
def test_the_source_compiles_to_the_committed_bytes(tmp_path: Path) -> None:
    """With the compiler that the file COMPILER names, in any folder."""
    if shutil.which(COMPILER) is None:
        pytest.skip(f"{COMPILER} is not installed: bytes were not compared")
    subprocess.run(
        ["make", "-s", "-C", FIRMWARE, "build", f"OUT={tmp_path}", f"PYTHON={sys.executable}"],
        check=True,
        capture_output=True,
    )
    built = (tmp_path / "guara_board.uf2").read_bytes()
    version = subprocess.run([COMPILER, "--version"], capture_output=True, text=True, check=True).stdout.splitlines()[0]
    made_by = (FIRMWARE / "COMPILER").read_text().strip()
    if version != made_by:
        pytest.skip(f"built; bytes were not compared: this is {version}, the committed firmware was made by {made_by}")
    assert built == (FIRMWARE / "guara_board.uf2").read_bytes()


def test_the_image_is_sealed_for_the_boot_rom() -> None:
    """The second stage carries the checksum of its 252 bytes; the check value is that of CRC-32/MPEG-2."""
    assert boot_checksum(b"123456789") == 0x0376E6E7
    image = load_firmware(FIRMWARE / "guara_board.uf2")
    assert int.from_bytes(image[252:256], "little") == boot_checksum(image[:252])


def test_uf2_holds_the_image_for_this_family() -> None:
    """Every block holds its address, its number and the family RP2040; `from_uf2` gives the image back."""
    image = bytes(range(256)) * 5 + b"tail"
    blocks = to_uf2(image)
    assert len(blocks) == 6 * 512
    assert from_uf2(blocks)[: len(image)] == image
    for number in range(6):
        header = [int.from_bytes(blocks[512 * number + at : 512 * number + at + 4], "little") for at in range(0, 32, 4)]
        assert header[3] == 0x10000000 + 256 * number and header[5:] == [number, 6, 0xE48BFF56]


def test_a_second_stage_too_long_is_refused() -> None:
    with pytest.raises(ValueError, match="longer than 252"):
        sealed(bytes(252) + b"x" + bytes(300))


@pytest.mark.parametrize("data", [b"", b"no firmware", bytes(512)])
def test_a_file_that_is_no_uf2_is_refused(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "wrong.uf2"
    path.write_bytes(data)
    with pytest.raises(ValueError, match="not a UF2 file"):
        load_firmware(path)
