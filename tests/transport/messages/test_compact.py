"""Tests of the compact form: each layer to its safe side, whole or refused, and chosen by key or by question."""

import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import zenoh
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import transport
from transport import MessageError, keys
from transport.messages.scan_messages import encode_query_request
from transport.messages.shuffle import compress
from transport.messages.terrain_message import ROUND, ROUNDING, encode_compact, rounded

PATIENCE = 30.0
DOWN, UP = ("elevation_min", "clearance", "traversability"), ("elevation_max", "variance", "slope", "step_height")
# Values that a layer may hold, subnormal, huge and infinite ones among them.
ANY = st.floats(width=32, allow_nan=True, allow_infinity=True)
POSITIVE = st.floats(min_value=0.0, width=32) | st.just(np.nan)


def layer(elements: st.SearchStrategy[float]) -> st.SearchStrategy[np.ndarray]:
    return hnp.arrays(np.float32, st.tuples(st.integers(1, 4), st.integers(1, 5)), elements=elements)


@pytest.mark.slow
@given(layer(ANY), layer(POSITIVE))
def test_no_value_goes_to_the_wrong_side(any_values: np.ndarray, positive: np.ndarray) -> None:
    """Whatever floats there are; what is not known stays so, and rounded again nothing changes."""
    for name, to_round in ROUND.items():
        values = positive if name in ("variance", "traversability") else any_values
        result = to_round(values)
        assert result.dtype == np.float32 and result.shape == values.shape
        np.testing.assert_array_equal(np.isnan(result), np.isnan(values))
        known = ~np.isnan(values)
        if name in DOWN:
            assert (result <= values)[known].all()
        elif name == "elevation":
            finite = np.isfinite(values)
            off = result[finite].astype(np.float64) - values[finite]
            assert (np.abs(off) <= ROUNDING["elevation"]).all()
        else:
            assert (result >= values)[known].all()
        np.testing.assert_array_equal(to_round(result), result)
    np.testing.assert_array_equal(ROUND["traversability"](positive) > 0, positive > 0)
    np.testing.assert_array_equal(np.isinf(ROUND["variance"](positive)), np.isinf(positive))


@given(layer(st.floats(-100.0, 100.0, width=32)), st.floats(0.0, 0.01))
def test_an_elevation_stays_between_its_samples(centre: np.ndarray, span: float) -> None:
    low, high = (centre + np.float32(sign * span) for sign in (-1, 1))
    elevation = ROUND["elevation"](centre)
    assert (ROUND["elevation_min"](low) <= elevation).all() and (elevation <= ROUND["elevation_max"](high)).all()


def test_what_was_sent_is_the_rounded_message(peer: Any) -> None:
    """All else of the message as it was; the metadata say by how much numbers are off."""
    terrain = peer.make_terrain(4)
    received = transport.decode_terrain(encode_compact(terrain))
    expected = rounded(terrain)
    for name in transport.LAYERS:
        np.testing.assert_array_equal(received.layers[name], expected.layers[name])
    for name in ("hazard", "age", "looks"):
        np.testing.assert_array_equal(received.layers[name], terrain.layers[name])
    assert json.loads(received.metadata) == {"a": 1, "rounding": {"elevation": 2.0**-14, "variance": 0.125}}
    same = ("robot", "sequence", "step", "stamp", "valid_for", "resolution", "origin", "stance", "point_counts")
    assert all(getattr(received, name) == getattr(terrain, name) for name in same)
    assert len(received.obstacles) == 1 and len(received.transforms) == 2


@pytest.mark.slow
def test_a_damaged_compact_message_is_refused(peer: Any) -> None:
    """Cut at every seventh byte, or whole with something else inside."""
    payload = encode_compact(peer.make_terrain(1, shape=(4, 5)))
    for length in range(0, len(payload), 7):
        with pytest.raises(MessageError):
            transport.decode_terrain(payload[:length])
    with pytest.raises(MessageError, match="are not a guara_msgs/msg/Terrain"):
        transport.decode_terrain(compress(b"\x00\x01\x00\x00 nothing"))
    with pytest.raises(MessageError, match="refused; allowed"):
        transport.decode_terrain(compress(bytes(70_000_000)))


@pytest.fixture
def node(start: Callable[..., Any], endpoint: str) -> Any:
    """A node in another process."""
    return start("node", endpoint, "listen")


def test_a_client_chooses_it_and_others_get_what_they_got(node: Any, endpoint: str) -> None:
    """The same pause on both keys; scan requests and questions follow the choice."""
    node.tell("publish 1")
    node.tell("map 1")
    with transport.PerceptionClient(transport.open_client(endpoint, timeout=PATIENCE), encoding="compact") as client:
        for extent in ("footprint", "map"):
            grid = client.wait_for_step(1, timeout=PATIENCE, extent=extent, max_age=1e12)
            assert "rounding" in json.loads(grid.metadata) and client.latest(extent=extent, max_age=1e12) is grid
            assert (
                client.receiver(extent).key == f"guara/perception/v1/compact/{'terrain' if extent[0] == 'f' else 'map'}"
            )
        assert "rounding" in json.loads(client.query().metadata)
        assert client.query(region=(0.6, 0.7, 0.0, 0.1)).shape == (20, 20)
        assert "rounding" in json.loads(client.request_scan(timeout=PATIENCE).metadata)
    with transport.PerceptionClient(transport.open_client(endpoint, timeout=PATIENCE)) as client:
        assert "rounding" not in json.loads(client.wait_for_step(1, timeout=PATIENCE).metadata)
        assert "rounding" not in json.loads(client.query().metadata)


def test_plain_zenoh_sees_which_is_which(node: Any, endpoint: str) -> None:
    """Encodings of the keys and of the answers; whoever asks for `terrain` gets plain CDR."""
    configuration = zenoh.Config()
    configuration.insert_json5("mode", '"client"')
    configuration.insert_json5("connect/endpoints", f'["{endpoint}"]')
    node.tell("publish 1")
    compact_encoding = "application/zstd;shuffle=4;application/cdr;guara_msgs/msg/Terrain"
    with zenoh.open(configuration) as session:
        for key, encoding in (
            ("compact/terrain", compact_encoding),
            ("terrain", "application/cdr;guara_msgs/msg/Terrain"),
        ):
            for _ in range(100):
                (reply,) = session.get(f"guara/perception/v1/{key}", timeout=5.0)
                if reply.ok is not None:
                    break
            assert str(reply.ok.encoding) == encoding
        question = encode_query_request(transport.QueryRequest(extent="footprint", region=None))
        (reply,) = session.get("guara/perception/v1/query?encoding=compact", payload=question, timeout=5.0)
        assert str(reply.ok.encoding) == compact_encoding
        (reply,) = session.get("guara/perception/v1/query?encoding=other", payload=question, timeout=5.0)
        assert str(reply.ok.encoding) == "application/cdr;guara_msgs/msg/Terrain"


@pytest.mark.slow
def test_a_node_of_an_earlier_version_is_named_as_the_cause(endpoint: str, peer: Any) -> None:
    """It has a sign of life and a lossless grid: the message says so, or the lossless answer is taken."""
    with transport.open_node(listen=endpoint) as node:
        publisher = transport.Publisher(node, keys.terrain_key())
        publisher.put(transport.encode_terrain(peer.make_terrain(1, shape=(4, 5))))
        token = transport.AliveToken(node, keys.alive_key())
        answers = transport.encode_terrain(peer.make_terrain(1, shape=(4, 5)))
        queryable = node.raw.declare_queryable(
            keys.query_key(), lambda query: (query.reply(keys.query_key(), answers), query.drop())
        )
        with transport.open_client(endpoint, timeout=PATIENCE) as session:
            client = transport.PerceptionClient(session, encoding="compact")
            assert client.wait_until_alive(PATIENCE)
            with pytest.raises(transport.StaleTerrain, match="earlier versions do not support encoding 'compact'"):
                client.latest()
            assert transport.query_terrain(session, encoding="compact").sequence == 1
        queryable.undeclare()
        token.close()


def test_an_unknown_encoding_is_refused_in_words(endpoint: str) -> None:
    with transport.open_node(listen=endpoint) as session:
        for use in (
            lambda: transport.PerceptionClient(session, encoding="lossy"),
            lambda: transport.query_terrain(session, encoding="lossy"),
            lambda: keys.terrain_key(encoding="lossy"),
        ):
            with pytest.raises(transport.KeyNameError, match="encoding is 'lossy'; allowed: 'lossless', 'compact'"):
                use()
