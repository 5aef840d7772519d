"""Publishers of one key: latched, where late joiners get the last message, or plain."""

from __future__ import annotations

from transport import zenoh_api
from transport.resource import Resource
from transport.session import Session


class Publisher(Resource):
    """Puts payloads on one key; a latched one keeps the last for those who join later."""

    def __init__(self, session: Session, key: str, *, latched: bool = True) -> None:
        """Declare the key.

        Args:
            session: open session.
            key: where to publish.
            latched: late joiners get the last payload, and receivers notice losses.

        Raises:
            SessionClosed: the session is closed.
            TransportError: the key is not valid.
        """
        declare = zenoh_api.declare_latched_publisher if latched else zenoh_api.declare_plain_publisher
        self.key = key
        self._raw = session.attempt(lambda: declare(session.raw, key), f"cannot publish on {key!r}")
        self._count = 0
        super().__init__(session)

    @property
    def count(self) -> int:
        """Payloads that were put."""
        return self._count

    def put(self, payload: bytes | bytearray, attachment: bytes | None = None) -> None:
        """Send one payload. Returns without error when nobody listens or the link is down.

        Raises:
            SessionClosed: the session is closed.
        """
        self._session.attempt(lambda: self._raw.put(payload, attachment=attachment), f"cannot send on {self.key!r}")
        self._count += 1

    def _release(self) -> None:
        if not self._session.raw_is_closed:
            self._raw.undeclare()
