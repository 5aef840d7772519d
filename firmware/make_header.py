"""Prints `protocol.h`: the numbers of `drivers/board/protocol.py` for the firmware. Needs nothing but Python."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

PROTOCOL = Path(__file__).resolve().parents[1] / "drivers" / "board" / "protocol.py"
NUMBERS = (
    "PROTOCOL_MAJOR PROTOCOL_MINOR VENDOR_ID PRODUCT_ID INTERFACE REPORT_ENDPOINT REQUEST_IN IDENTITY_SIZE STATUS_SIZE "
    "STRIPE_SIZE MOTION_SIZE REPORT_SIZE STRIPE_MARK SWEEP_STRIPES SWEEP_PLACES FLASH_SHORTEST_US FLASH_LONGEST_US "
    "PERIOD_LONGEST_US WAIT_UNIT_US MICROSOFT_REQUEST"
).split()
TEXTS = ("MANUFACTURER", "PRODUCT")
ENUMS = {
    "REQUEST": "Request",
    "RESULT": "Result",
    "FLAG": "BoardFlag",
    "FAULT": "BoardFault",
    "OFF_FRAMES": "SweepOffFrames",
    "SHOT": "Shot",
}


def header() -> str:
    """Return the text of the C header."""
    protocol = runpy.run_path(str(PROTOCOL))
    lines = [
        "/* Made by make_header.py from drivers/board/protocol.py: change it there. */",
        "#pragma once",
        "",
        "enum {",
    ]
    lines += [f"    {name} = {protocol[name]:#x}," for name in NUMBERS]
    for prefix, members in ENUMS.items():
        lines.append("")
        lines += [f"    {prefix}_{member.name} = {int(member):#x}," for member in protocol[members]]
    lines += ["};", ""]
    lines += [f'#define {name} "{protocol[name]}"' for name in TEXTS]
    lines.append(f'#define IDENTITY_MAGIC "{protocol["IDENTITY_MAGIC"].decode()}"')
    known = ", ".join(f"REQUEST_{request.name}" for request in protocol["Request"])
    lines.append(f"#define REQUESTS_KNOWN {known}")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.stdout.write(header())
