"""Last message of a publisher, kept for late subscribers and for slow links, which query it in pieces.

Keys and heartbeat are the same as in Zenoh's advanced publisher, so advanced subscribers (including rmw_zenoh) are
served too. Zenoh's own publisher replies to late joiners on the thread and under the lock of its puts, so one slow
joiner delays all readers for seconds. Here every query is answered on a thread of its own.

A reply cannot carry the number of the message (Zenoh's Python API has no argument for it), so an advanced subscriber
may get a message twice: once published and once as a reply. A `stamped` publisher identifies messages by timestamps,
which replies do carry, so each is delivered once; its subscribers query again when the token is declared anew.
"""

from __future__ import annotations

import logging
import math
import struct
import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from functools import partial
from typing import Any

from transport import zenoh_api
from transport.exceptions import TransportError
from transport.links.answerer import Answerer, refuse
from transport.links.session import Session

logger = logging.getLogger(__name__)
# Largest number of pending queries; more are dropped, and repeated by the readers.
MAXIMUM_ANSWERS = 16
# Largest piece [bytes]; it fits into the queue of a link (`configuration.QUEUES`).
MAXIMUM_PIECE = 768 * 1024
# Number of older messages kept for readers that are still fetching them, and the time for which they are kept after a
# query [s]; a message that was never queried is dropped when the next one is published.
KEPT = 3
KEPT_FOR = 10.0
# Attachment of a piece: number of the message, its length in bytes, offset of the piece in it.
PIECE = struct.Struct("<QQQ")
Payload = bytes | bytearray


class MadeOnce:
    """Payload that is encoded at its first use and cached."""

    def __init__(self, make: Callable[[], Payload]) -> None:
        """Encode by `make` when needed."""
        self._make: Callable[[], Payload] | None = make
        self._made: Payload = b""
        self._lock = threading.Lock()

    def __call__(self) -> Payload:
        """Return the payload."""
        with self._lock:
            if self._make is not None:
                self._made, self._make = self._make(), None
            return self._made


# Query time of a message that was never queried, and entry used for a number that is not kept.
NEVER = -math.inf
NOTHING: tuple[MadeOnce, bytes | None, float] = (MadeOnce(bytes), None, NEVER)


def announcement_key(key: str, source: str = "*/*") -> str:
    """Key on which the number of the last message is announced, and which advanced subscribers query."""
    return f"{key}/@adv/pub/{source}/_"


def pieces_key(key: str, source: str = "*/*") -> str:
    """Key for queries of pieces of the last message, `KEY?piece=OFFSET;size=BYTES;number=N` (-1: the last)."""
    return f"{key}/@adv/pieces/{source}"


class LastMessage:
    """Last message of one publisher, for late subscribers and slow links."""

    def __init__(
        self,
        session: Session,
        key: str,
        source: str,
        encoding: str | None = None,
        *,
        answers: bool = False,
        stamped: bool = False,
    ) -> None:
        """Declare the keys and the token, and start the heartbeat.

        Args:
            session: open session.
            key: key of the publisher.
            source: identity of the publisher, as in `zenoh_api.source_of`.
            encoding: encoding of the publisher's payloads.
            answers: True if a query of the key itself also returns the last message.
            stamped: identify messages by timestamps. Instead of the heartbeat, the token is declared anew after each
                message, so that subscribers query the last one.
        """
        self._session, self._key, self._encoding = session, key, encoding
        self._pieces = pieces_key(key, source)
        self._lock = threading.Lock()
        self._kept: OrderedDict[int, tuple[MadeOnce, bytes | None, float]] = OrderedDict()
        self._last, self._renewed, self._stamp = -1, -1, None
        self._is_closing = False
        announcements, served = announcement_key(key, source), {self._pieces: self._answer_piece}
        served |= {announcements: self._answer_history} | ({key: self._answer_get} if answers else {})
        self._answerers = [Answerer(session, own, take, limit=MAXIMUM_ANSWERS) for own, take in served.items()]
        self._is_stamped, self._announcements = stamped, announcements
        self._token = zenoh_api.declare_token(session.raw, announcements)
        self._beat = zenoh_api.declare_publisher(session.raw, announcements, "INTERACTIVE_LOW")
        # Repeated, so that the loss of a message is noticed even if nothing follows it.
        session.pulse.add(self, self._repeat)

    def keep(self, number: int, payload: MadeOnce, attachment: bytes | None, stamp: Any = None) -> None:
        """Make this message the last one; `stamp` is its timestamp, if it has one."""
        now = time.monotonic()
        with self._lock:
            self._last, self._stamp = number, stamp
            self._kept[number] = (payload, attachment, NEVER)
            old = [other for other in self._kept if other != number]
            for place, other in enumerate(reversed(old)):
                if place >= KEPT or now - self._kept[other][2] > KEPT_FOR:
                    del self._kept[other]

    def announce(self) -> None:
        """Announce the number of the last message, if there is one.

        Raises:
            SessionClosed: the session is closed.
            TransportError: the announcement cannot be sent.
        """
        if self._last < 0 or self._is_closing or self._is_stamped:
            return
        number = (self._last & 0xFFFFFFFF).to_bytes(4, "little")
        self._session.attempt(partial(self._beat.put, number), f"cannot announce what is on {self._key!r}")

    def _repeat(self) -> None:
        try:
            if self._is_stamped:
                self._renew_token()
            self.announce()
        except TransportError as error:
            if not self._is_closing and not self._session.is_closed:
                logger.error("%s", error)

    def _renew_token(self) -> None:
        """Declare the token anew, once after each message, so that subscribers query what they may have lost."""
        with self._lock:
            if self._renewed == self._last or self._is_closing:
                return
            self._renewed = self._last
            self._session.undeclare(self._token)
            self._token = self._session.attempt(
                lambda: zenoh_api.declare_token(self._session.raw, self._announcements),
                f"cannot announce what is on {self._key!r}",
            )

    def _answer_history(self, query: Any) -> None:
        if self._last >= 0 and _is_within(self._last, query.parameters.get("_sn")):
            self._answer_get(query)

    def _answer_get(self, query: Any) -> None:
        with self._lock:
            number, (payload, attachment, _), stamp = self._last, self._kept.get(self._last, NOTHING), self._stamp
        if number >= 0:
            query.reply(self._key, payload(), encoding=self._encoding, attachment=attachment, timestamp=stamp)
        else:
            refuse(query, "no_terrain", f"nothing was published on {self._key!r} yet")

    def _answer_piece(self, query: Any) -> None:
        if query.parameters.get("piece") is None:
            # A query of `KEY/@adv/**` by an advanced subscriber, which the other queryable answers.
            return
        begin, size = _whole(query.parameters.get("piece"), 0), _whole(query.parameters.get("size"), 0)
        with self._lock:
            number = _whole(query.parameters.get("number"), -1)
            if number not in self._kept:
                number, begin = self._last, 0
            payload, attachment, _ = self._kept.get(number, NOTHING)
            if number >= 0:
                self._kept[number] = (payload, attachment, time.monotonic())
        if number >= 0 and begin >= 0:
            whole = payload()
            piece = bytes(memoryview(whole)[begin : begin + max(0, min(size, MAXIMUM_PIECE))])
            query.reply(self._pieces, piece, attachment=PIECE.pack(number, len(whole), begin))

    def close(self) -> None:
        """Undeclare all keys."""
        with self._lock:
            self._is_closing = True
        self._session.pulse.remove(self)
        for answerer in self._answerers:
            answerer.close()
        self._session.undeclare(self._token, self._beat)


def _whole(text: str | None, default: int) -> int:
    try:
        return int(text or default)
    except ValueError:
        return default


def _is_within(number: int, span: str | None) -> bool:
    """Test a number against the range `FIRST..LAST` of an advanced subscriber; either end may be missing."""
    if span is None:
        return True
    first, _, last = span.partition("..")
    return _whole(first, 0) <= number <= _whole(last, 2**63)
