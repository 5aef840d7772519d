"""Queryables that reply on background threads, by default one per query, so that a slow link delays no other reply."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from transport import zenoh_api
from transport.exceptions import SessionClosed
from transport.links.outbox import Outbox
from transport.links.session import Resource, Session
from transport.messages.scan_messages import Refusal, encode_refusal
from transport.messages.typestore import REFUSAL, cdr

# Largest number of pending queries; further queries are dropped, so that a flood cannot exhaust the memory.
MAXIMUM_PENDING = 64


class Answerer(Resource):
    """Queryable on one key.

    Attributes:
        key: key of the queryable.
    """

    def __init__(
        self,
        session: Session,
        key: str,
        answer: Callable[[Any], None],
        *,
        limit: int = MAXIMUM_PENDING,
        in_order: bool = False,
    ) -> None:
        """Declare the queryable.

        Args:
            session: open session.
            key: key of the queryable.
            answer: sends the replies to a query; called on a background thread.
            limit: largest number of pending queries; further queries are dropped.
            in_order: True = process queries one after the other. `answer` must then end each query with
                `query.drop()` after its last reply, which it may send later on another thread.

        Raises:
            SessionClosed: the session is closed.
            TransportError: the key is not valid.
        """
        self.key = key
        self._answer, self._limit, self._is_in_order = answer, limit, in_order
        self._numbers = itertools.count()
        self._outbox = Outbox()
        what = f"cannot serve {key!r}"
        self._raw = session.attempt(what, zenoh_api.declare_queryable, session.raw, key, self._on_query)
        super().__init__(session)

    def _on_query(self, query: Any) -> None:
        # This runs on Zenoh's thread, which must not be blocked.
        number = str(next(self._numbers))
        with suppress(SessionClosed):
            if self._outbox.pending < self._limit:
                lane = "" if self._is_in_order else number
                self._outbox.post(f"{self.key} {number}", lambda: self._take_up(query), lane=lane)
                return
        query.drop()

    def _take_up(self, query: Any) -> None:
        try:
            self._answer(query)
        finally:
            if not self._is_in_order:
                query.drop()

    def _release(self) -> None:
        self._outbox.close()
        self._session.undeclare(self._raw)


def refuse(query: Any, code: str, message: str, request_id: str = "") -> None:
    """Reply to a query with a guara_msgs/Refusal."""
    query.reply_err(encode_refusal(Refusal(id=request_id, code=code, message=message)), encoding=cdr(REFUSAL))
