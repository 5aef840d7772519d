"""`GridWaiter`: waits until a receiver has a message that may be used, and says why none came."""

from __future__ import annotations

from collections.abc import Callable

from transport.exceptions import ReceiveTimeout, ScannerGone, ScannerUnavailable, StaleTerrain
from transport.grid_judge import G, GridJudge
from transport.messages.terrain_message import TerrainMessage
from transport.received import Received
from transport.receiver import NewestReceiver

# [s] After subscribing, the last grid and the node's sign of life are there within this time: measured below 0.1 s on
# a free machine, the rest is for a busy one. Only a wait for a grid that never comes lasts that long.
SETTLE = 2.0
# [s] A grid of a later pause than the one asked for may be of a walk that is over: when the robot does not stand, the
# BEGIN of the next walk may be on its way.
NEWS = 1.0


class GridWaiter:
    """Waits for one client; a `GridJudge` says of each grid whether it may be used."""

    def __init__(self, judge: GridJudge, robot: str) -> None:
        """Wait for grids of the instance `robot`."""
        self._judge, self._robot = judge, robot

    @staticmethod
    def first(receiver: NewestReceiver[G], timeout: float) -> Received[G] | None:
        """The newest message, however old, that is there within `timeout` [s]; None when none is."""
        try:
            return receiver.wait_for(lambda _: True, max(0.0, timeout))
        except ReceiveTimeout:
            return None

    def newest(self, receiver: NewestReceiver[G], timeout: float, max_age: float | None) -> G:
        """The newest message that may still be used; arguments and errors as of `PerceptionClient.summary`."""
        return self.wait(receiver, lambda _: True, timeout, max_age, says_stale=True).message

    def wait(
        self,
        receiver: NewestReceiver[G],
        predicate: Callable[[G], bool],
        timeout: float | None,
        max_age: float | None,
        *,
        after: int = 0,
        says_stale: bool = False,
    ) -> Received[G]:
        """The newest message that `predicate` accepts and that may still be used.

        Args:
            receiver: receiver of the messages.
            predicate: called with each newest message.
            timeout: longest wait [s]; None waits without end.
            max_age: as in `PerceptionClient.latest`.
            after: number of a sample; only later ones count.
            says_stale: raise StaleTerrain when one came in time and was too old, instead of saying so in the error.

        Raises:
            StaleTerrain: see `says_stale`.
            ReceiveTimeout: none came in time although the node lives.
            ScannerGone, ScannerUnavailable: none came, and the node went away or was never seen.
        """
        stale: StaleTerrain | None = None

        def accepts(received: Received[G]) -> bool:
            nonlocal stale
            if not predicate(received.message):
                return False
            try:
                self._judge.check(received, max_age, wait=SETTLE)
            except StaleTerrain as error:
                stale = error
                return False
            return True

        try:
            return receiver.wait_until(accepts, timeout, after=after)
        except ReceiveTimeout as error:
            if stale is not None and says_stale:
                raise stale from error
            raise self._not_received(f"{error}" if stale is None else f"{error}; {stale}") from error

    def is_of_step(self, step: int, epoch: str | None, *, confirmed: bool) -> Callable[[TerrainMessage], bool]:
        """Whether a grid is of stance pause `step` or a later one; arguments as of `PerceptionClient.wait_for_step`."""

        def predicate(terrain: TerrainMessage) -> bool:
            if terrain.step < step or (confirmed and terrain.provisional):
                return False
            if epoch is not None:
                return terrain.epoch == epoch
            if terrain.step > step:
                self._judge.wait_for_news(NEWS)
            return True

        return predicate

    def unavailable(self, found: str = "") -> ScannerUnavailable:
        """The error when no node is visible; its message begins with `found`, which says what else is known."""
        return ScannerUnavailable(
            f"{found}no node of robot {self._robot!r} was found: none runs on this router, the instance name "
            f"differs, or this side may not read (the role of its certificate)"
        )

    def _not_received(self, found: str) -> ReceiveTimeout | ScannerGone | ScannerUnavailable:
        """Why nothing came in time, by what is known of the node."""
        if self._judge.node.is_alive:
            return ReceiveTimeout(found)
        if self._judge.node.was_seen:
            return ScannerGone(f"{found}; the node of {self._robot!r} went away")
        return self.unavailable(f"{found}; ")
