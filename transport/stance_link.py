"""Stance pauses between the gait controller, which announces them, and whoever follows them."""

from __future__ import annotations

from collections.abc import Callable

from transport.exceptions import MessageError
from transport.keys import DEFAULT_ROBOT, stance_key
from transport.outbox import Outbox
from transport.publisher import URGENT, Publisher
from transport.receiver import NewestReceiver
from transport.resource import Resource
from transport.session import Session
from transport.stance_pause import StancePause, decode_stance_pause, encode_stance_pause


class StancePublisher(Resource):
    """The gait controller's side: announces begin and end of each pause, without ever waiting for a receiver.

    Args:
        session: open session.
        robot: instance name, the same as in each `StancePause`; whoever starts within a pause still gets its begin.
    """

    def __init__(self, session: Session, *, robot: str = DEFAULT_ROBOT) -> None:
        """Declare the key."""
        self._robot = robot
        self._publisher = Publisher(session, stance_key(robot), priority=URGENT)
        self._outbox = Outbox()
        self._count = 0
        super().__init__(session)

    def publish(self, pause: StancePause) -> None:
        """Announce one end of a pause; returns at once. Begin and end are both sent, in order.

        Raises:
            SessionClosed: the session is closed.
            MessageError: the pause is of another robot than this publisher speaks for: nobody would hear it.
        """
        if pause.robot != self._robot:
            raise MessageError(
                f"a pause of robot {pause.robot!r} on the key of {self._robot!r} reaches nobody; "
                f"publish it by StancePublisher(session, robot={pause.robot!r})"
            )
        self._count += 1
        self._outbox.post(f"{self._publisher.key} {self._count}", lambda: self._send(pause))

    def _send(self, pause: StancePause) -> None:
        self._publisher.put(encode_stance_pause(pause))

    def flush(self, timeout: float) -> None:
        """Wait until all is sent; ReceiveTimeout when that takes longer than `timeout` [s]."""
        self._outbox.flush(timeout)

    def _release(self) -> None:
        self._outbox.close()
        self._publisher.close()


class StanceReceiver(NewestReceiver[StancePause]):
    """Follows the stance pauses of one robot; the newest announcement counts.

    When a begin and an end come quickly after one another only the end may be seen: the pause is over.
    """

    def __init__(
        self,
        session: Session,
        *,
        robot: str = DEFAULT_ROBOT,
        on_pause: Callable[[StancePause], None] | None = None,
        on_refused: Callable[[MessageError], None] | None = None,
    ) -> None:
        """Subscribe.

        Args:
            session: open session.
            robot: instance name.
            on_pause: called with each newest announcement, on a thread of its own.
            on_refused: called on that thread when an announcement is unreadable or holds a joint that is not finite:
                what the robot does now is then not known.
        """
        super().__init__(session, stance_key(robot), decode_stance_pause)
        if on_pause is not None:
            self.on_newest(lambda received: on_pause(received.message), on_refused=on_refused)
