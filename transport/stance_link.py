"""Announcements of stance pauses, from the gait controller to those who follow them."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

from transport import clock
from transport.exceptions import MessageError
from transport.keys import DEFAULT_ROBOT, gait_clock_key, stance_key
from transport.links.answerer import Answerer
from transport.links.ordered_receiver import OrderedReceiver
from transport.links.outbox import Outbox
from transport.links.publisher import URGENT, Publisher
from transport.links.session import Resource, Session
from transport.messages.codec import decode, encode, make_time, read_time
from transport.messages.stance_pause import PausePhase, StancePause, decode_stance_pause, encode_stance_pause
from transport.messages.typestore import STANCE_PAUSE, TIME, cdr
from transport.queries.remote_clock import ClockBound, RemoteClock

# [s] Between two questions for the gait's clock. One that is set in between is noticed at the next answer.
CLOCK_PERIOD = 2.0
# [s] A gait whose clock answered once and then for so long not again is not heard: it may have begun the next pause.
GAIT_SILENT = 4.0


class StancePublisher(Resource):
    """Publisher of stance pauses and of the clock that stamps them; never waits for a receiver.

    Args:
        session: open session.
        robot: instance name, the same as in each `StancePause`; whoever starts within a pause still gets its BEGIN.
        clock: gives the time now [ns] of the clock that stamps the pauses. The node asks for it, because a stamp alone
            does not tell a late message from a clock that is off, and without an answer it confirms no scan.
    """

    def __init__(
        self, session: Session, *, robot: str = DEFAULT_ROBOT, clock: Callable[[], int] = time.time_ns
    ) -> None:
        """Declare the keys."""
        self._robot, self._clock = robot, clock
        encoding = cdr(STANCE_PAUSE)
        self._publisher = Publisher(session, stance_key(robot), priority=URGENT, encoding=encoding)
        # Not kept for those who join later: they need the BEGIN.
        self._holds = Publisher(session, stance_key(robot), latched=False, priority=URGENT, encoding=encoding)
        self._outbox = Outbox()
        self._count = 0
        self._answerer = Answerer(session, gait_clock_key(robot), self._answer)
        super().__init__(session)

    def publish(self, pause: StancePause) -> None:
        """Announce; returns at once. All are sent, in order, but a HOLD that still waits is replaced by a newer one.

        Raises:
            SessionClosed: the session is closed.
            MessageError: the pause is of another robot than this publisher speaks for: nobody would hear it.
        """
        if pause.robot != self._robot:
            raise MessageError(
                f"a pause of robot {pause.robot!r} on the key of {self._robot!r} reaches nobody; "
                f"publish it by StancePublisher(session, robot={pause.robot!r})"
            )
        if pause.phase is PausePhase.HOLD:
            self._outbox.post(f"{self._holds.key} hold", lambda: self._holds.put(encode_stance_pause(pause)))
            return
        self._count += 1
        key = f"{self._publisher.key} {self._count}"
        self._outbox.post(key, lambda: self._publisher.put(encode_stance_pause(pause)))

    def _answer(self, query: Any) -> None:
        query.reply(self._answerer.key, encode(make_time(self._clock())), encoding=cdr(TIME))

    def flush(self, timeout: float) -> None:
        """Wait until all is sent; ReceiveTimeout when that takes longer than `timeout` [s]."""
        self._outbox.flush(timeout)

    def _release(self) -> None:
        self._answerer.close()
        self._outbox.close()
        self._holds.close()
        self._publisher.close()


class GaitClock(RemoteClock):
    """Clock of the gait controller, which stamps its announcements."""

    def __init__(self, session: Session, robot: str = DEFAULT_ROBOT, on_news: Callable[[], None] | None = None) -> None:
        """Begin to ask; `on_news` is called, on the thread that asks, when the clock becomes known or better known."""
        self._on_news = on_news
        self._bound: ClockBound | None = None
        self._heard = math.inf
        super().__init__(session, gait_clock_key(robot), period=CLOCK_PERIOD)

    @property
    def state(self) -> str:
        """State of the gait: "heard", "silent" once it answers no longer (a lost link), "" before any answer."""
        if self._bound is None:
            return ""
        return "silent" if clock.now() - self._heard > GAIT_SILENT else "heard"

    def earliest(self, stamp: int) -> float | None:
        """Earliest instant by `transport.clock` [s] at which a stamp [ns] can have been read; None: not known."""
        bound = self._bound
        return None if bound is None else bound.earliest(stamp * 1e-9)

    def _take(self, payload: bytes, asked: float, answered: float) -> bool:
        newer, before = ClockBound(read_time(decode(payload, TIME)) * 1e-9, asked, answered), self._bound
        self._bound = newer if before is None else before.after(newer)
        self._heard = answered
        if self._on_news is not None and self._bound is newer:
            self._on_news()
        return True


class StanceReceiver(OrderedReceiver[StancePause]):
    """Receiver of the stance pauses of one robot: `on_pause` gets every announcement, in the order of arrival.

    `latest` and the waiting methods know only the newest, as in every receiver. Of announcements that wait too long the
    oldest HOLD or unreadable one is dropped, else the oldest.
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
            on_pause: called with each announcement, on a thread of its own.
            on_refused: called on that thread when an announcement is unreadable or holds a joint that is not finite:
                what the robot does now is then not known. Several in a row are reported once.
        """
        super().__init__(session, stance_key(robot), decode_stance_pause, on_pause, on_refused)

    def _is_dispensable(self, message: StancePause) -> bool:
        return message.phase is PausePhase.HOLD
