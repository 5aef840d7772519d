"""Names and numbers of the protocol stand once, in drivers/board/protocol.py."""

from __future__ import annotations

import subprocess
import sys

from drivers.board import protocol
from tests.firmware.conftest import FIRMWARE


def test_the_header_is_made_from_the_protocol() -> None:
    """The committed header is what make_header.py prints."""
    made = subprocess.run([sys.executable, FIRMWARE / "make_header.py"], capture_output=True, text=True, check=True)
    assert (FIRMWARE / "protocol.h").read_text() == made.stdout


def test_every_command_of_the_page_is_a_request() -> None:
    """PROTOCOL.md, protocol.py and the header name the same commands with the same numbers."""
    page = (FIRMWARE.parent / "drivers" / "PROTOCOL.md").read_text()
    for request in protocol.Request:
        assert f"| 0x{int(request):02X} | {request.name} |" in page
    for fault in protocol.BoardFault:
        assert f"| {int(fault)} | {fault.name} |" in page
    for flag in protocol.BoardFlag:
        assert f"{int(flag)} {flag.name}" in page
    for result in protocol.Result:
        assert f"{int(result)} {result.name}" in page
