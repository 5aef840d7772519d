"""What Zenoh alone shows of a node: keys, encodings, and the last grid for whoever asks; no code of ours reads it."""

import queue
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import zenoh

import transport
from transport import decode, keys
from transport.links.publisher import Publisher
from transport.messages.scan_messages import QueryRequest, ScanRequest, encode_query_request, encode_scan_request
from transport.security.folder import load_configuration

PATIENCE = 30.0
PREFIX = "guara/perception/v1"
# Key of the node -> encoding of its samples.
ENCODINGS = {
    "terrain": "application/cdr;guara_msgs/msg/Terrain",
    "map": "application/cdr;guara_msgs/msg/Terrain",
    "occupancy": "application/cdr;nav_msgs/msg/OccupancyGrid",
    "grid_map": "application/cdr;grid_map_msgs/msg/GridMap",
    "status": "application/cdr;diagnostic_msgs/msg/DiagnosticArray",
}


def plain_session(endpoint: str) -> zenoh.Session:
    configuration = zenoh.Config()
    configuration.insert_json5("mode", '"client"')
    configuration.insert_json5("connect/endpoints", f'["{endpoint}"]')
    return zenoh.open(configuration)


@pytest.fixture
def node(start: Callable[..., Any], endpoint: str) -> Any:
    """A node in another process that has published both extents."""
    process = start("node", endpoint, "listen")
    process.tell("publish 1")
    process.tell("map 1")
    return process


@pytest.fixture
def session(node: Any, endpoint: str) -> Iterator[zenoh.Session]:
    with plain_session(endpoint) as opened:
        yield opened


def replies(session: zenoh.Session, key: str, **given: Any) -> list[zenoh.Reply]:
    return list(session.get(key, timeout=5.0, consolidation=zenoh.ConsolidationMode.NONE, **given))


def eventually_asked(session: zenoh.Session, key: str) -> zenoh.Reply:
    """The reply on a key; the node may still be encoding its first grid."""
    for _ in range(100):
        for reply in replies(session, key):
            if reply.ok is not None:
                return reply
    raise AssertionError(f"no answer on {key}")


def test_every_sample_says_what_it_is(session: zenoh.Session, node: Any) -> None:
    """Encoding and schema name the type by which the payload decodes, for whoever only knows that Zenoh carries CDR."""
    heard: queue.SimpleQueue[zenoh.Sample] = queue.SimpleQueue()
    session.declare_subscriber(f"{PREFIX}/*", heard.put)
    found: dict[str, str] = {}
    sequence = 2
    while set(found) != set(ENCODINGS):
        node.tell(f"publish {sequence}")
        node.tell(f"map {sequence}")
        sequence += 1
        sample = heard.get(timeout=PATIENCE)
        name = str(sample.key_expr).removeprefix(f"{PREFIX}/")
        found[name] = str(sample.encoding)
        decode(sample.payload.to_bytes(), found[name].removeprefix("application/cdr;"))
    assert found == ENCODINGS


def test_a_mirrored_topic_says_what_it_is(session: zenoh.Session, node: Any) -> None:
    """What rmw_zenoh reads has an encoding too, which rmw_zenoh itself ignores."""
    heard: queue.SimpleQueue[zenoh.Sample] = queue.SimpleQueue()
    session.declare_subscriber("0/guara/occupancy/**", heard.put)
    for sequence in range(2, 50):
        node.tell(f"publish {sequence}")
        try:
            sample = heard.get(timeout=1.0)
        except queue.Empty:
            continue
        assert str(sample.encoding) == ENCODINGS["occupancy"]
        return
    raise AssertionError("nothing arrived")


@pytest.mark.parametrize("name", sorted(set(ENCODINGS) - {"status"}))
def test_asking_on_the_key_of_a_grid_gives_the_newest(session: zenoh.Session, node: Any, name: str) -> None:
    """Whoever joins late and knows nothing of advanced subscribers asks once, and needs no message to do so."""
    reply = eventually_asked(session, f"{PREFIX}/{name}")
    assert str(reply.ok.key_expr) == f"{PREFIX}/{name}"
    assert str(reply.ok.encoding) == ENCODINGS[name]
    first = reply.ok.payload.to_bytes()
    node.tell("map 7" if name == "map" else "publish 7")
    for _ in range(100):
        newest = eventually_asked(session, f"{PREFIX}/{name}").ok.payload.to_bytes()
        if newest != first:
            break
    message = decode(newest, ENCODINGS[name].removeprefix("application/cdr;"))
    if name in ("terrain", "map"):
        assert message.sequence == 7 and transport.decode_terrain(newest).sequence == 7


def test_asking_before_there_is_a_grid_is_refused_in_words(start: Callable[..., Any], endpoint: str) -> None:
    """An error reply with a Refusal, as `query` gives it."""
    start("node", endpoint, "listen")
    with plain_session(endpoint) as session:
        (reply,) = replies(session, f"{PREFIX}/map")
        assert str(reply.err.encoding) == "application/cdr;guara_msgs/msg/Refusal"
        refusal = decode(reply.err.payload.to_bytes(), "guara_msgs/msg/Refusal")
        assert refusal.code == "no_terrain" and f"nothing has been published on '{PREFIX}/map' yet" == refusal.message


def test_replies_say_what_they_are(session: zenoh.Session) -> None:
    """Replies to a query, a scan request and a query of the status, and refusals; requests need no encoding."""
    eventually_asked(session, f"{PREFIX}/map")
    query = encode_query_request(QueryRequest(extent="map", region=None))
    (reply,) = replies(session, f"{PREFIX}/query", payload=query)
    assert str(reply.ok.encoding) == ENCODINGS["map"]
    (reply,) = replies(session, f"{PREFIX}/query", payload=b"nonsense")
    assert str(reply.err.encoding) == "application/cdr;guara_msgs/msg/Refusal"
    (reply,) = replies(session, f"{PREFIX}/status")
    assert str(reply.ok.encoding) == ENCODINGS["status"]
    request = encode_scan_request(ScanRequest(id="plain", mode="coarse", timeout=20.0))
    said = {str(reply.ok.encoding) for reply in replies(session, f"{PREFIX}/scan", payload=request)}
    assert said == {"application/cdr;guara_msgs/msg/ScanReply"}
    request = encode_scan_request(ScanRequest(id="walking", mode="coarse", timeout=20.0))
    (reply,) = replies(session, f"{PREFIX}/scan", payload=request)
    assert str(reply.err.encoding) == "application/cdr;guara_msgs/msg/Refusal"


def test_questions_and_announcements_of_ours_say_what_they_are(endpoint: str, peer: Any) -> None:
    """Seen by a plain queryable and a plain subscriber that stand in for the node."""
    asked: queue.SimpleQueue[tuple[str, str]] = queue.SimpleQueue()

    def note(query: zenoh.Query) -> None:
        asked.put((str(query.key_expr), str(query.encoding)))
        query.drop()

    with transport.open_node(listen=endpoint) as other:
        for name in ("query", "scan"):
            other.raw.declare_queryable(f"{PREFIX}/{name}", note)
        other.raw.declare_subscriber("guara/gait/v1/stance", lambda sample: asked.put(("stance", str(sample.encoding))))
        with transport.open_client(endpoint, timeout=PATIENCE) as session:
            for question in (
                lambda: transport.query_terrain(session, timeout=1.0),
                lambda: transport.request_scan(session, timeout=1.0),
            ):
                with pytest.raises(transport.TransportError):
                    question()
            gait = transport.StancePublisher(session)
            found = dict(asked.get(timeout=PATIENCE) for _ in range(2))
            for step in range(1000):
                phase = transport.PausePhase.BEGIN
                pause = transport.StancePause(robot="guara", step=step, phase=phase, stamp=1, stance=peer.make_stance())
                gait.publish(pause)
                try:
                    found |= dict([asked.get(timeout=0.1)])
                except queue.Empty:
                    continue
                break
    assert found == {
        f"{PREFIX}/query": "application/cdr;guara_msgs/msg/QueryRequest",
        f"{PREFIX}/scan": "application/cdr;guara_msgs/msg/ScanRequest",
        "stance": "application/cdr;guara_msgs/msg/StancePause",
    }


@pytest.mark.parametrize("encoding", [None, "zenoh/bytes", "application/json"])
def test_a_node_whose_samples_say_nothing_is_heard(endpoint: str, peer: Any, encoding: str | None) -> None:
    """Earlier versions say nothing, others may say something else: the payload decides."""
    with transport.open_node(listen=endpoint) as node:
        publisher = Publisher(node, keys.terrain_key(), encoding=encoding)
        with transport.open_client(endpoint, timeout=PATIENCE) as session:
            receiver = transport.NewestReceiver(session, keys.terrain_key(), transport.decode_terrain)
            publisher.put(transport.encode_terrain(peer.make_terrain(3, shape=(4, 5))))
            assert receiver.wait_for(lambda terrain: True, PATIENCE).message.sequence == 3


@pytest.mark.slow
def test_only_who_may_query_may_ask_on_the_keys(start: Callable[..., Any], endpoint: str, tmp_path: Path) -> None:
    """Planner and viewer get the grid, the gait gets nothing and learns nothing."""
    folder = transport.init_security(tmp_path / "keys")
    secure = endpoint.replace("tcp/127.0.0.1", "tls/localhost")
    node = start("node", secure, "listen", str(folder))
    node.tell("publish 1")
    for role in ("planner", "viewer", "gait"):
        text = load_configuration(folder / role, connect=secure)
        with zenoh.open(zenoh.Config.from_json5(text)) as session:
            if role == "gait":
                assert replies(session, f"{PREFIX}/terrain") == []
            else:
                assert str(eventually_asked(session, f"{PREFIX}/terrain").ok.encoding) == ENCODINGS["terrain"]
