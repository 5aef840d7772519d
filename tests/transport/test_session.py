"""Tests of opening and closing sessions, and of the outbox."""

import threading
import time

import pytest

import transport
from transport import ConfigurationError, ConnectionFailed, ReceiveTimeout, SessionClosed


def test_unreachable_router_says_what_to_check(endpoint: str) -> None:
    """One message names all causes that Zenoh does not tell apart, and no path of its build machine."""
    with pytest.raises(ConnectionFailed) as caught:
        transport.open_client(endpoint, timeout=0.3)
    message = str(caught.value)
    for part in (endpoint, "0.3 s", "is the node running", "certificate", "password", "RUST_LOG=warn"):
        assert part in message
    assert ".rs" not in message
    assert isinstance(caught.value, ConnectionError)


@pytest.mark.slow
def test_taken_port_says_what_to_check(endpoint: str) -> None:
    """A second node on one port is refused with what may be the cause."""
    with transport.open_node(listen=endpoint):
        with pytest.raises(ConnectionFailed, match=r"Address already in use.*another node or a Zenoh router"):
            transport.open_node(listen=endpoint)


def test_open_port_without_security_is_refused() -> None:
    """A node does not listen beyond this machine unless that was asked for."""
    with pytest.raises(ConfigurationError, match="nothing protects it"):
        transport.open_node(listen="tcp/0.0.0.0:0")


@pytest.mark.slow
def test_client_waits_for_a_router_that_comes_later(endpoint: str) -> None:
    """A client that starts first connects as soon as the node is there."""
    nodes: list[transport.Session] = []

    def come_later() -> None:
        time.sleep(0.5)
        nodes.append(transport.open_node(listen=endpoint))

    thread = threading.Thread(target=come_later)
    thread.start()
    with transport.open_client(endpoint, timeout=180.0) as client:
        assert client.links() == (endpoint,)
    thread.join()
    nodes[0].close()


@pytest.mark.slow
def test_a_closed_session_says_so(endpoint: str) -> None:
    """Whatever is done with a closed session ends in SessionClosed, and closing twice is fine."""
    session = transport.open_node(listen=endpoint)
    publisher = transport.Publisher(session, "a/b")
    receiver = transport.NewestReceiver(session, "a/b", bytes)
    session.close()
    session.close()
    assert session.is_closed and session.links() == ()
    with pytest.raises(SessionClosed):
        publisher.put(b"x")
    with pytest.raises(SessionClosed):
        transport.Publisher(session, "a/b")
    with pytest.raises(SessionClosed):
        receiver.wait_for(lambda _: True, 1.0)
    with pytest.raises(SessionClosed):
        receiver.on_newest(print)


@pytest.mark.slow
def test_a_key_that_zenoh_refuses_is_our_error(endpoint: str) -> None:
    """Zenoh's own error class does not get out."""
    with transport.open_node(listen=endpoint) as session:
        with pytest.raises(transport.OperationFailed, match="cannot publish on '/a/'"):
            transport.Publisher(session, "/a/")


@pytest.mark.slow
def test_no_thread_is_left_after_close(endpoint: str, eventually, peer) -> None:
    """All threads that the package starts end with the session."""
    before = set(threading.enumerate())
    with transport.open_node(listen=endpoint) as session:
        server = transport.PerceptionServer(session)
        server.serve_scans(lambda job: peer.make_terrain())
        with transport.PerceptionClient(transport.open_client(endpoint)) as client:
            client.on_terrain(lambda _: None)
            assert len(set(threading.enumerate()) - before) >= 5
    assert eventually(lambda: set(threading.enumerate()) <= before)


def test_outbox_keeps_the_newest_of_each_key_in_order() -> None:
    """While one action runs, a newer one replaces an older of the same key; the rest stays in order."""
    outbox, done, release = transport.Outbox(), [], threading.Event()
    outbox.post("first", lambda: release.wait(30.0))
    for number in range(3):
        outbox.post("a", lambda number=number: done.append(("a", number)))
        outbox.post("b", lambda number=number: done.append(("b", number)))
    with pytest.raises(ReceiveTimeout, match="were not sent within 0.01 s"):
        outbox.flush(0.01)
    release.set()
    outbox.flush(30.0)
    assert done == [("a", 2), ("b", 2)]
    assert outbox.superseded == 4 and outbox.sent == 3
    outbox.close()
    with pytest.raises(SessionClosed):
        outbox.post("a", lambda: None)


def test_outbox_survives_an_action_that_fails() -> None:
    """An error is counted and kept as text, and the next action runs."""
    outbox, done = transport.Outbox(), []
    outbox.post("a", lambda: 1 / 0)
    outbox.post("b", lambda: done.append(1))
    outbox.flush(30.0)
    outbox.close()
    assert (outbox.failed, done) == (1, [1])
    assert outbox.last_error == "a: division by zero"


def test_posting_never_waits_for_what_is_being_sent() -> None:
    """A put that hangs holds the outbox thread, not the one that posts."""
    outbox, release = transport.Outbox(), threading.Event()
    outbox.post("a", lambda: release.wait(60.0))
    for _ in range(1000):
        outbox.post("b", lambda: None)
    assert outbox.sent == 0 and outbox.superseded == 999
    release.set()
    outbox.close()
