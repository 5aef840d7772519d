"""docs/build.md and its diagram say what the firmware does."""

from __future__ import annotations

import re
import subprocess
import sys

from tests.firmware.conftest import FIRMWARE

DOCS = FIRMWARE.parent / "docs"


def pins() -> dict[str, int]:
    found = re.findall(r"PIN_(\w+) = (\d+)", (FIRMWARE / "pins.h").read_text())
    return {name: int(number) for name, number in found}


def test_the_pin_table_is_that_of_the_firmware() -> None:
    """Every pin but the LED on the Pico itself stands in the table, with its GPIO."""
    rows = re.findall(r"^\| \d+ \| GP(\d+) \| (\w+) \|", (DOCS / "build.md").read_text(), re.MULTILINE)
    assert {name: int(number) for number, name in rows} == {
        name: number for name, number in pins().items() if name != "LED"
    }


def test_the_diagram_is_drawn_from_the_firmware() -> None:
    drawn = subprocess.run([sys.executable, FIRMWARE / "wiring.py"], capture_output=True, text=True, check=True).stdout
    assert (DOCS / "images" / "wiring.svg").read_text() == drawn
    for name, number in pins().items():
        assert name == "LED" or f"GP{number} {name}" in drawn


def test_no_page_claims_that_silicon_has_run_it() -> None:
    """Until somebody has."""
    assert "No silicon has run this yet" in (DOCS / "build.md").read_text()
