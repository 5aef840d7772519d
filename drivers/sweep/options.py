"""Options of a scan: off frames, timeouts, queues, and sweeps that the board executes."""

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
        flash: longest duration of a stripe's flash [s].
        period: shortest time between two triggers [s]; the camera's `trigger_period` applies if it is longer.
        tolerance: allowed difference between an interval of triggers and the same interval on the camera's clock [s].
        repeats: largest number of additional sweeps for stripes whose frames could not be verified.

    Raises:
        ValueError: a value is not allowed.
    """

    flash: float = 0.004
    period: float = 0.0
    tolerance: float = 0.001
    repeats: int = 1

    def __post_init__(self) -> None:
        """Check every value."""
        for name, least, most, unit in (
            ("flash", FLASH_SHORTEST_US * 1e-6, FLASH_LONGEST_US * 1e-6, " s"),
            ("period", 0, PERIOD_LONGEST_US * 1e-6, " s"),
            ("tolerance", 1e-4, 0.002, " s"),
            ("repeats", 0, 5, ""),
        ):
            if not least <= getattr(self, name) <= most:
                raise ValueError(f"{name} is {getattr(self, name)}{unit}, allowed: {least:g} ... {most:g}{unit}")


class OffFrames(enum.Enum):
    """Frames with the laser off, with which the frames of stripes are compared.

    Attributes:
        PER_STRIPE: one off frame after each on frame, while the mirror moves; robust in changing light, but twice as
            many frames.
        ONE: one off frame before the first stripe, shared by all stripes; for light that does not change during a scan.
        NONE: no off frames.
    """

    PER_STRIPE = "per stripe"
    ONE = "one"
    NONE = "none"


@dataclass(frozen=True, slots=True, kw_only=True)
class AcquireOptions:
    """Options of `acquire`.

    Attributes:
        off: off frames to take.
        frame_timeout: time after which a frame counts as lost [s].
        max_lost: number of consecutive stripes without a frame after which the scan ends with an error.
        flush_frames: number of frames dropped after every change of laser or mirror, if the camera's `lag` is unknown.
        queue_size: number of stripes that may wait for the caller, rounded up to whole groups of `together`. If the
            queue is full, the scan waits with the laser off.
        together: number of stripes in each group handed to the caller. Groups shrink towards the end of the scan, to at
            most twice the number of remaining stripes, and the last group has one stripe (two with `dark_after`). A
            caller that needs at most half a frame's time per stripe is then ready for the last stripe when it arrives.
            Processing in groups is faster, but each waiting stripe takes the memory of a frame.
        limits: thresholds of the comparison of frames.
        dark_after: indices of the stripes that are followed by a frame with the laser off (see `draw_code`). A stripe
            whose dark frame is lost counts as lost.
        sweep: options of a sweep in which the board moves the mirror and triggers the camera; None = the host moves the
            mirror, and the camera is free-running. Of the other options, a sweep uses `off`, `limits` and `dark_after`.
            It does not wait for a slow caller, so all its frames may be queued.

    Raises:
        ValueError: a value is not allowed.
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
            raise ValueError(f"frame_timeout is {self.frame_timeout} s; it must be finite and above 0")
        for name, lowest in (("max_lost", 1), ("flush_frames", 0), ("queue_size", 1), ("together", 1)):
            if getattr(self, name) < lowest:
                raise ValueError(f"{name} is {getattr(self, name)}; it must be {lowest} or more")
