"""A stripe as the thread of a scan delivers it: the verdict on its pictures follows later."""

from __future__ import annotations

from dataclasses import dataclass

from drivers.frame import Frame
from drivers.sweep.firing_order import PlannedStripe


@dataclass(frozen=True, slots=True)
class RawStripe:
    """A stripe with its frames.

    Attributes:
        stripe: the stripe as planned.
        reached: mirror angle at the motor step nearest to the planned angle [rad].
        on: frame with the laser on; None when it was lost.
        off: frame with the laser off; None when there is none.
    """

    stripe: PlannedStripe
    reached: float
    on: Frame | None
    off: Frame | None
