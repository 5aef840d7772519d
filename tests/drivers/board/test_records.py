"""Encoding and decoding of identity and status."""

import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.board.board_records import BoardIdentity, BoardStatus
from drivers.board.protocol import BoardFault, BoardFlag, Request, Result, checksum
from drivers.errors import BadReply
from tests.thorough import examples

IDENTITY = BoardIdentity((1, 0), (2, 7), 0.000122718, 64, 5753, 2197, 0.5, 10.0, 0.05)


def status(**changes: object) -> BoardStatus:
    fields: dict = dict(
        result=Result.OK,
        request=Request.STATUS,
        sequence=513,
        flags=BoardFlag.SESSION | BoardFlag.LASER_SENSED | BoardFlag.HAS_SENSOR,
        faults=BoardFault.WATCHDOG,
        step=-5,
        motion=7,
        temperature=-1.5,
        home_error=-2,
        laser_time=0.25,
        device_time=70.0,
    )
    return BoardStatus(**(fields | changes))


def test_identity_bytes_are_those_of_the_document() -> None:
    """Every field of the identity is at the offset given in PROTOCOL.md, little endian."""
    data = IDENTITY.pack()
    assert len(data) == 32
    assert data[:8] == b"GUAR\x01\x00\x07\x02"
    assert data[8:24] == struct.pack("<Iiii", 122718, 64, 5753, 2197)
    assert data[24:30] == struct.pack("<HHH", 500, 10000, 50)
    assert data[30:] == struct.pack("<H", checksum(data[:30]))


def test_status_bytes_are_those_of_the_document() -> None:
    """Every field of the status is at the offset given in PROTOCOL.md, little endian."""
    data = status().pack()
    assert len(data) == 26
    assert data[:8] == bytes((0, 0x30, 0x01, 0x02, 1 + 4 + 32, 0, 1, 0))
    assert data[8:20] == struct.pack("<iHhhH", -5, 7, -15, -2, 250)
    assert data[20:24] == struct.pack("<I", 70000)
    assert data[24:] == struct.pack("<H", checksum(data[:24]))


def test_identity_survives_the_wire() -> None:
    """Decoding inverts encoding."""
    assert BoardIdentity.unpack(IDENTITY.pack()) == IDENTITY


@given(st.integers(-(2**31), 2**31 - 1), st.integers(0, 65535), st.integers(-32768, 32767), st.sampled_from(Result))
@settings(max_examples=examples(100), derandomize=True)
def test_status_survives_the_wire(step: int, motion: int, home_error: int, result: Result) -> None:
    """Decoding inverts encoding, over the whole range of the fields."""
    sent = status(step=step, motion=motion, home_error=home_error, result=result)
    assert BoardStatus.unpack(sent.pack()) == sent


@given(st.integers(0, 25), st.integers(1, 255))
@settings(max_examples=examples(200), derandomize=True)
def test_no_damaged_byte_passes(index: int, change: int) -> None:
    """A status with any one byte changed is rejected."""
    data = bytearray(status().pack())
    data[index] ^= change
    with pytest.raises(BadReply, match="damaged"):
        BoardStatus.unpack(bytes(data))


def test_short_record_is_refused_with_both_lengths() -> None:
    """The message gives the actual and the required number of bytes."""
    with pytest.raises(BadReply, match="13 bytes; allowed: 26"):
        BoardStatus.unpack(status().pack()[:13])


def test_foreign_device_is_refused() -> None:
    """Another device with the same ids is recognised by its magic."""
    body = b"ABCD" + IDENTITY.pack()[4:30]
    with pytest.raises(BadReply, match="another device"):
        BoardIdentity.unpack(body + struct.pack("<H", checksum(body)))


def test_unknown_result_is_refused() -> None:
    """An unknown result number does not count as OK."""
    body = b"\x63" + status().pack()[1:24]
    with pytest.raises(BadReply, match="result 99"):
        BoardStatus.unpack(body + struct.pack("<H", checksum(body)))


def test_identity_without_step_angle_is_refused() -> None:
    """Zero radians per step would make all angles equal."""
    body = IDENTITY.pack()[:8] + bytes(4) + IDENTITY.pack()[12:30]
    with pytest.raises(BadReply, match="0 nrad"):
        BoardIdentity.unpack(body + struct.pack("<H", checksum(body)))


@given(st.integers(64, 5753))
@settings(max_examples=examples(100), derandomize=True)
def test_step_and_angle_are_inverse(step: int) -> None:
    """The step nearest to the angle of a step is that step."""
    assert IDENTITY.step_of(IDENTITY.angle_of(step)) == step


def test_angle_is_zero_at_the_zero_step_and_grows_with_steps() -> None:
    """The mirror angle increases with the steps."""
    assert IDENTITY.angle_of(2197) == 0.0
    assert IDENTITY.angle_of(2198) == pytest.approx(0.000122718)


def test_laser_sensed_falls_back_on_the_command_only_without_a_sensor() -> None:
    """With a photodiode, the sensed light counts, whatever was commanded."""
    blind = status(flags=BoardFlag.LASER_COMMANDED)
    seeing = status(flags=BoardFlag.LASER_COMMANDED | BoardFlag.HAS_SENSOR)
    assert blind.laser_sensed and not seeing.laser_sensed
