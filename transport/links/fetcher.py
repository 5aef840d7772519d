"""Fetching of a publisher's last message, if it precedes the subscription or was lost, in pieces that suit the link."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from transport import zenoh_api
from transport.exceptions import SessionClosed, TransportError
from transport.links.last_message import MAXIMUM_PIECE, PIECE, announcement_key, pieces_key
from transport.links.recent import Recent
from transport.links.session import Session
from transport.messages.codec import MAXIMUM_PAYLOAD
from transport.supervision import join

# Link speed [bytes/s] below which most published messages lose fragments, while the remaining fragments delay other
# messages. The reader then unsubscribes and fetches announced messages instead.
SUBSCRIBING_RATE = 3e6
# Timeouts of a piece [s], whose reply may be lost; the second one applies to pieces larger than FIRST_PIECE, which are
# requested only over a fast link.
PIECE_TIMEOUT, LARGE_PIECE_TIMEOUT = 5.0, 1.0
# Pieces grow if a reply takes less than QUICK, and shrink if it takes more than SLOW or does not arrive [s].
QUICK, SLOW = 0.025, 0.25
# First and smallest size of a piece [bytes]; both are less than one batch of Zenoh (64 KiB), so that a small message
# fits into one batch.
FIRST_PIECE, SMALLEST_PIECE = 48 * 1024, 16 * 1024
# Consecutive failures before the fetcher waits for the next announcement, and interval between attempts [s].
ATTEMPTS = 20
BETWEEN_ATTEMPTS = 0.1
# Number of publishers that are remembered; each start of a node adds one.
REMEMBERED = 32
# Longest wait for an announced message [s], used until the delay is known, and shortest wait, which allows for a busy
# machine.
LONGEST_GRACE, SHORTEST_GRACE = 0.3, 0.02
# A message counts as lost when its delay exceeds this multiple of the estimated delay, within the limits above.
MARGIN = 4.0
# Factor by which the estimate, the largest recent delay, decays with each message.
KEPT = 0.9


class Patience:
    """Estimate of the delay between the announcement of a message and its arrival.

    An announcement is small and overtakes its message. On a fast link, the message follows within milliseconds, so that
    a loss is detected soon. On a slow link, the delay includes the time of the message's transfer.
    """

    def __init__(self) -> None:
        """Start without an estimate."""
        self._lateness: float | None = None

    def learn(self, lateness: float) -> None:
        """Record the delay of a message after its announcement [s]; 0 or less if the message arrived first."""
        late = max(0.0, lateness)
        self._lateness = late if self._lateness is None else max(late, KEPT * self._lateness)

    @property
    def grace(self) -> float:
        """Time to wait for a message after its announcement [s]."""
        if self._lateness is None:
            return LONGEST_GRACE
        return min(LONGEST_GRACE, max(SHORTEST_GRACE, MARGIN * self._lateness))


class Fetcher:
    """Fetcher of the last message of each publisher of a key, if it was not received by subscription.

    Attributes:
        fetched: number of messages fetched.
    """

    def __init__(
        self,
        session: Session,
        key: str,
        deliver: Callable[[bytes], None],
        on_lost: Callable[[int], None],
        subscribe: Callable[[bool], None] = lambda wanted: None,
    ) -> None:
        """Subscribe to announcements, and query which messages already exist.

        Args:
            session: open session.
            key: key of the publishers.
            deliver: called with each payload that is newer than all earlier ones of its publisher, on a thread of Zenoh
                or the fetcher.
            on_lost: called with the number of messages that were lost for good.
            subscribe: called on the fetcher's thread with False when the link becomes too slow for a subscription, and
                with True when it is fast again.
        """
        self._session, self._key, self._deliver, self._on_lost = session, key, deliver, on_lost
        self._subscribe, self._is_subscribed = subscribe, True
        self._changed = threading.Condition()
        self._delivery = threading.Lock()
        self._newest: Recent[str, int] = Recent(REMEMBERED)
        # Last number announced by each publisher, and the time at which this number was first announced.
        self._announced: Recent[str, tuple[int, float]] = Recent(REMEMBERED)
        self._is_closed = False
        self._size = FIRST_PIECE
        self.fetched = 0
        self._patience = Patience()
        self._raw = zenoh_api.declare_subscriber(session.raw, announcement_key(key), self._on_announcement)
        self._thread = session.thread(f"transport-fetch {key}", self._run)
        self._thread.start()

    def take(self, source: str, number: int, payload: bytes) -> None:
        """Deliver a message received by subscription, unless this or a later one of its publisher was delivered."""
        with self._changed:
            announced, heard_at = self._announced.get(source, (-1, 0.0))
            self._patience.learn(time.monotonic() - heard_at if announced == number else 0.0)
        self._hand_over(source, number, payload)

    def _hand_over(self, source: str, number: int, payload: bytes) -> None:
        with self._delivery:
            if self._is_new(source, number):
                self._deliver(payload)
        with self._changed:
            self._changed.notify_all()

    def _is_new(self, source: str, number: int) -> bool:
        with self._changed:
            before = self._newest.get(source)
            is_new = before is None or number > before
            self._newest[source] = number if before is None else max(before, number)
        if before is not None and number > before + 1:
            self._on_lost(number - before - 1)
        return is_new

    def close(self) -> None:
        """Stop fetching; may be called twice."""
        with self._changed:
            self._is_closed = True
            self._changed.notify_all()
        self._session.undeclare(self._raw)
        join(self._thread)

    def _on_announcement(self, sample: Any) -> None:
        payload = sample.payload.to_bytes()
        if len(payload) == 4:
            self._announce(_source_of(str(sample.key_expr).removesuffix("/_")), int.from_bytes(payload, "little"))

    def _announce(self, source: str, number: int) -> None:
        with self._changed:
            announced, heard_at = self._announced.get(source, (-1, 0.0))
            self._announced[source] = number, heard_at if announced == number else time.monotonic()
            # Most announcements repeat a known number; they need not wake the thread.
            if number > self._newest.get(source, -1):
                self._changed.notify_all()

    def _wanted(self) -> tuple[str, int] | None:
        for source, (number, _) in self._announced.items():
            if number > self._newest.get(source, -1):
                return source, number
        return None

    def _left(self) -> float:
        """Return the time until the announced message counts as lost [s]."""
        wanted = self._wanted()
        _, heard_at = (0, 0.0) if wanted is None else self._announced[wanted[0]]
        return max(0.0, heard_at + self._patience.grace - time.monotonic())

    def _run(self) -> None:
        try:
            self._ask(pieces_key(self._key), 0, 0, -1, lambda key, head, _: self._announce(_source_of(key), head[0]))
            while True:
                with self._changed:
                    self._changed.wait_for(lambda: self._is_closed or self._wanted() is not None)
                    if self._is_closed:
                        return
                    if self._is_subscribed and self._newest:
                        self._changed.wait_for(lambda: self._is_closed or self._wanted() is None, self._left())
                    wanted = self._wanted()
                if wanted is not None:
                    self._fetch(*wanted)
        except SessionClosed:
            return
        except TransportError:
            if not self._session.is_closed:
                raise

    def _fetch(self, source: str, number: int) -> None:
        """Fetch the last message of a publisher; forget its announcement if that fails."""
        buffer = bytearray()
        failures, took, fetched = 0, 0.0, 0
        while not self._is_closed and failures < ATTEMPTS:
            with self._changed:
                if self._newest.get(source, -1) >= number:
                    return
            start = time.monotonic()
            piece = self._piece(source, len(buffer), number)
            if piece is None:
                failures += 1
                time.sleep(BETWEEN_ATTEMPTS)
                continue
            took += time.monotonic() - start
            head, content = piece
            if head[0] != number:
                number, buffer = head[0], bytearray()
            if head[1] > MAXIMUM_PAYLOAD:
                break
            if head[2] != len(buffer) or (not content and head[1] > len(buffer)):
                buffer.clear()
                failures += 1
                continue
            failures = 0
            buffer += content
            fetched += len(content)
            if len(buffer) >= head[1]:
                if fetched >= FIRST_PIECE:
                    self._judge(fetched / took)
                self.fetched += 1
                self._hand_over(source, number, bytes(buffer))
                return
        with self._changed:
            self._announced.pop(source, None)

    def _judge(self, rate: float) -> None:
        is_quick = rate > SUBSCRIBING_RATE
        if is_quick != self._is_subscribed:
            self._is_subscribed = is_quick
            self._subscribe(is_quick)

    def _piece(self, source: str, begin: int, number: int) -> tuple[tuple[int, int, int], bytes] | None:
        found: list[tuple[tuple[int, int, int], bytes]] = []
        size, start = self._size, time.monotonic()
        self._ask(
            pieces_key(self._key, source), begin, size, number, lambda _, head, content: found.append((head, content))
        )
        took = time.monotonic() - start
        if not found or took > SLOW:
            self._size = max(SMALLEST_PIECE, size // 2 if found else FIRST_PIECE if size > FIRST_PIECE else size // 2)
        elif took < QUICK:
            self._size = min(MAXIMUM_PIECE, 4 * size)
        return found[0] if found else None

    def _ask(
        self,
        key: str,
        begin: int,
        size: int,
        number: int,
        on_piece: Callable[[str, tuple[int, int, int], bytes], None],
    ) -> None:
        """Query one piece, and wait for the last reply, at most until the timeout or `close`."""
        finished = threading.Event()
        timeout = LARGE_PIECE_TIMEOUT if size > FIRST_PIECE else PIECE_TIMEOUT

        def take(reply: zenoh_api.Reply) -> None:
            attachment, content = reply.attachment or b"", reply.payload or b""
            if len(attachment) == PIECE.size and len(content) <= size:
                on_piece(reply.key, PIECE.unpack(attachment), content)

        selector = f"{key}?piece={begin};size={size};number={number}"
        query = partial(zenoh_api.get_replies, priority="DATA_HIGH", is_dropped=True)
        self._session.attempt(f"cannot ask {key!r}", query, self._session.raw, selector, timeout, take, finished.set)
        deadline = time.monotonic() + timeout
        while not finished.wait(0.1) and not self._is_closed and time.monotonic() < deadline:
            pass


def _source_of(key: str) -> str:
    return "/".join(key.split("/")[-2:])
