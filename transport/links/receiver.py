"""Receiver of the newest message on a key."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from typing import Any, Generic, TypeVar

from transport import zenoh_api
from transport.exceptions import MessageError, ReceiveTimeout, SessionClosed
from transport.links.fetcher import Fetcher
from transport.links.received import Received, Sample
from transport.links.session import Resource, Session
from transport.supervision import Seldom, join, report

logger = logging.getLogger(__name__)

T = TypeVar("T")


class NewestReceiver(Resource, Generic[T]):
    """Receiver that keeps only the newest message on a key.

    Each accepted payload replaces the previous one. The first thread that reads a payload decodes it; with `refusal`,
    the thread that receives it does. A slow reader therefore skips superseded messages and never delays another reader.
    A latched receiver also fetches the last message of each publisher if that message was published before the
    subscription, or lost; over a slow link, it unsubscribes and fetches the messages instead.

    Attributes:
        key: key of the messages.
        received: number of samples that arrived and were not refused.
        superseded: number of samples that were replaced by a newer one before they were read.
        missed: number of samples missing in the numbering of their publishers; always 0 if the receiver is not latched.
        rejected: number of samples that could not be decoded when they were read.
        refused: number of samples that `refusal` refused.
    """

    def __init__(
        self,
        session: Session,
        key: str,
        decode: Callable[[bytes], T],
        *,
        latched: bool = True,
        refusal: Callable[[T], str] | None = None,
    ) -> None:
        """Subscribe to the key.

        Args:
            session: open session.
            key: key of the messages.
            decode: decodes a payload; raises MessageError if the payload is not valid.
            latched: True = also fetch the last message if it was published before the subscription, or lost.
            refusal: returns the reason to refuse a message, or ""; called once per valid message, on Zenoh's or the
                fetcher's thread. Refused messages are counted, and logged at a limited rate.

        Raises:
            SessionClosed: the session is closed.
            TransportError: Zenoh rejected the subscription, for example because the key is not valid.
        """
        self.key = key
        self._decode, self._refusal = decode, refusal
        self._refusals = Seldom(logger)
        self._changed = threading.Condition()
        self._sample: Sample[T] | None = None
        self.received = self.superseded = self.missed = self.rejected = self.refused = 0
        self._threads: list[threading.Thread] = []
        self._listening = threading.Lock()
        self._raw: Any = None
        self._fetcher: Fetcher | None = None
        super().__init__(session)
        session.attempt(f"cannot receive {key!r}", self._begin, latched)

    def _begin(self, latched: bool) -> None:
        if latched:
            self._fetcher = Fetcher(self._session, self.key, self._take, self._on_miss, self._listen)
        self._listen(True)

    def _listen(self, wanted: bool) -> None:
        """Subscribe if `wanted`, otherwise unsubscribe: on a slow link, or when the receiver is closed."""
        with self._listening:
            if wanted and self._raw is None and not self.is_closed:
                self._raw = zenoh_api.declare_subscriber(self._session.raw, self.key, self._on_sample)
            elif not wanted and self._raw is not None:
                raw, self._raw = self._raw, None
                self._session.undeclare(raw)

    @property
    def fetched(self) -> int:
        """Number of samples that were fetched instead of being received by subscription."""
        return 0 if self._fetcher is None else self._fetcher.fetched

    def _on_sample(self, sample: Any) -> None:
        # Copy on arrival, not when reading: the payload may be in shared memory, which the publisher may overwrite
        # while this process is suspended.
        payload = sample.payload.to_bytes()
        number = zenoh_api.number_of(sample)
        if self._fetcher is None or number is None:
            self._take(payload)
        else:
            self._fetcher.take(*number, payload)

    def _take(self, payload: bytes) -> None:
        sample = Sample(payload, self.received + 1, self._decode)
        if self._refusal is not None:
            try:
                refusal = self._refusal(sample.open(counts=False).message)
            except MessageError:
                refusal = ""
            if refusal:
                self.refused += 1
                self._refusals.log("message on %s refused: %s", self.key, refusal)
                return
        with self._changed:
            if self._sample is not None and not self._sample.taken:
                self.superseded += 1
            self.received += 1
            self._sample = sample
            self._changed.notify_all()

    def _on_miss(self, count: int) -> None:
        with self._changed:
            self.missed += count

    def _open(self, sample: Sample[T]) -> Received[T]:
        first = not sample.taken
        try:
            return sample.open()
        except MessageError:
            if first:
                self.rejected += 1
            raise

    def latest(self) -> Received[T] | None:
        """Return the newest message, or None before the first.

        Raises:
            MessageError: the newest sample is not a valid message; an older one is not returned instead.
        """
        with self._changed:
            sample = self._sample
        return None if sample is None else self._open(sample)

    def wait_for(self, predicate: Callable[[T], bool], timeout: float | None) -> Received[T]:
        """Call `wait_until` with a predicate that receives only the message."""
        return self.wait_until(lambda received: predicate(received.message), timeout)

    def wait_until(
        self, predicate: Callable[[Received[T]], bool], timeout: float | None, *, after: int = 0
    ) -> Received[T]:
        """Wait until `predicate` accepts the newest message, and return that message; invalid samples are skipped.

        Args:
            predicate: called on the calling thread with the newest message and its time of arrival, then with every
                new one (only the newest if several arrive during a call); returns True to accept the message.
            timeout: longest wait [s]; None = no limit. Ctrl-C ends the wait.
            after: number of a sample; only samples with larger numbers are considered.

        Raises:
            ReceiveTimeout: no message was accepted in time.
            SessionClosed: the receiver is closed.
        """
        deadline = None if timeout is None else time.monotonic() + timeout
        while True:
            sample = self._next(after, None if deadline is None else deadline - time.monotonic())
            if sample is None:
                raise ReceiveTimeout(self.nothing(timeout or 0.0))
            after = sample.number
            try:
                received = self._open(sample)
            except MessageError as error:
                self._refusals.log("message on %s refused: %s", self.key, error)
                continue
            if predicate(received):
                return received

    def has_newer(self, received: Received[T]) -> bool:
        """Return True if another message has arrived after `received`."""
        return self.received > received.number

    def nothing(self, timeout: float) -> str:
        """Return the error text for a wait of `timeout` [s] in which no message was accepted."""
        return (
            f"no matching message on {self.key!r} within {timeout:g} s; arrived: {self.received}, "
            f"damaged: {self.rejected}, lost: {self.missed}"
        )

    def _next(self, after: int, timeout: float | None) -> Sample[T] | None:
        """Wait for the newest sample with a number above `after`; return None after `timeout` [s]."""

        def newer() -> Sample[T] | None:
            self._check_open()
            return self._sample if self._sample is not None and self._sample.number > after else None

        with self._changed:
            return self._changed.wait_for(newer, timeout)

    def _check_open(self) -> None:
        if self.is_closed:
            raise SessionClosed(f"the receiver of {self.key!r} is closed")

    def on_newest(self, callback: Callable[[Received[T]], None]) -> None:
        """Call `callback` with the newest message, if there is one, and with every new message, on a separate thread.

        Of the messages that arrive during a call, only the newest is passed on. Invalid messages and exceptions of the
        callback are logged, and the thread continues with the next message.

        Raises:
            SessionClosed: the receiver is closed.
        """
        self._check_open()
        # The thread is a daemon, so that a callback that never returns does not keep the interpreter alive.
        thread = self._session.thread(f"transport-{self.key}", lambda: self._dispatch(callback))
        self._threads.append(thread)
        thread.start()

    def _dispatch(self, callback: Callable[[Received[T]], None]) -> None:
        number = 0
        while True:
            try:
                sample = self._next(number, None)
            except SessionClosed:
                return
            if sample is None:
                continue
            number = sample.number
            try:
                callback(self._open(sample))
            except MessageError as error:
                self._refusals.log("message on %s refused: %s", self.key, error)
            except Exception as error:
                report(f"callback for {self.key}", error)

    def _release(self) -> None:
        with self._changed:
            self._changed.notify_all()
        self._listen(False)
        if self._fetcher is not None:
            self._fetcher.close()
        join(*self._threads)
