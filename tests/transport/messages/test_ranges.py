"""Ranges of every field of every message: one table, and what is out of it is refused by name."""

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import transport
from tests.transport.messages.extremes import extremes
from tests.transport.messages.range_table import checked_types, range_rows
from tests.transport.messages.samples import sample_pause
from transport import MessageError
from transport.messages.codec import decode, encode
from transport.messages.map_messages import (
    RegionMessage,
    RegionsMessage,
    SummaryMessage,
    decode_regions,
    decode_summary,
    encode_regions,
    encode_summary,
)
from transport.messages.stance_pause import make_stance_pause
from transport.messages.typestore import EXCEPTIONS, FIELDS, Range, check_ranges, message_files, ranges, typestore

ROOT = Path(__file__).parents[3]
ORIGIN = {"robot": "r", "sequence": 1, "step": 1, "stamp": 5, "scan_end": 5, "valid_for": 1.0, "valid_pauses": 1}


@pytest.fixture
def all_payloads(payloads) -> dict[str, tuple[bytes, Any]]:
    """A small payload of every message that is decoded with checks, by its type, and what decodes it."""
    square = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
    halfspaces = np.array([[1.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 1.0], [0.0, -1.0, 0.0]])
    region = RegionMessage(halfspaces=halfspaces, vertices=square, plane=np.zeros(3), sigma=0.001, area=1.0)
    summary = SummaryMessage(
        **ORIGIN,
        resolution=0.1,
        origin=(0.0, 0.0),
        heights=np.zeros((2, 3), np.int16),
        hazard=np.zeros((2, 3), np.uint16),
        traversability=np.ones((2, 3), np.uint8),
    )
    own = {kind.replace("/", "/msg/"): pair for kind, pair in payloads.items() if "grid_map" not in kind}
    own.pop("nav_msgs/msg/OccupancyGrid")
    return own | {
        "guara_msgs/msg/TerrainSummary": (encode_summary(summary), decode_summary),
        "guara_msgs/msg/SteppableRegions": (
            encode_regions(RegionsMessage(**ORIGIN, regions=(region,))),
            decode_regions,
        ),
    }


def test_every_field_of_every_message_has_a_range() -> None:
    """All types of guara_msgs, and all types within them; flags need none. No range is of a field that is not."""
    known: set[str] = set()
    assert {name for name in message_files() if name.startswith("guara_msgs")} <= set(checked_types())
    for type_name in checked_types():
        own = {field for field, _ in typestore().get_msgdef(type_name).fields}
        assert set(EXCEPTIONS.get(type_name, {})) <= own and set(ranges(type_name)) <= own
        for field, (kind, details) in typestore().get_msgdef(type_name).fields:
            known.add(field)
            inner = details[0] if kind in (3, 4) else (kind, details)
            if inner[0] == 2:
                assert inner[1] in checked_types(), f"{type_name}: {inner[1]}"
            if kind in (3, 4) or (inner[0] == 1 and inner[1][0] != "bool"):
                assert field in ranges(type_name), f"{type_name}.{field}"
            if kind in (3, 4):
                assert ranges(type_name)[field].entries is not None, f"{type_name}.{field}"
    assert set(FIELDS) <= known


def test_documents_hold_the_table() -> None:
    """Every row of the table, and no other."""
    text = (ROOT / "docs" / "reference" / "message-ranges.md").read_text()
    assert [line for line in text.splitlines() if line.startswith("| `")] == range_rows()


def test_documents_name_every_field_of_every_message() -> None:
    """All fields of guara_msgs are on the page of messages; those of recordings alone are described by topic."""
    text = (ROOT / "docs" / "messages.md").read_text()
    named = set(re.findall(r"`(?:\w+\[\]\.)?(\w+)(?:\.\w+)*`", text))
    for name in message_files():
        if name.startswith("guara_msgs") and name.rpartition("/")[2] not in {"ScanStart", "Stripe", "ScanEnd"}:
            fields = {field for field, _ in typestore().get_msgdef(name).fields} - {"header"}
            assert fields <= named, (name, fields - named)


@pytest.mark.slow
def test_every_extreme_of_every_field_is_refused_or_decoded(all_payloads) -> None:
    """NaN, infinities, zero, denormal and huge numbers, limits of integers, empty and endless lists and texts."""
    fields: set[tuple[str, str]] = set()
    outcomes = {"refused": 0, "decoded": 0}
    for type_name, (payload, decoder) in all_payloads.items():
        for field, message in extremes(decode(payload, type_name)):
            fields.add((type_name, field))
            try:
                changed = encode(message)
            except MessageError:
                continue
            try:
                decoder(bytes(changed))
                outcomes["decoded"] += 1
            except MessageError as error:
                assert len(str(error)) < 1000
                outcomes["refused"] += 1
    print(f"{len(all_payloads)} messages, {len(fields)} fields, {outcomes}")
    assert len(fields) > 150 and min(outcomes.values()) > 300


def test_a_refusal_names_field_value_and_range(peer) -> None:
    message = make_stance_pause(sample_pause(peer))
    for value in (1e10, 1e12, 1e300, math.inf, math.nan, -1.0):
        message.time_available = value
        with pytest.raises(
            MessageError, match=r"^time_available of StancePause is .*; allowed: 0 to 3,600 s$"
        ) as refused:
            transport.decode_stance_pause(encode(message))
        assert f" is {value:.6g};" in str(refused.value)


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"time_available": 1e10}, "time_available of StancePause is 1e\\+10; allowed: 0 to 3,600 s"),
        ({"known_ground": 65}, "known_ground of StancePause has 65 entries; allowed: up to 64 entries"),
    ],
)
def test_a_gait_hears_of_it_when_it_makes_the_message(peer, fields: dict[str, Any], words: str) -> None:
    """Not only the node, which would refuse it."""
    pause = sample_pause(peer)
    if "known_ground" in fields:
        fields = {"known_ground": pause.known_ground * 65}
    with pytest.raises(MessageError, match=words):
        transport.StancePause(robot="r", step=1, phase=1, stamp=1, stance=pause.stance, **fields)


def test_corners_timeouts_and_gravity_are_bounded() -> None:
    with pytest.raises(MessageError, match="outline of GroundPatch has 30000 entries; allowed: up to 64"):
        transport.GroundPatch(outline=np.zeros((30_000, 2)), height=0.0, sigma=0.0)
    with pytest.raises(MessageError, match="timeout of ScanRequest is 1e\\+10; allowed: 0 to 3,600 s"):
        transport.ScanRequest(id="a", mode="coarse", timeout=1e10)
    for length in (1e-300, 9e-4, 2e6, 1e308):
        with pytest.raises(MessageError, match="length of gravity_in_base is .*; allowed: 0.001 to 1,000,000"):
            transport.StanceMessage(joint_positions={}, support_feet=(), gravity_in_base=(0.0, 0.0, -length))
    transport.StanceMessage(joint_positions={}, support_feet=(), gravity_in_base=(0.0, 0.0, -1e-3))


def test_a_status_that_is_too_long_is_cut_and_arrives() -> None:
    """A part that writes whole pages into the status does not silence the others."""
    items = [
        transport.StatusItem(
            name="n" * 999, level=transport.Health.ERROR, message="m" * 99_999, values={"a": "v" * 99_999}
        )
    ]
    status = transport.decode_status(transport.encode_status(transport.Status(stamp=1, items=tuple(items))))
    assert (len(status.items[0].name), len(status.items[0].message)) == (200, 10_000)
    refusal = transport.Refusal(id="a", code="busy", message="m" * 99_999)
    from transport.messages.scan_messages import decode_refusal, encode_refusal

    assert len(decode_refusal(encode_refusal(refusal)).message) == 10_000


def test_texts_of_ranges() -> None:
    assert str(Range(low=-(2**53), high=2**53)) == "-2^53 to 2^53"
    assert str(Range(low=0, high=2**64 - 1)) == "0 to 2^64 - 1"
    assert str(Range(entries=3, low=0, high=1e12, nan=True, unit="m")) == "up to 3 entries, 0 to 1e+12 m or NaN"


def test_a_type_without_ranges_passes() -> None:
    check_ranges(transport.text_message("x" * 100_000))
