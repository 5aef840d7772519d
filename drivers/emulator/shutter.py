"""Shutter of an emulated camera that waits for its trigger, and its failures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

# Times at which a shutter opens and closes [s].
Opening = tuple[float, float]


@dataclass(slots=True)
class Shutter:
    """Behaviour of the camera on the board's TRIGGER; may be changed at any time.

    Attributes:
        wired: its EXPOSURE_ACTIVE is connected to the board.
        delay: time from the trigger to the opening [s].
        exposure: how long it is open [s].
        missed: numbers of the triggers, from 0, that it does not see.
        doubled: numbers of the triggers after which it opens twice.
        late: numbers of the triggers after which it opens late, each with how much later that is [s].
    """

    wired: bool = False
    delay: float = 50e-6
    exposure: float = 0.004
    missed: frozenset[int] = frozenset()
    doubled: frozenset[int] = frozenset()
    late: Mapping[int, float] = field(default_factory=dict)

    def openings(self, number: int, trigger: float, closed_since: float) -> tuple[Opening, ...]:
        """Openings of the shutter for a trigger.

        Args:
            number: number of the trigger, from 0.
            trigger: when it came [s].
            closed_since: when the last opening ended [s]; a trigger before that is not seen.
        """
        if number in self.missed or trigger < closed_since:
            return ()
        start = trigger + self.delay + self.late.get(number, 0.0)
        first = (start, start + self.exposure)
        if number not in self.doubled:
            return (first,)
        again = first[1] + self.delay
        return (first, (again, again + self.exposure))
