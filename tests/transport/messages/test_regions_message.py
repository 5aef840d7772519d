"""Steppable regions on the wire: round trip, decoding by the definition alone, and what is refused."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.thorough import examples
from transport import MessageError, VersionError
from transport.messages.codec import decode, encode
from transport.messages.map_messages import RegionMessage, RegionsMessage, decode_regions, encode_regions
from transport.messages.typestore import REGIONS


def _region(seed: int, corners: int = 5) -> RegionMessage:
    """A polygon on a circle, on any plane."""
    rng = np.random.default_rng(seed)
    angle = np.sort(np.arange(corners) + rng.uniform(0, 0.5, corners)) * 2 * np.pi / corners
    xy = rng.uniform(-1, 1, 2) + 0.1 * np.column_stack((np.cos(angle), np.sin(angle)))
    edge = np.roll(xy, -1, 0) - xy
    normal = np.column_stack((edge[:, 1], -edge[:, 0])) / np.hypot(*edge.T)[:, None]
    plane = np.append(rng.uniform(-0.5, 0.5, 2), rng.uniform(-0.1, 0.1))
    return RegionMessage(
        halfspaces=np.column_stack((normal, (normal * xy).sum(axis=1))),
        vertices=np.column_stack((xy, xy @ plane[:2] + plane[2])),
        plane=plane,
        sigma=0.001,
        area=0.02,
    )


def _make(**changes: object) -> RegionsMessage:
    fields: dict[str, object] = {
        "robot": "rex",
        "sequence": 7,
        "step": 12,
        "stamp": 1_700_000_000_000_000_001,
        "scan_end": 1_700_000_000_000_000_000,
        "valid_for": math.inf,
        "valid_pauses": 4,
        "regions": (_region(1), _region(2, 3)),
        "run": "abc",
        "epoch": "walk",
        "scan_end_clock": 12.5,
        "provisional": True,
    }
    return RegionsMessage(**(fields | changes))


@settings(max_examples=examples(40), deadline=None)
@given(
    shapes=st.lists(st.tuples(st.integers(0, 1000), st.integers(3, 12)), max_size=6),
    clock=st.none() | st.floats(0, 1e9),
    provisional=st.booleans(),
)
def test_what_is_sent_is_what_arrives(shapes: list[tuple[int, int]], clock: float | None, provisional: bool) -> None:
    """Every field, planes within 1e-9 since the message holds them as a pose; arrays are read-only."""
    regions = tuple(_region(*shape) for shape in shapes)
    sent = _make(regions=regions, scan_end_clock=clock, provisional=provisional)
    received = decode_regions(encode_regions(sent))
    for name in RegionsMessage.__slots__:
        if name != "regions":
            assert getattr(sent, name) == getattr(received, name), name
    assert len(received.regions) == len(regions)
    for original, arrived in zip(regions, received.regions, strict=True):
        np.testing.assert_array_equal(original.halfspaces, arrived.halfspaces)
        np.testing.assert_array_equal(original.vertices, arrived.vertices)
        np.testing.assert_allclose(original.plane, arrived.plane, rtol=0, atol=1e-9)
        assert (original.sigma, original.area) == (arrived.sigma, arrived.area)
        assert not any(array.flags.writeable for array in (arrived.halfspaces, arrived.vertices, arrived.plane))


def test_the_form_is_as_the_definition_says() -> None:
    """Decoded as the .msg file says: the plane's normal from the quaternion, half-planes in threes."""
    sent = _make()
    message = decode(encode_regions(sent), REGIONS)
    for original, encoded in zip(sent.regions, message.regions, strict=True):
        q, p = encoded.plane_parameters.orientation, encoded.plane_parameters.position
        normal = np.array([2 * (q.x * q.z + q.w * q.y), 2 * (q.y * q.z - q.w * q.x), 1 - 2 * (q.x * q.x + q.y * q.y)])
        assert normal[2] > 0
        for corner in encoded.boundary:
            assert abs(normal @ [corner.x - p.x, corner.y - p.y, corner.z - p.z]) < 1e-12
        for k in range(len(encoded.halfspaces) // 3):
            a, b, c = encoded.halfspaces[3 * k : 3 * k + 3]
            assert a * p.x + b * p.y < c
        assert encoded.area == original.area


@pytest.mark.parametrize(
    ("change", "expected_text"),
    [
        ({"vertices": _region(1).vertices + [0, 0, 0.001]}, "not on its plane"),
        ({"vertices": _region(1).vertices + [0.2, 0, 0.2 * _region(1).plane[0]]}, "outside one of its half-planes"),
        ({"halfspaces": _region(1).halfspaces + [0, 0, 0.05]}, "enclose more than its corners"),
        ({"halfspaces": _region(1).halfspaces[:4]}, "enclose more than its corners"),
        ({"vertices": _region(1).vertices[[0, 1, 0]]}, "enclose more than its corners"),
        ({"vertices": _region(1).vertices[::-1]}, "corners are clockwise"),
        ({"halfspaces": 2 * _region(1).halfspaces}, "whose length is not 1"),
        ({"halfspaces": _region(1).halfspaces[:2]}, "region of 2 half-planes"),
        ({"vertices": np.zeros((0, 3))}, "region of 0 corners"),
        ({"plane": [0.0, math.nan, 0.0]}, "NaN"),
        ({"sigma": -1.0}, "sigma of a region is -1.0"),
    ],
)
def test_a_region_that_contradicts_itself_is_refused(change: dict[str, object], expected_text: str) -> None:
    """A planner that uses the half-planes and one that uses the corners must never see different areas."""
    with pytest.raises(MessageError, match=expected_text):
        dataclasses.replace(_region(1), **change)


def test_impossible_messages_are_refused() -> None:
    """Those that cannot be made, and those that are cut, damaged or of another version where they arrive."""
    with pytest.raises(MessageError, match="withdrawn, but has 2 regions"):
        _make(withdrawn=True)
    with pytest.raises(MessageError, match="1001 regions"):
        _make(regions=(_region(1),) * 1001)
    with pytest.raises(MessageError, match="valid_for"):
        _make(valid_for=math.nan)
    with pytest.raises(MessageError, match="run of SteppableRegions has 1000 characters"):
        _make(run="x" * 1000)
    payload = encode_regions(_make())
    for length in (0, 3, 40, len(payload) - 9):
        with pytest.raises(MessageError):
            decode_regions(payload[:length])
    message = decode(payload, REGIONS)
    message.version_major = 2
    with pytest.raises(VersionError, match="regions of version 2.0"):
        decode_regions(encode(message))
    message.version_major = 1
    message.regions[0].halfspaces = message.regions[0].halfspaces[:-1]
    with pytest.raises(MessageError, match="numbers; allowed: 3 for each"):
        decode_regions(encode(message))
    message = decode(payload, REGIONS)
    message.robot = "no/name"
    with pytest.raises(MessageError, match="SteppableRegions refused: robot name 'no/name'"):
        decode_regions(encode(message))
    message = decode(payload, REGIONS)
    turn = message.regions[0].plane_parameters.orientation
    turn.x, turn.y, turn.z, turn.w = 1.0, 0.0, 0.0, 0.0
    with pytest.raises(MessageError, match="does not face upwards"):
        decode_regions(encode(message))
