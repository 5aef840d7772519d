"""Options of a scan: off frames, time limits, buffers, and the board's own sweep."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass, field

from drivers.board.protocol import FLASH_LONGEST_US, FLASH_SHORTEST_US, PERIOD_LONGEST_US
from drivers.sweep.proof import ProofLimits


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepOptions:
    """Options of a sweep with a triggered camera.

    Attributes:
        flash: longest time of light for a stripe [s].
        period: shortest time between two triggers that the camera accepts [s].
        tolerance: allowed disagreement between differences of trigger times and of the camera's own times [s].
        repeats: number of further sweeps for stripes that could not be proved.

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


class OffFrames(enum.Enum):
    """Frames with the laser off, against which the others are compared.

    Attributes:
        PER_STRIPE: one after each on frame, while the mirror turns: safe in changing light, twice the frames.
        ONE: one before the first stripe, shared by all: for light that does not change during a scan.
        NONE: no off frame.
    """

    PER_STRIPE = "per stripe"
    ONE = "one"
    NONE = "none"


@dataclass(frozen=True, slots=True, kw_only=True)
class AcquireOptions:
    """Options of `acquire`.

    Attributes:
        off: off frames that are taken.
        frame_timeout: a frame of a stripe that takes longer counts as lost [s].
        max_lost: lost frames in a row that end the scan.
        flush_frames: frames dropped after every change of laser or mirror when the camera's `lag` is unknown.
        queue_size: stripes that may wait for the caller, rounded up to whole groups of `together`; when the queue is
            full, the scan waits with the laser off.
        together: stripes that are handed to the caller in one group, once the last of them has come. Towards the end
            groups become smaller, at most twice as large as the number of stripes still to come, and the last stripe
            comes alone: it need not wait if the caller takes at most half a frame's time for a stripe. Work in bursts
            finds its code and data in the processor's caches: on a machine that is idle between frames it takes over
            a third less time. Each stripe costs the memory of a frame.
        limits: thresholds for differences between frames.
        dark_after: indices of the stripes after which a frame is taken with the laser dark, see `draw_code`; their
            frames come with them, and a stripe whose dark frame was lost is lost.
        sweep: let the board sweep by itself and trigger the camera, see `SweepOptions`; None: the host turns the
            mirror and the camera runs freely. A sweep does not wait for a slow caller: all of its frames may queue up.

    Raises:
        ValueError: a value outside what is allowed.
    """

    off: OffFrames = OffFrames.ONE
    frame_timeout: float = 1.0
    max_lost: int = 2
    flush_frames: int = 2
    queue_size: int = 4
    together: int = 1
    limits: ProofLimits = field(default_factory=ProofLimits)
    dark_after: frozenset[int] = frozenset()
    sweep: SweepOptions | None = None

    def __post_init__(self) -> None:
        """Check every value."""
        if not (math.isfinite(self.frame_timeout) and self.frame_timeout > 0):
            raise ValueError(f"frame_timeout is {self.frame_timeout} s, it must be finite and above 0")
        for name, lowest in (("max_lost", 1), ("flush_frames", 0), ("queue_size", 1), ("together", 1)):
            if getattr(self, name) < lowest:
                raise ValueError(f"{name} is {getattr(self, name)}, it must be {lowest} or more")
