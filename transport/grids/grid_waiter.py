"""Waiting for usable grids, and the errors raised if none arrives."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial

from transport import clock
from transport.exceptions import MessageError, ReceiveTimeout, ScannerGone, ScannerUnavailable, StaleTerrain
from transport.grids.evidence import G
from transport.grids.grid_judge import POLL, TAKING_BACK, GridJudge, Terms
from transport.keys import PERCEPTION_VERSION, alive_keys_of_all_versions
from transport.links.liveliness import alive_keys
from transport.links.received import Received
from transport.links.receiver import NewestReceiver
from transport.links.session import Session
from transport.messages.terrain_message import TerrainMessage

# Time from subscribing within which the node's liveliness token and, over a fast link, its last grid arrive [s]; below
# 0.1 s on an idle machine, more on a busy one. Only a wait for something that never arrives takes this long.
SETTLE = 2.0
# Longest wait for the next BEGIN [s]. A grid from a later pause than requested may be from a walk that has ended; if
# the robot is not standing, only the next BEGIN can show this.
NEWS = 1.0


class GridWaiter:
    """Waiting for grids that a `GridJudge` accepts."""

    def __init__(self, session: Session, judge: GridJudge, robot: str) -> None:
        """Prepare to wait for grids of the robot with the instance name `robot`."""
        self._session, self._judge, self._robot = session, judge, robot

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
        """Wait until the newest message may be used and `predicate` accepts it; return the message.

        Args:
            receiver: receiver of the messages.
            predicate: called with each new message, or the newest of several; returns True to accept it.
            timeout: longest wait [s]; None = no limit.
            terms: conditions under which the caller accepts a message.
            after: number of a sample; only samples with larger numbers are considered.
            says_stale: True = if only unusable messages arrived, raise StaleTerrain instead of the other errors.
            takes_back: True = also accept a message that withdraws another one, with the reasons why it is stale.

        Raises:
            StaleTerrain: only unusable messages arrived, and `says_stale` is True.
            ReceiveTimeout: no accepted message arrived in time although the node is alive.
            ScannerGone: no accepted message arrived, and the node has disappeared.
            ScannerUnavailable: no accepted message arrived, and no node was ever seen.
            SessionClosed: the receiver is closed.
            MessageError: the timeout is NaN, which would never end.
        """
        if timeout is not None and math.isnan(timeout):
            raise MessageError("timeout is nan; allowed: a number of seconds, or None for no limit")
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
                left = deadline - clock.now()
                if error.is_final or left <= 0.0:
                    after = received.number
                else:
                    # The node may return and confirm the grid, so check the same grid again.
                    time.sleep(min(POLL, left))
            except ReceiveTimeout:
                if stale is not None and says_stale:
                    raise stale from None
                found = receiver.nothing(timeout or 0.0)
                raise self._not_received(found if stale is None else f"{found}; {stale}") from None

    def is_of_step(
        self, step: int, epoch: str | None, *, refined_only: bool = False
    ) -> Callable[[Received[TerrainMessage]], bool]:
        """Return a predicate for grids of pause `step` or later; arguments as in `PerceptionClient.wait_for_step`."""

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
        """Make the error for a missing node; its message begins with `found`."""
        # Nodes of other major versions use other keys, so none of their messages are received.
        others = alive_keys(self._session, alive_keys_of_all_versions(self._robot))
        versions = sorted({key.split("/")[2] for key in others} - {PERCEPTION_VERSION})
        if versions:
            return ScannerUnavailable(
                f"{found}the node of robot {self._robot!r} speaks version {', '.join(versions)} of the messages, this "
                f"package {PERCEPTION_VERSION}: install the same version on both sides"
            )
        return ScannerUnavailable(
            f"{found}no node of robot {self._robot!r} was found: none is running on this router, the instance name "
            f"differs, or the role of this client's certificate does not permit reading"
        )

    def _not_received(self, found: str) -> ReceiveTimeout | ScannerGone | ScannerUnavailable:
        """Make the error for a wait without a result, depending on the state of the node."""
        if self._judge.node.is_alive:
            return ReceiveTimeout(found)
        if self._judge.node.was_seen:
            return ScannerGone(f"{found}; the node of {self._robot!r} disappeared")
        return self.unavailable(f"{found}; ")
