"""Announcements of stance pauses: publisher for the gait controller, receiver, and the clock of the stamps."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any
from weakref import WeakKeyDictionary, WeakValueDictionary

from transport import clock
from transport.exceptions import MessageError
from transport.keys import DEFAULT_ROBOT, gait_clock_key, stance_key
from transport.links.answerer import Answerer
from transport.links.ordered_receiver import OrderedReceiver
from transport.links.publisher import URGENT, Publisher, Sender
from transport.links.session import Session
from transport.messages.codec import decode, encode, make_time, read_time
from transport.messages.stance_pause import PausePhase, StancePause, decode_stance_pause, encode_stance_pause
from transport.messages.typestore import STANCE_PAUSE, TIME, cdr
from transport.queries.remote_clock import ClockBound, RemoteClock

# Interval of queries of the gait's clock [s]. If the clock is set in between, the next reply reveals this.
CLOCK_PERIOD = 2.0
# Time without a reply after which a gait controller that has replied before counts as lost [s]; it may then have begun
# the next pause unnoticed.
GAIT_SILENT = 4.0


# Publisher of the last BEGIN or END, by session and robot.
_LAST: WeakKeyDictionary[Session, WeakValueDictionary[str, StancePublisher]] = WeakKeyDictionary()


class StancePublisher(Sender):
    """Publisher of stance pauses and of the clock that stamps them. It never waits for a receiver.

    Receivers that start during a pause still receive the BEGIN of the pause. They receive nothing from an older
    publisher of the same robot in the same session, so that the END of an earlier walk does not end the pause.

    Args:
        session: open session.
        robot: instance name, as in every published `StancePause`.
        clock: returns the current time [ns] of the clock that stamps the pauses. The node queries this clock to
            distinguish a late message from a clock offset; it does not confirm scans without a reply.
    """

    def __init__(
        self, session: Session, *, robot: str = DEFAULT_ROBOT, clock: Callable[[], int] = time.time_ns
    ) -> None:
        """Declare the keys of pauses and clock."""
        self._robot, self._clock = robot, clock
        encoding = cdr(STANCE_PAUSE)
        self._publisher = Publisher(session, stance_key(robot), priority=URGENT, encoding=encoding)
        # HOLD is not latched, because late subscribers need the last BEGIN or END.
        self._holds = Publisher(session, stance_key(robot), latched=False, priority=URGENT, encoding=encoding)
        self._count = 0
        self._answerer = Answerer(session, gait_clock_key(robot), self._answer)
        super().__init__(session, self._answerer, self._holds, self._publisher)

    def publish(self, pause: StancePause) -> None:
        """Announce a pause; returns immediately. Announcements are sent in order; a newer HOLD replaces a waiting one.

        Raises:
            SessionClosed: the session is closed.
            MessageError: the announcement is for another robot.
        """
        if pause.robot != self._robot:
            raise MessageError(
                f"a pause of robot {pause.robot!r} cannot be published on the key of {self._robot!r}; "
                f"publish it with StancePublisher(session, robot={pause.robot!r})"
            )
        if pause.phase is PausePhase.HOLD:
            self._outbox.post(f"{self._holds.key} hold", lambda: self._holds.put(encode_stance_pause(pause)))
            return
        last = _LAST.setdefault(self._session, WeakValueDictionary())
        before, last[self._robot] = last.get(self._robot), self
        if before is not None and before is not self:
            before._publisher.forget()
        self._count += 1
        key = f"{self._publisher.key} {self._count}"
        self._outbox.post(key, lambda: self._publisher.put(encode_stance_pause(pause)))

    def _answer(self, query: Any) -> None:
        query.reply(self._answerer.key, encode(make_time(self._clock())), encoding=cdr(TIME))


class GaitClock(RemoteClock):
    """Clock of the gait controller, which stamps the announcements."""

    def __init__(self, session: Session, robot: str = DEFAULT_ROBOT, on_news: Callable[[], None] | None = None) -> None:
        """Start to query the clock; `on_news` is called on the querying thread when the bound of the clock changes."""
        self._on_news = on_news
        self._bound: ClockBound | None = None
        self._heard = math.inf
        super().__init__(session, gait_clock_key(robot), period=CLOCK_PERIOD)

    @property
    def state(self) -> str:
        """State of the gait controller: "heard", "silent" (it has stopped replying), or "" before the first reply."""
        if self._bound is None:
            return ""
        return "silent" if clock.now() - self._heard > GAIT_SILENT else "heard"

    def earliest(self, stamp: int) -> float | None:
        """Return the earliest time on `transport.clock` [s] at which the gait's clock can have shown `stamp` [ns].

        Returns None before the first reply.
        """
        bound = self._bound
        return None if bound is None else bound.earliest(stamp * 1e-9)

    def at(self, time: float) -> tuple[float, float] | None:
        """Return the gait's clock reading at a time on `transport.clock`, and its error bound [s]; None if unknown."""
        bound = self._bound
        return None if bound is None else bound.at(time)

    def _take(self, payload: bytes, asked: float, answered: float) -> bool:
        newer, before = ClockBound(read_time(decode(payload, TIME)) * 1e-9, asked, answered), self._bound
        self._bound = newer if before is None else before.after(newer)
        self._heard = answered
        if self._on_news is not None and self._bound is newer:
            self._on_news()
        return True


class StanceReceiver(OrderedReceiver[StancePause]):
    """Receiver of the stance pauses of a robot; calls `on_pause` with the valid announcements, in the order of arrival.

    `latest` and the waiting methods return only the newest announcement, as in every receiver. If too many
    announcements wait, the oldest HOLD or invalid one is dropped; if there is none, the oldest announcement.
    """

    def __init__(
        self,
        session: Session,
        *,
        robot: str = DEFAULT_ROBOT,
        on_pause: Callable[[StancePause], None] | None = None,
        on_refused: Callable[[MessageError], None] | None = None,
    ) -> None:
        """Subscribe to the announcements.

        Args:
            session: open session.
            robot: instance name.
            on_pause: called with each announcement, on a background thread.
            on_refused: called on that thread with the error when an announcement is not valid (the state of the robot
                is then unknown), or has an unknown phase (UnknownPhase); once for consecutive waiting announcements
                with the same type of error.
        """
        super().__init__(session, stance_key(robot), decode_stance_pause, on_pause, on_refused)

    def _is_dispensable(self, message: StancePause) -> bool:
        return message.phase is PausePhase.HOLD
