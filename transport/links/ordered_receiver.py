"""Receiver that passes the messages on a key to a callback, in the order of arrival."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import TypeVar

from transport.exceptions import MessageError
from transport.links.receiver import NewestReceiver
from transport.links.session import Session
from transport.supervision import report

# Largest number of messages that wait for the callback. If one more arrives, the oldest dispensable or invalid message
# is dropped; if there is none, the oldest message.
MAXIMUM_WAITING = 256

T = TypeVar("T")


class OrderedReceiver(NewestReceiver[T]):
    """Receiver that also passes messages to a callback, on a separate thread; if too many wait, some are dropped."""

    def __init__(
        self,
        session: Session,
        key: str,
        decode: Callable[[bytes], T],
        on_message: Callable[[T], None] | None = None,
        on_refused: Callable[[MessageError], None] | None = None,
        *,
        latched: bool = True,
    ) -> None:
        """Subscribe to the key.

        Args:
            session, key, decode, latched: as in `NewestReceiver`.
            on_message: called with each message; None = keep only the newest message.
            on_refused: called with the error of an invalid message; of consecutive waiting messages with the same type
                of error, only the first is reported. It has no effect without `on_message`.
        """
        self._on_message, self._on_refused = on_message, on_refused
        self._waiting: deque[T | MessageError] = deque()
        super().__init__(session, key, decode, latched=latched)
        if on_message is not None:
            thread = session.thread(f"transport-{self.key}", self._follow)
            self._threads.append(thread)
            thread.start()

    def _is_dispensable(self, message: T) -> bool:
        """Return True for a message that may be dropped before others."""
        return False

    def _take(self, payload: bytes) -> None:
        super()._take(payload)
        if self._on_message is None:
            return
        message: T | MessageError
        try:
            message = self._decode(payload)
        except MessageError as error:
            message = error
        with self._changed:
            is_refused = isinstance(message, MessageError)
            if is_refused and self._waiting and type(self._waiting[-1]) is type(message):
                return
            if len(self._waiting) >= MAXIMUM_WAITING:
                self._drop_one()
            self._waiting.append(message)
            self._changed.notify_all()

    def _drop_one(self) -> None:
        for index, waiting in enumerate(self._waiting):
            if isinstance(waiting, MessageError) or self._is_dispensable(waiting):
                del self._waiting[index]
                return
        self._waiting.popleft()

    def _follow(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or self.is_closed)
                if self.is_closed:
                    return
                message = self._waiting.popleft()
            try:
                self._hand_on(message)
            except Exception as error:
                report(f"callback for {self.key}", error)

    def _hand_on(self, message: T | MessageError) -> None:
        if isinstance(message, MessageError):
            self._refusals.log("message on %s refused: %s", self.key, message)
            if self._on_refused is not None:
                self._on_refused(message)
        elif self._on_message is not None:
            self._on_message(message)
