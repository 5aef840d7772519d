"""Numbers of the protocol, compared with PROTOCOL.md."""

from pathlib import Path

from hypothesis import given, settings
from hypothesis import strategies as st

import drivers
from drivers.board import protocol
from drivers.board.protocol import BoardFault, BoardFlag, Request, Result
from tests.thorough import examples

DOCUMENT = (Path(drivers.__file__).parent / "PROTOCOL.md").read_text()


def test_checksum_has_the_published_check_value() -> None:
    """The CRC of the ASCII digits 1 ... 9 is 0x29B1, as for every CRC-16 with these parameters."""
    assert protocol.checksum(b"123456789") == 0x29B1
    assert "0x29B1" in DOCUMENT


def test_every_request_stands_in_the_document() -> None:
    """Number and name of each command are in the table of commands."""
    for request in Request:
        assert f"| 0x{request.value:02X} | {request.name} |" in DOCUMENT


def test_every_result_flag_and_fault_stands_in_the_document() -> None:
    """Each value that a status can contain is documented with its number."""
    for result in Result:
        assert f"{result.value} {result.name}" in DOCUMENT
    for flag in BoardFlag:
        assert f"{flag.value} {flag.name}" in DOCUMENT
    for fault in BoardFault:
        assert f"| {fault.value} | {fault.name} |" in DOCUMENT


def test_every_fault_has_words() -> None:
    """Every fault has a description."""
    assert protocol.describe_faults(BoardFault(0)) == "no fault"
    for fault in BoardFault:
        assert protocol.describe_faults(fault) == protocol.FAULT_MEANINGS[fault]
    both = protocol.describe_faults(BoardFault.WATCHDOG | BoardFault.LOST_STEPS)
    assert "watchdog" in both and "lost steps" in both


@given(st.integers(-(2**31), 2**31 - 1))
@settings(max_examples=examples(200), derandomize=True)
def test_argument_survives_being_split(argument: int) -> None:
    """A signed 32-bit argument is recovered from the two halves of the setup packet."""
    value, index = protocol.split_argument(argument)
    assert 0 <= value <= 0xFFFF and 0 <= index <= 0xFFFF
    assert protocol.join_argument(value, index) == argument


def test_minus_one_is_all_ones_on_the_wire() -> None:
    """Negative steps are two's complement, low half first."""
    assert protocol.split_argument(-2) == (0xFFFE, 0xFFFF)
    assert protocol.split_argument(0x12345) == (0x2345, 0x1)
