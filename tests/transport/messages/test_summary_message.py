"""The summary of a map on the wire: round trip, decoding by the definition alone, and what is refused."""

import math

import numpy as np
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.thorough import examples
from transport import MessageError, TransportError, VersionError
from transport.messages.codec import decode, encode
from transport.messages.map_messages import LAYERS, UNKNOWN_HEIGHT, SummaryMessage, decode_summary, encode_summary
from transport.messages.typestore import SUMMARY


def _make(seed: int = 0, shape: tuple[int, int] = (140, 320), **changes: object) -> SummaryMessage:
    rng = np.random.default_rng(seed)
    limits = {name: np.iinfo(dtype) for name, dtype in LAYERS.items()}
    layers = {
        name: rng.integers(limits[name].min, limits[name].max, shape, dtype, endpoint=True)
        for name, dtype in LAYERS.items()
    }
    layers["heights"][0, 0] = UNKNOWN_HEIGHT
    fields = {
        "robot": "rex",
        "sequence": 7,
        "step": 12,
        "stamp": 1_700_000_000_000_000_001,
        "scan_end": 1_700_000_000_000_000_000,
        "valid_for": math.inf,
        "valid_pauses": 4,
        "resolution": 0.005,
        "origin": (-0.6, -0.35),
        "run": "abc",
        "epoch": "walk",
        "scan_end_clock": 12.5,
        "provisional": True,
    }
    return SummaryMessage(**(fields | layers | changes))


@settings(max_examples=examples(30), deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    shape=st.tuples(st.integers(1, 40), st.integers(1, 40)),
    clock=st.none() | st.floats(0, 1e9),
    flags=st.tuples(st.booleans(), st.booleans()),
)
def test_what_is_sent_is_what_arrives(seed: int, shape: tuple[int, int], clock: float | None, flags) -> None:
    """Every field and every bit of the layers; the arrays are read-only."""
    nothing = {
        "heights": np.full(shape, UNKNOWN_HEIGHT, LAYERS["heights"]),
        "traversability": np.zeros(shape, LAYERS["traversability"]),
    }
    withdrawn = {"withdrawn": True, **nothing} if flags[1] else {}
    sent = _make(seed, shape, scan_end_clock=clock, provisional=flags[0], **withdrawn)
    received = decode_summary(encode_summary(sent))
    for name in SummaryMessage.__slots__:
        original, arrived = getattr(sent, name), getattr(received, name)
        if name in LAYERS:
            assert original.dtype == arrived.dtype and np.array_equal(original, arrived) and not arrived.flags.writeable
        else:
            assert original == arrived, name


def test_the_form_is_as_the_definition_says() -> None:
    """Decoded with zstd and a loop over bytes alone, as somebody who has only the .msg file would do it."""
    sent = _make(shape=(3, 5))
    message = decode(encode_summary(sent), SUMMARY)
    for name, dtype in LAYERS.items():
        plain = zstandard.ZstdDecompressor().decompress(getattr(message, name).tobytes())
        count = message.nx * message.ny
        values = [sum(plain[byte * count + i] << (8 * byte) for byte in range(dtype.itemsize)) for i in range(count)]
        signed = [value - 2**16 if name == "heights" and value >= 2**15 else value for value in values]
        assert signed == getattr(sent, name).ravel().tolist()


def _broken(change) -> bytes:
    message = decode(encode_summary(_make(shape=(4, 6))), SUMMARY)
    change(message)
    return bytes(encode(message))


@pytest.mark.parametrize(
    ("change", "expected_text"),
    [
        (lambda m: setattr(m, "nx", 7), r"has 48 bytes; ny \* nx values need 56"),
        (lambda m: setattr(m, "nx", 0), "nx of TerrainSummary is 0"),
        (lambda m: setattr(m, "nx", 4_000_000), "summary of 4 x 4000000 cells"),
        (lambda m: setattr(m, "hazard", m.hazard[:-3]), "not a complete zstd frame"),
        (lambda m: setattr(m, "heights", np.zeros(0, np.uint8)), "not a complete zstd frame"),
        (lambda m: setattr(m, "resolution", 0.0), "resolution of TerrainSummary is 0"),
        (lambda m: setattr(m, "origin_x", math.nan), "origin_x of TerrainSummary is nan"),
        (lambda m: setattr(m, "valid_for", math.nan), "valid_for of TerrainSummary is nan"),
        (lambda m: setattr(m, "scan_end_clock", math.inf), "scan_end_clock"),
        (lambda m: setattr(m, "robot", "a/b"), "a/b"),
        (lambda m: setattr(m, "run", "r" * 101), "run of TerrainSummary has 101 characters"),
    ],
)
def test_what_is_not_as_it_must_be_is_refused(change, expected_text: str) -> None:
    """The message says what is wrong."""
    with pytest.raises(TransportError, match=expected_text):
        decode_summary(_broken(change))


@pytest.mark.parametrize("layer", ["heights", "traversability"])
def test_a_withdrawn_summary_with_a_known_cell_is_refused(layer: str) -> None:
    """Without known cells it can be made and sent; with one it is refused where it arrives."""
    nothing = {"heights": np.full((4, 6), UNKNOWN_HEIGHT, LAYERS["heights"])}
    nothing["traversability"] = np.zeros((4, 6), LAYERS["traversability"])
    assert _make(shape=(4, 6), withdrawn=True, **nothing).withdrawn
    nothing[layer][2, 3] = 5
    payload = bytearray(encode_summary(_make(shape=(4, 6), **nothing)))
    message = decode(payload, SUMMARY)
    message.withdrawn = True
    with pytest.raises(MessageError, match="summary is withdrawn, but has known cells; allowed: none"):
        decode_summary(encode(message))


def test_another_major_version_is_refused() -> None:
    """The message names the version."""
    with pytest.raises(VersionError, match="summary of version 2.0"):
        decode_summary(_broken(lambda m: setattr(m, "version_major", 2)))


def test_a_decompression_bomb_is_not_opened() -> None:
    """A small frame that says that it holds 10 MB, where nx and ny ask for 48 bytes."""
    bomb = np.frombuffer(zstandard.ZstdCompressor().compress(bytes(10_000_000)), np.uint8)
    with pytest.raises(MessageError, match="decompresses to 10000000 bytes refused; allowed: up to 48"):
        decode_summary(_broken(lambda m: setattr(m, "heights", bomb)))


def test_a_layer_of_another_type_is_refused() -> None:
    """Where the message is made, with name and type of the layer."""
    with pytest.raises(MessageError, match="layer 'hazard' of a summary is int16"):
        _make(hazard=np.zeros((140, 320), np.int16))


@settings(max_examples=examples(100), deadline=None)
@given(data=st.data())
def test_damage_is_refused_or_does_no_harm(data) -> None:
    """Cut anywhere, and with bytes changed: a whole summary or one of our errors, never another one."""
    payload = bytearray(encode_summary(_make(shape=(6, 8))))
    for _ in range(data.draw(st.integers(0, 4))):
        payload[data.draw(st.integers(0, len(payload) - 1))] = data.draw(st.integers(0, 255))
    cut = payload[: data.draw(st.integers(0, len(payload)))]
    try:
        decode_summary(cut)
    except TransportError:
        pass
