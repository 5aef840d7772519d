"""Last message of a publisher, kept for late subscribers and slow links, which query it in pieces.

The keys and the heartbeat are those of Zenoh's advanced publisher, so that its advanced subscribers (and those of
rmw_zenoh) are served too. Zenoh's own answers late joiners on the thread and under the lock that its puts need: one
slow late joiner holds up all readers for seconds. Here each question is answered on a thread of its own.

A reply cannot carry the number of the message (Zenoh's Python has no argument for it), so an advanced subscriber may be
handed a message by its number and again by a reply. Messages of a `stamped` publisher are known by their timestamps,
which replies carry: each is handed over once. Such a subscriber learns of a loss when the token appears anew.
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
# Questions that are answered at a time; more are dropped, and asked again.
MAXIMUM_ANSWERS = 16
# [byte] Largest piece; it fits into the queue of a link (`configuration.QUEUES`).
MAXIMUM_PIECE = 768 * 1024
# Messages kept beyond the last one for readers that are still fetching them, and [s] how long they are kept after a
# question; a message that nobody asked for is dropped when the next comes.
KEPT = 3
KEPT_FOR = 10.0
# Attachment of a piece: number of the message, its length in bytes, offset of the piece in it.
PIECE = struct.Struct("<QQQ")
Payload = bytes | bytearray


class MadeOnce:
    """Payload that is encoded at its first use and kept."""

    def __init__(self, make: Callable[[], Payload]) -> None:
        """Make nothing yet."""
        self._make: Callable[[], Payload] | None = make
        self._made: Payload = b""
        self._lock = threading.Lock()

    def __call__(self) -> Payload:
        """The payload."""
        with self._lock:
            if self._make is not None:
                self._made, self._make = self._make(), None
            return self._made


# Time of the last query before there is one, and value kept while there is no message.
NEVER = -math.inf
NOTHING: tuple[MadeOnce, bytes | None, float] = (MadeOnce(bytes), None, NEVER)


def announcement_key(key: str, source: str = "*/*") -> str:
    """Key on which the number of the last message is repeated, and which advanced subscribers query."""
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
            answers: whether a query of the key itself gets the last message too.
            stamped: messages are known by their timestamps; after each the token is declared anew, in place of the
                heartbeat, so that subscribers ask for the last message.
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
        # Repeated, so that the loss of a message is noticed though nothing follows it.
        session.pulse.add(self, self._repeat)

    def keep(self, number: int, payload: MadeOnce, attachment: bytes | None, stamp: Any = None) -> None:
        """Make this message the last one; `stamp` is its timestamp, where it has one."""
        now = time.monotonic()
        with self._lock:
            self._last, self._stamp = number, stamp
            self._kept[number] = (payload, attachment, NEVER)
            old = [other for other in self._kept if other != number]
            for other in old[: max(0, len(old) - KEPT)]:
                del self._kept[other]
            for other in [other for other in old if other in self._kept and now - self._kept[other][2] > KEPT_FOR]:
                del self._kept[other]

    def announce(self) -> None:
        """Announce the number of the last message, if there is one.

        Raises:
            SessionClosed: the session is closed.
            TransportError: it cannot be sent.
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
        """Declare the token anew after each message, once: its subscribers ask for what they may have lost."""
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
        with self._lock:
            number, (payload, attachment, _), stamp = self._last, self._kept.get(self._last, NOTHING), self._stamp
        if number >= 0 and _is_within(number, query.parameters.get("_sn")):
            query.reply(self._key, payload(), encoding=self._encoding, attachment=attachment, timestamp=stamp)

    def _answer_get(self, query: Any) -> None:
        with self._lock:
            number, (payload, attachment, _) = self._last, self._kept.get(self._last, NOTHING)
        if number >= 0:
            query.reply(self._key, payload(), encoding=self._encoding, attachment=attachment)
        else:
            refuse(query, "no_terrain", f"nothing was published on {self._key!r} yet")

    def _answer_piece(self, query: Any) -> None:
        if query.parameters.get("piece") is None:
            # Advanced subscribers ask `KEY/@adv/**`: theirs is the other queryable.
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
    """Check whether a number lies in a range of an advanced subscriber, `FIRST..LAST`, either end optional."""
    if span is None:
        return True
    first, _, last = span.partition("..")
    return _whole(first, 0) <= number <= _whole(last, 2**63)
