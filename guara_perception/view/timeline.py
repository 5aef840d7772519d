"""The moments of a walk in order, which of them is shown, and which comes next."""

from __future__ import annotations

from collections.abc import Sequence

from guara_perception.arrays import Float
from guara_perception.view.moment import Moment

# Pauses of a live walk that are kept: a map is 2 MB.
KEPT = 60


class Timeline:
    """Moments in order and the number of the moment that is shown; while that is the newest, a newer one is shown."""

    def __init__(self) -> None:
        """Start empty."""
        self._moments: list[Moment] = []
        self.number = 0

    def __len__(self) -> int:
        """How many moments there are."""
        return len(self._moments)

    @property
    def shown(self) -> Moment | None:
        """The moment that is shown, None before the first."""
        return self._moments[self.number] if self._moments else None

    @property
    def is_newest(self) -> bool:
        """Whether the newest is shown."""
        return self.number >= len(self._moments) - 1

    def replace(self, moments: Sequence[Moment]) -> None:
        """Take other moments and begin with the first."""
        self._moments, self.number = list(moments), 0

    def add(self, moment: Moment) -> None:
        """Add the newest moment; it replaces the one before if it is of the same pause."""
        follow = self.is_newest
        last = self._moments[-1] if self._moments else None
        if last is not None and (last.step, last.walk) == (moment.step, moment.walk):
            self._moments[-1] = moment
        else:
            self._moments.append(moment)
        if len(self._moments) > KEPT:
            del self._moments[0]
            self.number = max(self.number - 1, 0)
        if follow:
            self.number = len(self._moments) - 1

    def go_to(self, number: int) -> bool:
        """Show the moment of this number, or the nearest to it; return whether another moment is now shown."""
        before, self.number = self.number, max(0, min(number, len(self._moments) - 1))
        return self.number != before

    def poses(self) -> list[Float]:
        """Poses (4, 4) of base_footprint in odom, of this walk up to the moment that is shown."""
        shown = self.shown
        until = self._moments[: self.number + 1]
        return [item.transform_footprint_to_odom for item in until if shown is not None and item.walk == shown.walk]
