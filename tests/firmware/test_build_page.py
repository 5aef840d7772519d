"""docs/build.md says what the firmware does."""

from __future__ import annotations

import re

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


def test_no_page_claims_that_silicon_has_run_it() -> None:
    """Until somebody has."""
    assert "No silicon has run this yet" in (DOCS / "build.md").read_text()
