"""Receiver of the newest message of one key."""

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
from transport.supervision import Seldom, report

logger = logging.getLogger(__name__)
# [s] How long closing waits for a callback of the user to return.
CLOSE_TIMEOUT = 2.0

T = TypeVar("T")


class NewestReceiver(Resource, Generic[T]):
    """Receiver of one key that keeps only the newest message.

    Zenoh's thread copies each payload, which replaces the one before; the thread that asks decodes it. A slow reader
    therefore never sees an old message, and never delays another. What was published before, or lost on a
    slow link, is fetched.

    Attributes:
        key: key that it receives.
        received: samples that arrived.
        superseded: samples that a newer one replaced before anybody asked for them.
        missed: samples that were published and lost on the way.
        rejected: samples that were not a valid message.
        refused: samples from another sender, or out of order.
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
        """Subscribe.

        Args:
            session: open session.
            key: key to receive.
            decode: makes a message of a payload; raises MessageError when it is not one.
            latched: ask for the last message that was published before, and notice losses.
            refusal: returns the reason to refuse a message, empty to accept it; called once for each that arrives, on
                Zenoh's thread. Refusals are counted and logged at a limited rate.

        Raises:
            SessionClosed: the session is closed.
            TransportError: the key is not valid.
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
        session.attempt(lambda: self._begin(latched), f"cannot receive {key!r}")

    def _begin(self, latched: bool) -> None:
        if latched:
            self._fetcher = Fetcher(self._session, self.key, self._take, self._on_miss, self._listen)
        self._listen(True)

    def _listen(self, wanted: bool) -> None:
        """Subscribe, or unsubscribe: what is published is then fetched piece by piece."""
        with self._listening:
            if wanted and self._raw is None and not self.is_closed:
                self._raw = zenoh_api.declare_subscriber(self._session.raw, self.key, self._on_sample)
            elif not wanted and self._raw is not None:
                raw, self._raw = self._raw, None
                self._session.undeclare(raw)

    @property
    def fetched(self) -> int:
        """Samples that did not come by themselves and were fetched, at the beginning or after a loss on the way."""
        return 0 if self._fetcher is None else self._fetcher.fetched

    def _on_sample(self, sample: Any) -> None:
        # Copied here, not when it is read: the payload may lie in memory shared with the publisher, and a
        # process that was stopped for a while must not find it overwritten.
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
                self._refusals.log("message on %s not taken: %s", self.key, refusal)
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
        """The newest message, or None when none came yet.

        Raises:
            MessageError: the newest sample is not a valid message; an older one is not returned instead.
        """
        with self._changed:
            sample = self._sample
        return None if sample is None else self._open(sample)

    def wait_for(self, predicate: Callable[[T], bool], timeout: float | None) -> Received[T]:
        """Wait for a newest message that `predicate` accepts; as `wait_until`, but of the message alone."""
        return self.wait_until(lambda received: predicate(received.message), timeout)

    def wait_until(
        self, predicate: Callable[[Received[T]], bool], timeout: float | None, *, after: int = 0
    ) -> Received[T]:
        """Wait for a newest message that `predicate` accepts; samples that are no valid message are skipped.

        Args:
            predicate: called in this thread with each newest message and its arrival.
            timeout: longest wait [s]; None waits without end. Ctrl-C ends the wait.
            after: number of a sample; only later ones count.

        Raises:
            ReceiveTimeout: none came in time.
            SessionClosed: the receiver was closed meanwhile.
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
        """Check whether a message has arrived after a received one."""
        return self.received > received.number

    def nothing(self, timeout: float) -> str:
        """Text about a wait of `timeout` seconds that ended without a message."""
        return (
            f"no message on {self.key!r} that fits within {timeout:g} s; {self.received} arrived, "
            f"{self.rejected} were damaged, {self.missed} were lost"
        )

    def _next(self, after: int, timeout: float | None) -> Sample[T] | None:
        """The newest sample with a larger number than `after`; None when `timeout` [s] passed before."""

        def newer() -> Sample[T] | None:
            self._check_open()
            return self._sample if self._sample is not None and self._sample.number > after else None

        with self._changed:
            return self._changed.wait_for(newer, timeout)

    def _check_open(self) -> None:
        if self.is_closed:
            raise SessionClosed(f"the receiver of {self.key!r} is closed")

    def on_newest(self, callback: Callable[[Received[T]], None]) -> None:
        """Call `callback` with the newest message, again and again, on a thread of its own.

        Of what arrives meanwhile it gets the newest alone. An error that it raises is logged, and it is called again
        with the next message.

        Raises:
            SessionClosed: the receiver is closed.
        """
        self._check_open()
        # A daemon: a callback that never returns must not keep the interpreter from ending.
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
        for thread in self._threads:
            if thread is not threading.current_thread():
                thread.join(CLOSE_TIMEOUT)
