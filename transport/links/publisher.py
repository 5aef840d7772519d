"""Publishers of a single key: plain ones, and latched ones, which keep the last message for late subscribers."""

from __future__ import annotations

import threading
from collections.abc import Callable

from transport import zenoh_api
from transport.links.last_message import LastMessage, MadeOnce, Payload
from transport.links.outbox import Outbox
from transport.links.session import Resource, Session
from transport.supervision import CLOSE_TIMEOUT

# Each priority has its own queue on each link, so that small messages do not wait for large ones.
URGENT = "INTERACTIVE_HIGH"
SMALL = "INTERACTIVE_LOW"
LARGE = "DATA_LOW"
LARGEST = "BACKGROUND"


class Publisher(Resource):
    """Publisher of one key. A latched publisher keeps the last payload for late subscribers.

    A payload is dropped only for readers whose link is congested. If the publisher is latched, `NewestReceiver` then
    fetches the payload in pieces.

    Attributes:
        key: key on which payloads are published.
        count: number of successful calls of `put`.
    """

    def __init__(
        self,
        session: Session,
        key: str,
        *,
        latched: bool = True,
        priority: str = LARGE,
        encoding: str | None = None,
        answers: bool = False,
        stamped: bool = False,
        attach: Callable[[int], bytes] | None = None,
    ) -> None:
        """Declare the key.

        Args:
            session: open session.
            key: key on which to publish.
            latched: True = late subscribers receive the last payload, and receivers detect losses.
            priority: priority on congested links, one of `URGENT`, `SMALL`, `LARGE`, `LARGEST`.
            encoding: Zenoh encoding of the payloads, such as `typestore.cdr(type_name)`; None = unspecified.
            answers: True = a query (`get`) of the key itself returns the last payload; needs `latched`.
            stamped: True = identify payloads by timestamps instead of numbers. Zenoh's advanced subscribers then
                receive each payload once, but `NewestReceiver` does not detect losses.
            attach: returns the attachment of the payload with the given number; the first has number 0.

        Raises:
            SessionClosed: the session is closed.
            TransportError: the key is not valid.
        """
        self.key = key
        self._lock, self._attach = threading.Lock(), attach
        self.count = 0
        what = f"cannot publish on {key!r}"
        self._raw = session.attempt(what, zenoh_api.declare_publisher, session.raw, key, priority, encoding)
        self._last: LastMessage | None = None
        self._stamps = zenoh_api.Stamps() if stamped else None
        source = zenoh_api.source_of(self._raw.id) if self._stamps is None else self._stamps.source
        if latched:
            kinds = {"answers": answers, "stamped": stamped}
            self._last = session.attempt(what, LastMessage, session, key, source, encoding, **kinds)
        super().__init__(session)

    def put(self, payload: Payload | Callable[[], Payload]) -> None:
        """Publish a payload. It is not an error if there are no subscribers or the link is down.

        Args:
            payload: payload, or a function that makes it when a subscriber or a later query needs it.

        Raises:
            SessionClosed: the session is closed.
            TransportError: Zenoh reported another error.
        """
        with self._lock:
            number = self.count
            made = MadeOnce(payload if callable(payload) else lambda: payload)
            attachment = None if self._attach is None else self._attach(number)
            stamp = None if self._stamps is None else self._stamps.next()
            if self._last is not None:
                self._last.keep(number, made, attachment, stamp)
            if not callable(payload) or zenoh_api.has_subscribers(self._raw):
                what = f"cannot send on {self.key!r}"
                self._session.attempt(what, zenoh_api.put, self._raw, made(), attachment, number, stamp)
            self.count += 1
            if self._last is not None:
                self._last.announce()

    def forget(self) -> None:
        """Keep no payload for late subscribers until the next one is published."""
        if self._last is not None:
            self._last.forget()

    def _release(self) -> None:
        if self._last is not None:
            self._last.close()
        # Zenoh cannot undeclare a publisher that another thread is using; it is then undeclared when the session is
        # closed.
        if self._lock.acquire(timeout=CLOSE_TIMEOUT):
            try:
                self._session.undeclare(self._raw)
            finally:
                self._lock.release()


class Sender(Resource):
    """Group of publishers and queryables with a common outbox, through which subclasses send without waiting."""

    def __init__(self, session: Session, *parts: Resource) -> None:
        """Take ownership of `parts`, which are closed in this order, after the outbox."""
        self._outbox, self._parts = Outbox(), parts
        super().__init__(session)

    def flush(self, timeout: float) -> None:
        """Wait until everything is sent; ReceiveTimeout if this takes longer than `timeout` [s]."""
        self._outbox.flush(timeout)

    def _release(self) -> None:
        self._outbox.close()
        for part in self._parts:
            part.close()
