"""Queries whose replies are yielded one by one, until the last one, a deadline, or the loss of the server."""

from __future__ import annotations

import queue
import time
from collections.abc import Callable, Iterator
from functools import partial

from transport import zenoh_api
from transport.links.session import Session
from transport.zenoh_api import Reply

# Time added to the caller's timeout, so that a timeout reported by the server itself can still arrive [s].
GRACE = 0.5

# Interval of liveliness checks while waiting [s].
POLL = 0.05

ZENOH_TIMEOUT = b"Timeout"


# Ends of a query: after the last reply, at the deadline, or because the server has disappeared.
ENDED, TIMED_OUT, VANISHED = (Reply(end=reason) for reason in ("ended", "timed out", "vanished"))


def ask(
    session: Session,
    key: str,
    payload: bytes | bytearray,
    timeout: float,
    *,
    is_alive: Callable[[], bool] | None = None,
    priority: str = "INTERACTIVE_HIGH",
    encoding: str | None = None,
) -> Iterator[Reply]:
    """Send a query and yield its replies, then `ENDED`, `TIMED_OUT` or `VANISHED`.

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
    answers: queue.SimpleQueue[Reply] = queue.SimpleQueue()

    def on_reply(reply: Reply) -> None:
        answers.put(TIMED_OUT if reply.error == ZENOH_TIMEOUT else reply)

    deadline = time.monotonic() + timeout + GRACE
    query = partial(zenoh_api.get_replies, payload=payload, priority=priority, encoding=encoding)
    on_end = partial(answers.put, ENDED)
    session.attempt(f"cannot ask {key!r}", query, session.raw, key, timeout + GRACE, on_reply, on_end)
    while True:
        remaining = deadline - time.monotonic()
        if remaining <= 0.0:
            yield TIMED_OUT
            return
        try:
            answer = answers.get(timeout=min(POLL, remaining))
        except queue.Empty:
            if is_alive is not None and not is_alive():
                yield VANISHED
                return
            continue
        yield answer
        if answer.end:
            return
