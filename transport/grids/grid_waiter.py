"""Waiting for grids that may be used, and the reason when none came."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial

from transport import clock, zenoh_api
from transport.exceptions import ReceiveTimeout, ScannerGone, ScannerUnavailable, StaleTerrain
from transport.grids.evidence import G
from transport.grids.grid_judge import POLL, TAKING_BACK, GridJudge, Terms
from transport.keys import PERCEPTION_VERSION, alive_keys_of_all_versions
from transport.links.received import Received
from transport.links.receiver import NewestReceiver
from transport.links.session import Session
from transport.messages.terrain_message import TerrainMessage

# [s] After subscribing, the last grid and the node's sign of life are there within this time: measured below 0.1 s on
# a free machine, the rest is for a busy one. Only a wait for a grid that never comes lasts that long.
SETTLE = 2.0
# [s] A grid of a later pause than the one asked for may be of a walk that is over: when the robot does not stand, the
# BEGIN of the next walk may be on its way.
NEWS = 1.0


class GridWaiter:
    """Waits for grids that a `GridJudge` accepts."""

    def __init__(self, session: Session, judge: GridJudge, robot: str) -> None:
        """Wait for grids of the instance `robot`."""
        self._session, self._judge, self._robot = session, judge, robot

    @staticmethod
    def first(receiver: NewestReceiver[G], timeout: float) -> Received[G] | None:
        """Newest message, however old, that arrives within `timeout` [s]; None if none does."""
        try:
            return receiver.wait_for(lambda _: True, max(0.0, timeout))
        except ReceiveTimeout:
            return None

    def newest(self, receiver: NewestReceiver[G], timeout: float, terms: Terms) -> G:
        """The newest message that may be used; arguments and errors as of `PerceptionClient.summary`."""
        return self.wait(receiver, lambda _: True, timeout, terms, says_stale=True).message

    def wait(
        self,
        receiver: NewestReceiver[G],
        predicate: Callable[[Received[G]], bool],
        timeout: float | None,
        terms: Terms,
        *,
        after: int = 0,
        says_stale: bool = False,
        takes_back: bool = False,
    ) -> Received[G]:
        """The newest message that `predicate` accepts and that may be used.

        Args:
            receiver: receiver of the messages.
            predicate: called with each newest message.
            timeout: longest wait [s]; None waits without end.
            terms: what the caller accepts.
            after: number of a sample; only later ones count.
            says_stale: raise StaleTerrain when one came in time and was refused, instead of saying so in the error.
            takes_back: accept a message that withdraws another too, with the objections to it.

        Raises:
            StaleTerrain: see `says_stale`.
            ReceiveTimeout: none came in time although the node lives.
            ScannerGone, ScannerUnavailable: none came, and the node went away or was never seen.
        """
        deadline = math.inf if timeout is None else clock.now() + timeout
        stale: StaleTerrain | None = None
        while True:
            left = deadline - clock.now()
            try:
                received = receiver.wait_until(predicate, None if timeout is None else max(left, 0.0), after=after)
                message = self._judge.check(
                    received,
                    TAKING_BACK if takes_back and received.message.withdrawn else terms,
                    patience=max(0.0, min(left, SETTLE)),
                    is_superseded=partial(receiver.has_newer, received),
                )
                return replace(received, message=message)
            except StaleTerrain as error:
                stale = error
                if error.is_final:
                    after = received.number
                elif clock.now() < deadline:
                    # The node may come back, and the grid be good: it is judged again.
                    time.sleep(min(POLL, deadline - clock.now()))
                else:
                    after = received.number
            except ReceiveTimeout:
                if stale is not None and says_stale:
                    raise stale from None
                found = receiver.nothing(timeout or 0.0)
                raise self._not_received(found if stale is None else f"{found}; {stale}") from None

    def is_of_step(
        self, step: int, epoch: str | None, *, refined_only: bool = False
    ) -> Callable[[Received[TerrainMessage]], bool]:
        """Predicate for grids of stance pause `step` or later; arguments as in `PerceptionClient.wait_for_step`."""

        def predicate(received: Received[TerrainMessage]) -> bool:
            terrain = received.message
            if terrain.step < step or (refined_only and terrain.refinement_follows):
                return False
            if epoch is not None:
                return terrain.epoch == epoch
            if terrain.step > step:
                self._judge.wait_for_news(NEWS)
            return True

        return predicate

    def unavailable(self, found: str = "") -> ScannerUnavailable:
        """Error for a missing node; its message begins with `found`."""
        # Nodes of other major versions have other keys, so that nothing of them is received.
        others = zenoh_api.tokens(self._session.raw, alive_keys_of_all_versions(self._robot))
        versions = sorted({key.split("/")[2] for key in others} - {PERCEPTION_VERSION})
        if versions:
            return ScannerUnavailable(
                f"{found}the node of robot {self._robot!r} speaks version {', '.join(versions)} of the messages, this "
                f"package {PERCEPTION_VERSION}: install the same version on both sides"
            )
        return ScannerUnavailable(
            f"{found}no node of robot {self._robot!r} was found: none runs on this router, the instance name "
            f"differs, or this side may not read (the role of its certificate)"
        )

    def _not_received(self, found: str) -> ReceiveTimeout | ScannerGone | ScannerUnavailable:
        """Error for a wait without result, by the state of the node."""
        if self._judge.node.is_alive:
            return ReceiveTimeout(found)
        if self._judge.node.was_seen:
            return ScannerGone(f"{found}; the node of {self._robot!r} went away")
        return self.unavailable(f"{found}; ")
