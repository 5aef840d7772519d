"""Shutter of an emulated hardware-triggered camera, with faults to inject."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

# Times at which the shutter opens and closes [s].
Opening = tuple[float, float]


@dataclass(slots=True)
class Shutter:
    """Response of the camera to the board's TRIGGER line; may be changed at any time.

    Attributes:
        wired: True if the camera's EXPOSURE_ACTIVE output is connected to the board.
        delay: time from the trigger to the opening [s].
        exposure: exposure time [s].
        missed: numbers of the triggers, from 0, that the camera misses.
        doubled: numbers of the triggers that open the shutter twice.
        late: trigger number -> additional delay [s].
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
            trigger: time of the trigger [s].
            closed_since: end of the last opening [s]; an earlier trigger is ignored.
        """
        if number in self.missed or trigger < closed_since:
            return ()
        start = trigger + self.delay + self.late.get(number, 0.0)
        first = (start, start + self.exposure)
        if number not in self.doubled:
            return (first,)
        again = first[1] + self.delay
        return (first, (again, again + self.exposure))
