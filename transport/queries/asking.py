"""Queries whose replies are yielded one by one, until the last one, a deadline, or the loss of the server."""

from __future__ import annotations

import queue
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from transport import zenoh_api
from transport.links.session import Session

# Time added to the caller's timeout, so that a timeout reported by the server itself can still arrive [s].
GRACE = 0.5

# Interval of liveliness checks while waiting [s].
POLL = 0.05

ZENOH_TIMEOUT = b"Timeout"


@dataclass(frozen=True, slots=True)
class Answer:
    """Event of a query: a reply, an error, or the end of the query.

    Attributes:
        key: key of a reply. With security, it identifies the sender, because access rules restrict who may use the key.
        payload: payload of a reply, or None.
        error: payload of an error reply, or None.
        timed_out: True if the deadline has passed.
        vanished: True if the server disappeared while the query was open.
        ended: True if no more replies will follow.
    """

    key: str = ""
    payload: bytes | None = None
    error: bytes | None = None
    timed_out: bool = False
    vanished: bool = False
    ended: bool = False


def ask(
    session: Session,
    key: str,
    payload: bytes | bytearray,
    timeout: float,
    *,
    is_alive: Callable[[], bool] | None = None,
    priority: str = "INTERACTIVE_HIGH",
    encoding: str | None = None,
) -> Iterator[Answer]:
    """Send a query and yield its events; the last event is `ended`, `timed_out` or `vanished`.

    Args:
        session: open session.
        key: key of the queryable.
        payload: payload of the query.
        timeout: time granted to the server [s]; the caller waits up to `GRACE` longer. Ctrl-C ends the wait.
        is_alive: returns True while the server is alive; called repeatedly while waiting.
        priority: name of the Zenoh priority of the query and its replies.
        encoding: Zenoh encoding of the payload.

    Raises:
        SessionClosed: the session is closed.
        TransportError: Zenoh rejected the query.
    """
    answers: queue.SimpleQueue[Answer] = queue.SimpleQueue()

    def on_reply(reply: zenoh_api.Reply) -> None:
        is_late = reply.error == ZENOH_TIMEOUT
        answers.put(Answer(timed_out=True) if is_late else Answer(reply.key, reply.payload, reply.error))

    deadline = time.monotonic() + timeout + GRACE
    session.attempt(
        lambda: zenoh_api.get_replies(
            session.raw,
            key,
            timeout + GRACE,
            on_reply,
            lambda: answers.put(Answer(ended=True)),
            payload=payload,
            priority=priority,
            encoding=encoding,
        ),
        f"cannot ask {key!r}",
    )
    while True:
        remaining = deadline - time.monotonic()
        if remaining <= 0.0:
            yield Answer(timed_out=True)
            return
        try:
            answer = answers.get(timeout=min(POLL, remaining))
        except queue.Empty:
            if is_alive is not None and not is_alive():
                yield Answer(vanished=True)
                return
            continue
        yield answer
        if answer.ended or answer.timed_out:
            return
