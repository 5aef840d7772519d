"""Last message of a publisher, kept for late subscribers and for slow links, over which it is fetched in pieces.

Announcement key and heartbeat are those of Zenoh's advanced publisher, so that advanced subscribers (including
rmw_zenoh) are served too. Zenoh's own publisher replies to late joiners on the thread and under the lock of its puts,
so that one slow joiner delays all readers for seconds. Here, each query is answered on a separate thread.

A reply cannot contain the number of a message (Zenoh's Python API has no argument for it), so an advanced subscriber
may receive a message twice: as published and as a reply. A `stamped` publisher identifies messages by timestamps, which
replies can contain, so that each message is delivered once. Its subscribers query again whenever the token is declared
anew.
"""

from __future__ import annotations

import logging
import math
import struct
import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from transport import zenoh_api
from transport.exceptions import TransportError
from transport.links.answerer import Answerer, refuse
from transport.links.session import Session

logger = logging.getLogger(__name__)
# Largest number of pending queries per queryable; further queries are dropped, and the readers repeat them.
MAXIMUM_ANSWERS = 16
# Largest piece [bytes]; it fits into the queue of a link (`configuration.QUEUES`).
MAXIMUM_PIECE = 768 * 1024
# Largest number of older messages kept for readers that are still fetching them in pieces, and time for which each is
# kept after the last query of a piece [s]. A message of which no piece was queried is dropped when the next one is
# published.
KEPT = 3
KEPT_FOR = 10.0
# Attachment of a piece: number of the message, length of the message in bytes, offset of the piece in the message.
PIECE = struct.Struct("<QQQ")
Payload = bytes | bytearray


class MadeOnce:
    """Payload that is encoded at its first use and then cached."""

    def __init__(self, make: Callable[[], Payload]) -> None:
        """Prepare the payload; `make` encodes it when it is first needed."""
        self._make: Callable[[], Payload] | None = make
        self._made: Payload = b""
        self._lock = threading.Lock()

    def __call__(self) -> Payload:
        """Return the payload; encode it at the first call."""
        with self._lock:
            if self._make is not None:
                self._made, self._make = self._make(), None
            return self._made


# Time of the last query if no piece of a message was queried, and entry used for a number that is not kept.
NEVER = -math.inf
NOTHING: tuple[MadeOnce, bytes | None, float] = (MadeOnce(bytes), None, NEVER)


def announcement_key(key: str, source: str = "*/*") -> str:
    """Return the key on which the number of the last message is announced, and which advanced subscribers query."""
    return f"{key}/@adv/pub/{source}/_"


def pieces_key(key: str, source: str = "*/*") -> str:
    """Return the key for pieces of messages, queried as `KEY?piece=OFFSET;size=BYTES;number=N` (-1: last message)."""
    return f"{key}/@adv/pieces/{source}"


class LastMessage:
    """Store of the last message of one publisher, for late subscribers and slow links."""

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
        """Declare the keys and the liveliness token, and start the heartbeat.

        Args:
            session: open session.
            key: key of the publisher.
            source: identity of the publisher, as in `zenoh_api.source_of`.
            encoding: encoding of the publisher's payloads.
            answers: True = a query of the publisher's key itself also returns the last message.
            stamped: True = identify messages by timestamps. Then there is no heartbeat; the token is declared anew
                after each message, so that subscribers query the last one.
        """
        self._session, self._key, self._encoding = session, key, encoding
        self._pieces, self._failure = pieces_key(key, source), f"cannot announce the last message on {key!r}"
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
        # The announcement is repeated, so that the loss of a message is detected even if no message follows.
        session.pulse.add(self, self._repeat)

    def keep(self, number: int, payload: MadeOnce, attachment: bytes | None, stamp: Any = None) -> None:
        """Make a message the last one; `stamp` is its timestamp, or None."""
        now = time.monotonic()
        with self._lock:
            self._last, self._stamp = number, stamp
            self._kept[number] = (payload, attachment, NEVER)
            old = [other for other in self._kept if other != number]
            for place, other in enumerate(reversed(old)):
                if place >= KEPT or now - self._kept[other][2] > KEPT_FOR:
                    del self._kept[other]

    def forget(self) -> None:
        """Keep no message until the next one."""
        with self._lock:
            self._last = -1
            self._kept.clear()

    def announce(self) -> None:
        """Announce the number of the last message, if there is one and messages are not identified by timestamps.

        Raises:
            SessionClosed: the session is closed.
            TransportError: the announcement cannot be sent.
        """
        if self._last < 0 or self._is_closing or self._is_stamped:
            return
        self._session.attempt(self._failure, self._beat.put, (self._last & 0xFFFFFFFF).to_bytes(4, "little"))

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
            declare, raw = zenoh_api.declare_token, self._session.raw
            self._token = self._session.attempt(self._failure, declare, raw, self._announcements)

    def _answer_history(self, query: Any) -> None:
        if self._last >= 0 and _is_within(self._last, query.parameters.get("_sn")):
            self._answer_get(query)

    def _answer_get(self, query: Any) -> None:
        with self._lock:
            number, (payload, attachment, _), stamp = self._last, self._kept.get(self._last, NOTHING), self._stamp
        if number >= 0:
            query.reply(self._key, payload(), encoding=self._encoding, attachment=attachment, timestamp=stamp)
        else:
            refuse(query, "no_terrain", f"nothing has been published on {self._key!r} yet")

    def _answer_piece(self, query: Any) -> None:
        if query.parameters.get("piece") is None:
            # An advanced subscriber queries `KEY/@adv/**`, which matches this key too; the other queryable answers.
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
        """Undeclare all keys and the token."""
        with self._lock:
            self._is_closing = True
        self._session.pulse.remove(self)
        for answerer in self._answerers:
            answerer.close()
        self._session.undeclare(self._token, self._beat)


def _whole(text: str | None, default: int) -> int:
    with suppress(ValueError):
        return int(text or default)
    return default


def _is_within(number: int, span: str | None) -> bool:
    """Test that a number is in the range `FIRST..LAST` of an advanced subscriber; either end may be missing."""
    if span is None:
        return True
    first, _, last = span.partition("..")
    return _whole(first, 0) <= number <= _whole(last, 2**63)
