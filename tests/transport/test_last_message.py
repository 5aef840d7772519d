"""What a publisher keeps: its last message, and earlier ones that a reader is in the middle of fetching."""

from __future__ import annotations

import threading

from transport import open_node, zenoh_api
from transport.links.last_message import PIECE, pieces_key
from transport.links.publisher import Publisher
from transport.links.session import Session


def _ask(session: Session, key: str, number: int) -> tuple[int, bytes]:
    """Number and content of what is answered to a question for all of one message."""
    found: list[tuple[int, bytes]] = []
    finished = threading.Event()
    zenoh_api.get_replies(
        session.raw,
        f"{pieces_key(key)}?piece=0;size=1000;number={number}",
        20.0,
        lambda reply: found.append((PIECE.unpack(reply.attachment)[0], reply.payload)),
        finished.set,
        is_dropped=True,
    )
    assert finished.wait(60.0)
    (answer,) = found
    return answer


def test_a_message_that_was_asked_for_stays_and_others_go_with_the_next(endpoint: str) -> None:
    with open_node(listen=endpoint) as session:
        publisher = Publisher(session, "rex/kept")
        publisher.put(b"first")
        assert _ask(session, publisher.key, 0) == (0, b"first")
        publisher.put(b"second")
        publisher.put(b"third")
        assert _ask(session, publisher.key, 0) == (0, b"first")
        assert _ask(session, publisher.key, 1) == (2, b"third")
        assert _ask(session, publisher.key, -1) == (2, b"third")
        # Of those that were asked for, the three latest.
        for text in (b"fourth", b"fifth", b"sixth"):
            publisher.put(text)
            _ask(session, publisher.key, -1)
        assert _ask(session, publisher.key, 0) == (5, b"sixth")
        assert _ask(session, publisher.key, 3) == (3, b"fourth")
