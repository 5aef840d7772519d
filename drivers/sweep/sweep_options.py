"""How the board sweeps by itself: how long it shines, what the camera needs, what counts as proved."""

from __future__ import annotations

from dataclasses import dataclass

from drivers.board.protocol import FLASH_LONGEST_US, FLASH_SHORTEST_US, PERIOD_LONGEST_US


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepOptions:
    """Options of a sweep with a triggered camera; checks itself.

    Attributes:
        flash: how long the laser shines for a stripe at most [s].
        period: shortest time between two triggers that the camera accepts [s].
        tolerance: by how much differences of trigger times and of the camera's own times may disagree [s].
        repeats: how often stripes that could not be proved are taken again.

    Raises:
        ValueError: a value outside what is allowed.
    """

    flash: float = 0.004
    period: float = 0.0
    tolerance: float = 0.001
    repeats: int = 1

    def __post_init__(self) -> None:
        """Check every value."""
        shortest, longest = FLASH_SHORTEST_US * 1e-6, FLASH_LONGEST_US * 1e-6
        if not shortest <= self.flash <= longest:
            raise ValueError(f"flash is {self.flash} s, allowed is {shortest:g} ... {longest:g} s")
        if not 0 <= self.period <= PERIOD_LONGEST_US * 1e-6:
            raise ValueError(f"period is {self.period} s, allowed is 0 ... {PERIOD_LONGEST_US * 1e-6:g} s")
        if not 1e-4 <= self.tolerance <= 0.002:
            raise ValueError(f"tolerance is {self.tolerance} s, allowed is 0.0001 ... 0.002 s")
        if not 0 <= self.repeats <= 5:
            raise ValueError(f"repeats is {self.repeats}, allowed is 0 ... 5")
