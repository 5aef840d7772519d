"""Damaged payloads: truncated, too long, flipped, of huge lengths: an error, never a crash or a grid."""

import struct
import tracemalloc

import numpy as np
import pytest

import transport
from tests.thorough import IS_THOROUGH
from tests.transport.messages.samples import EPOCH_BYTES, FILL_BYTES, STANDING_BYTES
from transport import MessageError
from transport.messages import codec

# Bytes by which the messages of earlier versions are shorter.
EARLIER = STANDING_BYTES, STANDING_BYTES + FILL_BYTES, STANDING_BYTES + FILL_BYTES + EPOCH_BYTES


@pytest.mark.slow
def test_every_truncation_is_refused(payloads) -> None:
    """A message of which the end is missing is never read, wherever it was cut."""
    for kind, (payload, decode) in payloads.items():
        for length in range(len(payload)):
            missing = len(payload) - length
            if kind == "guara_msgs/StancePause" and missing in EARLIER:
                # The whole message of a gait that knows nothing of walks, or of standing feet.
                assert decode(payload[:length]).epoch == ("" if missing == max(EARLIER) else "walk-7")
                assert decode(payload[:length]).standing_pauses == ()
                continue
            with pytest.raises(MessageError):
                decode(payload[:length])
                pytest.fail(f"{kind} cut to {length} of {len(payload)} bytes was read")


def test_bytes_left_over_are_refused(payloads) -> None:
    """A message with more than padding behind it is not read."""
    for payload, decode in payloads.values():
        with pytest.raises(MessageError):
            decode(payload + b"\x00" * 8)


@pytest.mark.slow
def test_flipped_bytes_give_an_error_or_a_valid_message(payloads) -> None:
    """Damage anywhere ends in a MessageError or a message that passes all checks: nothing else."""
    rng = np.random.default_rng(0)
    outcomes = {"valid": 0, "refused": 0}
    for payload, decode in payloads.values():
        for _ in range(400):
            damaged = bytearray(payload)
            for at in rng.integers(0, len(payload), rng.integers(1, 4)):
                damaged[at] = rng.integers(0, 256)
            try:
                decode(bytes(damaged))
                outcomes["valid"] += 1
            except MessageError:
                outcomes["refused"] += 1
    assert min(outcomes.values()) > 100, outcomes


@pytest.mark.slow
def test_huge_lengths_allocate_nothing(payloads) -> None:
    """A length field of four thousand million is refused without memory for it."""
    for payload, decode in payloads.values():
        tracemalloc.start()
        for at in range(4, len(payload) - 4, 4 if IS_THOROUGH else 12):
            damaged = bytearray(payload)
            struct.pack_into("<I", damaged, at, 0xFFFFFF00)
            try:
                decode(bytes(damaged))
            except MessageError:
                continue
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        # Tables of the type store are read meanwhile; 4e9 anything would be a thousand times more.
        assert peak < 20e6


def test_a_payload_beyond_the_limit_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """A payload that is too long is refused before it is looked at."""
    monkeypatch.setattr(codec, "MAXIMUM_PAYLOAD", 100)
    with pytest.raises(MessageError, match="101 bytes refused; allowed: up to 100"):
        transport.decode(bytes(101), "guara_msgs/msg/Terrain")
