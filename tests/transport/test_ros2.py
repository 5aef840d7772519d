"""Tests of the bridge to ROS 2: keys, tokens, attachment, and a subscriber as rmw_zenoh declares it."""

import json
import logging
import struct
import threading

import numpy as np
import pytest
import zenoh.ext

import transport
from transport import ConfigurationError, zenoh_api
from transport.keys import grid_map_key, occupancy_key
from transport.links.publisher import Publisher
from transport.links.ros2 import (
    data_key,
    make_attachment,
    node_token_key,
    publisher_id,
    publisher_token_key,
)
from transport.messages.codec import decode

OCCUPANCY, GRID_MAP = "nav_msgs/msg/OccupancyGrid", "grid_map_msgs/msg/GridMap"
HASH = "RIHS01_8d348150c12913a31ee0ec170fbf25089e4745d17035792a1ba94d6f0bc0cfc7"


def test_keys_and_tokens_are_written_as_rmw_zenoh_writes_them() -> None:
    """The key has domain, topic, DDS type and hash; slashes of the topic become percent signs in the token."""
    kind = "nav_msgs::msg::dds_::OccupancyGrid_"
    assert data_key(3, "guara/occupancy", OCCUPANCY) == f"3/guara/occupancy/{kind}/{HASH}"
    assert node_token_key(0, "ab12") == "@ros2_lv/0/ab12/0/0/NN/%/%/guara_perception"
    assert publisher_token_key(0, "ab12", 10, "guara/occupancy", OCCUPANCY) == (
        f"@ros2_lv/0/ab12/0/10/MP/%/%/guara_perception/%guara%occupancy/{kind}/{HASH}/:1:,1:,:,:,,"
    )


def test_attachment_is_sequence_time_and_id() -> None:
    """33 bytes: sequence, time, the number 16, the id; the id is the token's hash, low half first."""
    key = publisher_token_key(0, "ab12", 10, "guara/occupancy", OCCUPANCY)
    identity = publisher_id(key)
    assert identity.hex() == "0e69c37e0b1fd43bee42cfe9fa2b51bb"
    attachment = make_attachment(2, 5, identity)
    assert len(attachment) == 33
    assert struct.unpack("<qqB16s", attachment) == (2, 5, 16, identity)


@pytest.mark.slow
def test_a_late_subscriber_gets_the_topic_as_from_a_ros_node(endpoint: str, peer) -> None:
    """A transient-local subscriber on the ROS 2 keys gets the last message of each topic with its attachment."""
    arrived: dict[str, tuple[bytes, bytes]] = {}
    tokens: set[str] = set()
    changed = threading.Condition()

    def note(sample) -> None:
        with changed:
            arrived[str(sample.key_expr).split("/")[2]] = (
                sample.payload.to_bytes(),
                sample.attachment.to_bytes(),
            )
            changed.notify_all()

    def see(key: str, is_alive: bool) -> None:
        with changed:
            tokens.add(key)
            changed.notify_all()

    terrain = peer.make_terrain(1)
    values = np.arange(9720, dtype=np.int64).reshape(108, 90) % 101
    with transport.open_node(listen=endpoint) as session:
        server = transport.PerceptionServer(session, ros2_domain=4)
        for _ in range(2):
            server.publish(terrain, occupancy=values.astype(np.int8))
            server.flush()
        with transport.open_client(endpoint) as client:
            subscribers = [
                zenoh.ext.declare_advanced_subscriber(
                    client.raw,
                    f"4/guara/{name}/**",
                    zenoh_api.direct(note),
                    history=zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=1),
                    recovery=zenoh.ext.RecoveryConfig(periodic_queries=None, heartbeat=True),
                )
                for name in ("occupancy", "grid_map")
            ]
            watcher = zenoh_api.watch_tokens(client.raw, "@ros2_lv/4/**", see)
            with changed:
                assert changed.wait_for(lambda: len(arrived) == 2 and len(tokens) == 4, 30.0)
            del subscribers, watcher
        zenoh_id = session.zenoh_id
    grid = decode(arrived["occupancy"][0], OCCUPANCY)
    np.testing.assert_array_equal(grid.data.reshape(108, 90), values)
    assert decode(arrived["grid_map"][0], "grid_map_msgs/msg/GridMap").layers[0] == "elevation"
    token = publisher_token_key(4, zenoh_id, 10, "guara/occupancy", OCCUPANCY)
    assert {node_token_key(4, zenoh_id), token} < tokens
    sequence, _, length, identity = struct.unpack("<qqB16s", arrived["occupancy"][1])
    assert (sequence, length, identity) == (2, 16, publisher_id(token))


def follow(client: transport.Session, key: str, depth: int) -> tuple[list[int], threading.Condition, object]:
    """Sequence numbers that a reliable, transient-local subscription of rmw_zenoh is handed."""
    sequences: list[int] = []
    changed = threading.Condition()

    def note(sample) -> None:
        with changed:
            sequences.append(struct.unpack_from("<q", sample.attachment.to_bytes())[0])
            changed.notify_all()

    subscriber = zenoh.ext.declare_advanced_subscriber(
        client.raw,
        key,
        zenoh_api.direct(note),
        history=zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=depth),
        recovery=zenoh.ext.RecoveryConfig(periodic_queries=None, heartbeat=True),
    )
    return sequences, changed, subscriber


@pytest.mark.slow
@pytest.mark.parametrize("depth", [1, 10])
def test_a_transient_local_subscriber_gets_each_message_once(endpoint: str, depth: int) -> None:
    """Early and late ones, in order, with history and recovery; what it asks for does not come a second time."""
    with transport.open_node(listen=endpoint) as session, transport.open_client(endpoint) as client:
        bridge = transport.Ros2Bridge(session, domain=4)
        key = data_key(4, "guara/occupancy", OCCUPANCY)
        early, changed, kept = follow(client, key, depth)
        for number in range(1, 7):
            bridge.put("occupancy", OCCUPANCY, b"\x00\x01\x00\x00" + bytes(1_000_000))
            with changed:
                assert changed.wait_for(lambda number=number: number in early, 60.0)
        late, changed, kept_too = follow(client, key, depth)
        with changed:
            assert changed.wait_for(lambda: late, 60.0)
        # After the beats that follow each message.
        beats = threading.Semaphore(0)
        session.pulse.add(beats, beats.release)
        for _ in range(4):
            assert beats.acquire(timeout=60.0)
        bridge.put("occupancy", OCCUPANCY, b"\x00\x01\x00\x00")
        with changed:
            assert changed.wait_for(lambda: 7 in late and 7 in early, 60.0)
        del kept, kept_too
    assert early == [1, 2, 3, 4, 5, 6, 7]
    assert late == [6, 7]


@pytest.mark.slow
def test_a_transient_local_subscriber_gets_what_the_link_lost(endpoint: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Dropped on a congested link, fetched by the subscriber: once."""
    with transport.open_node(listen=endpoint) as session, transport.open_client(endpoint) as client:
        bridge = transport.Ros2Bridge(session, domain=4)
        sequences, changed, kept = follow(client, data_key(4, "guara/occupancy", OCCUPANCY), 1)
        bridge.put("occupancy", OCCUPANCY, b"\x00\x01\x00\x00")
        with changed:
            assert changed.wait_for(lambda: sequences == [1], 60.0)
        with monkeypatch.context() as lost:
            lost.setattr(zenoh_api, "put", lambda *_, **__: None)
            bridge.put("occupancy", OCCUPANCY, b"\x00\x01\x00\x00")
        with changed:
            assert changed.wait_for(lambda: 2 in sequences, 60.0)
        bridge.put("occupancy", OCCUPANCY, b"\x00\x01\x00\x00")
        with changed:
            assert changed.wait_for(lambda: 3 in sequences, 60.0)
        del kept
    assert sequences == [1, 2, 3]


@pytest.mark.slow
@pytest.mark.parametrize("how", ["session", "server"])
def test_closing_while_messages_are_drawn_is_no_error(
    endpoint: str, peer, caplog: pytest.LogCaptureFixture, how: str
) -> None:
    """What is drawn for ROS 2 when the node is stopped is sent or given up, with no word of an error."""
    with transport.open_node(listen=endpoint) as session:
        server = transport.PerceptionServer(session, ros2_domain=4)
        drawing, go_on = threading.Event(), threading.Event()

        def draw(terrain):
            drawing.set()
            assert go_on.wait(60.0)
            for name in ("map/occupancy", "further/occupancy"):
                values = np.zeros(terrain.shape, np.int8)
                yield name, transport.occupancy_message(values, 0.005, (0.5, -0.27), "base_footprint", 1)

        server.draw_with(draw)
        server.publish(peer.make_terrain(1))
        assert drawing.wait(60.0)
        server.status_changed()
        closing = threading.Thread(target={"session": session, "server": server}[how].close)
        closing.start()
        while not (session.is_closed if how == "session" else server.is_closed):
            closing.join(0.01)
        go_on.set()
        closing.join(60.0)
        assert not closing.is_alive()
    assert not [record for record in caplog.records if record.levelno >= logging.WARNING], caplog.text


def test_a_publisher_is_undeclared_after_the_put_that_is_under_way(
    endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Zenoh refuses to undeclare a publisher that is in use."""
    done: list[str] = []
    begun, go_on = threading.Event(), threading.Event()

    def put(*_: object) -> None:
        begun.set()
        assert go_on.wait(60.0)
        done.append("put")

    monkeypatch.setattr(zenoh_api, "put", put)
    with transport.open_node(listen=endpoint) as session:
        publisher = Publisher(session, "guara/x", latched=False)
        undeclare = session.undeclare
        monkeypatch.setattr(session, "undeclare", lambda *raw: (done.append("undeclared"), undeclare(*raw)))
        threads = [threading.Thread(target=publisher.put, args=(b"",)), threading.Thread(target=publisher.close)]
        for thread in threads:
            thread.start()
            assert begun.wait(60.0)
        go_on.set()
        for thread in threads:
            thread.join(60.0)
    assert done == ["put", "undeclared"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("domain", "robot", "expected_text"),
    [
        (-1, "guara", "ROS domain is -1; allowed: 0 to 232"),
        (233, "guara", "ROS domain is 233"),
        (0, "a-b", "cannot be part of a ROS 2 topic"),
        (0, "1a", "cannot be part of a ROS 2 topic"),
    ],
)
def test_names_that_ros_does_not_take_are_refused(endpoint: str, domain: int, robot: str, expected_text: str) -> None:
    """Domain and robot name must be such that ROS 2 can use them."""
    with transport.open_node(listen=endpoint) as session:
        with pytest.raises(ConfigurationError, match=expected_text):
            transport.Ros2Bridge(session, robot=robot, domain=domain)


@pytest.mark.slow
def test_occupancy_and_grid_map_are_emptied_when_the_next_pause_begins(endpoint: str, peer) -> None:
    """They do not say of which pause they are: late subscribers, and those of ROS, get nothing of the one before."""
    epoch = {"epoch": "walk-a"}
    with transport.open_node(listen=endpoint) as session, transport.open_client(endpoint) as client:
        server = transport.PerceptionServer(session, ros2_domain=4)

        def newest(key: str) -> bytes:
            server.flush()
            (reply,) = (reply for reply in client.raw.get(key, timeout=30.0))
            return reply.ok.payload.to_bytes()

        def known() -> tuple[int, int]:
            occupancy = decode(newest(occupancy_key()), OCCUPANCY).data
            layers = decode(newest(grid_map_key()), GRID_MAP)
            elevation = layers.data[layers.layers.index("elevation")].data
            return int((occupancy < 100).sum()), int(np.isfinite(elevation).sum())

        def publish(step: int, **metadata: object) -> None:
            message = peer.make_terrain(step, step=step, metadata=json.dumps({**epoch, **metadata}))
            server.publish(message, occupancy=np.zeros(message.shape, np.int8))

        server.begin_step(1, "walk-a")
        publish(1, provisional=True)
        server.end_step()
        assert known() == (9720, 9719)
        server.begin_step(2, "walk-a")
        assert known() == (0, 0)
        # The grid of the pause before, confirmed late, does not bring its ground back.
        publish(1)
        assert known() == (0, 0)
        publish(2)
        assert known() == (9720, 9719)
        server.begin_step(2, "walk-b")
        assert known() == (0, 0)
