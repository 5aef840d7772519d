"""A stripe as the thread of a scan hands it over: not yet judged by its pictures."""

from __future__ import annotations

from dataclasses import dataclass

from drivers.firing_order import PlannedStripe
from drivers.frame import Frame


@dataclass(frozen=True, slots=True)
class RawStripe:
    """A stripe with its frames.

    Attributes:
        stripe: what was planned.
        reached: mirror angle of the motor step nearest to it [rad].
        on: frame with the laser on; None when it was lost.
        off: frame with the laser off; None when there is none.
    """

    stripe: PlannedStripe
    reached: float
    on: Frame | None
    off: Frame | None
