"""Results of a scan: each stripe with its frames, and the report at the end."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass

from drivers.arrays import Image
from drivers.frame import Frame
from drivers.sweep.firing_order import PlannedStripe


class StripeVerdict(enum.Enum):
    """Verdict about laser, mirror and frame of a stripe.

    Attributes:
        OK: they were in step.
        UNPROVED: there is nothing to compare with: the first stripe of a scan without off frames.
        AMBIENT_CHANGED: in step, but the light or the exposure changed between the on and the off frame.
        DARK: the laser was on, yet hardly a column shows it: a ground that swallows it, or a laser that failed.
        LEAK: the off frame shows a stripe: the laser was not off, or the frame is older than the command.
        NOT_MOVED: the stripe is where the one before was: the mirror did not turn, or the frame is older than the
            command.
        OUT_OF_BAND: the stripe is outside the rows where it can be.
        REPEATED: the frame equals the one before in every pixel, although laser or mirror changed.
        RESIZED: the frame has another size or type than those before.
        LOST: no frame came.
    """

    OK = "ok"
    UNPROVED = "unproved"
    AMBIENT_CHANGED = "ambient changed"
    DARK = "dark"
    LEAK = "leak"
    NOT_MOVED = "not moved"
    OUT_OF_BAND = "out of band"
    REPEATED = "repeated"
    RESIZED = "resized"
    LOST = "lost"

    @property
    def in_step(self) -> bool:
        """True unless the frames contradict what was commanded, which a dark stripe does not."""
        return self in IN_STEP


IN_STEP = frozenset({StripeVerdict.OK, StripeVerdict.UNPROVED, StripeVerdict.AMBIENT_CHANGED, StripeVerdict.DARK})


@dataclass(frozen=True, slots=True)
class StripeEvidence:
    """Measurements behind a verdict.

    Attributes:
        lit_fraction: share of the sampled columns that show the laser, 0 ... 1.
        leak_fraction: share of the sampled columns where the off frame is brighter, as if by a stripe.
        contrast: median brightness of the stripe above the off frame, in counts of the image, channels summed; NaN when
            none is lit.
        offset: by how much the whole frame is brighter than the off frame, in the same counts.
        noise: standard deviation of the difference, in the same counts.
        row: median row of the stripe [px]; NaN when none is lit.
        row_shift: median shift of the stripe against the one taken before [px]; NaN when unknown.
    """

    lit_fraction: float
    leak_fraction: float
    contrast: float
    offset: float
    noise: float
    row: float
    row_shift: float


@dataclass(frozen=True, slots=True)
class StripeCapture:
    """One stripe, made by the scan's thread and judged when it is handed over.

    Attributes:
        index: index of the stripe in the standard pattern.
        mirror_angle: commanded mirror angle [rad].
        mirror_angle_reached: mirror angle at the motor step nearest to it [rad].
        on: frame with the laser on, read-only; None when it was lost or of another size.
        off: frame with the laser off; None when there is none.
        on_stamp: time of the on frame on the monotonic clock [s], NaN without one.
        off_stamp: time of the off frame on the monotonic clock [s], NaN without one.
        verdict: verdict about laser, mirror and frame.
        evidence: the measurements behind the verdict; None without a frame.
        dark: frame of the dark flash that came after the stripe, read-only; None where none was due or it was lost.
        dark_stamp: time of that frame on the monotonic clock [s], NaN without one.
        is_dark_due: whether the code of the sweep has a dark flash after this stripe.
    """

    index: int
    mirror_angle: float
    mirror_angle_reached: float
    on: Image | None
    off: Image | None
    on_stamp: float
    off_stamp: float
    verdict: StripeVerdict
    evidence: StripeEvidence | None
    dark: Image | None = None
    dark_stamp: float = math.nan
    is_dark_due: bool = False

    @classmethod
    def of(
        cls, stripe: PlannedStripe, reached: float, on: Frame | None, off: Frame | None, dark: Frame | None = None
    ) -> StripeCapture:
        """A stripe of some frames that has not been judged; `reached` as `mirror_angle_reached`."""
        return cls(
            index=stripe.index,
            mirror_angle=stripe.mirror_angle,
            mirror_angle_reached=reached,
            on=None if on is None else on.image,
            off=None if off is None else off.image,
            on_stamp=math.nan if on is None else on.stamp,
            off_stamp=math.nan if off is None else off.stamp,
            verdict=StripeVerdict.LOST if on is None else StripeVerdict.UNPROVED,
            evidence=None,
            dark=None if dark is None else dark.image,
            dark_stamp=math.nan if dark is None else dark.stamp,
        )


@dataclass(frozen=True, slots=True)
class ScanReport:
    """The result of a scan, so far or at its end.

    Attributes:
        planned: indices of the firing order, in order.
        fired: indices for which the laser was on, in order (their frames may have been lost).
        verdicts: (index, verdict) of each stripe handed out, in order.
        stopped_early: whether `should_stop` ended it.
        failure: the error that ended it, or None.
        frames_used: frames handed out, shared off frames once.
        frames_skipped: frames dropped because they were exposed before a command had taken effect.
        frames_dropped: frames that the camera counted but did not deliver, while one was awaited.
        frames_repeated: frames delivered twice.
        duration: time from the first command to the arrival of the last frame [s].
        problems: sentences about problems; empty for a good scan.
        notes: remarks on how it was taken.
    """

    planned: tuple[int, ...]
    fired: tuple[int, ...]
    verdicts: tuple[tuple[int, StripeVerdict], ...]
    stopped_early: bool
    failure: str | None
    frames_used: int
    frames_skipped: int
    frames_dropped: int
    frames_repeated: int
    duration: float
    problems: tuple[str, ...]
    notes: tuple[str, ...] = ()

    @property
    def missing(self) -> tuple[int, ...]:
        """Indices that were planned but not handed out, in order."""
        done = {index for index, _ in self.verdicts}
        return tuple(index for index in self.planned if index not in done)

    @property
    def in_step(self) -> bool:
        """True if some stripe is OK and none is out of step."""
        kinds = [verdict for _, verdict in self.verdicts]
        return StripeVerdict.OK in kinds and all(kind.in_step for kind in kinds)
