"""Results of a scan: stripes with their frames and verdicts, and the report."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass

from drivers.arrays import Image
from drivers.frame import Frame
from drivers.sweep.firing_order import PlannedStripe


class StripeVerdict(enum.Enum):
    """Verdict on a stripe.

    A stripe is in step unless its frame is lost, or laser, mirror or frame contradict the commands.

    Attributes:
        OK: laser, mirror and frame are in step.
        UNPROVED: there was nothing to compare with, as for the first stripe of a scan without off frames.
        AMBIENT_CHANGED: in step, but the ambient light or the exposure differs from that of the reference frame.
        DARK: the laser was switched on, but hardly any column shows it: the ground is black, or the laser has failed.
        LEAK: the off frame shows a stripe: the laser was not off, or the frame is older than the command.
        NOT_MOVED: the stripe has moved much less than expected since the previous one: the mirror did not move, or the
            frame is older than the command.
        OUT_OF_BAND: the stripe is outside the rows in which it can be.
        REPEATED: the frame is identical to the off frame or to the previous on frame, although laser or mirror changed.
        RESIZED: size or dtype of the frame differs from that of earlier frames.
        LOST: the frame of the stripe, or of the dark flash after it (a frame with the laser off), did not arrive or
            could not be verified.
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
        """True for OK, UNPROVED, AMBIENT_CHANGED and DARK, which do not contradict the commands."""
        return self in IN_STEP


IN_STEP = frozenset({StripeVerdict.OK, StripeVerdict.UNPROVED, StripeVerdict.AMBIENT_CHANGED, StripeVerdict.DARK})


@dataclass(frozen=True, slots=True)
class StripeEvidence:
    """Measurements on which a verdict is based.

    The reference is the off frame or, if there is none, the on frame of the previous stripe.

    Attributes:
        lit_fraction: fraction of the sampled columns that show the laser, 0 ... 1.
        leak_fraction: fraction of the sampled columns in which the off frame is the brighter one, as if it showed a
            stripe; 0 without an off frame.
        contrast: median excess of the stripe over the reference, minus `offset`, in counts summed over channels; NaN if
            no column is lit.
        offset: median excess of the whole frame over the reference, in the same unit.
        noise: standard deviation of the difference from the reference, in the same unit.
        row: median row of the stripe [px]; NaN if no column is lit.
        row_shift: median shift of the stripe from the previous one [px]; NaN if unknown.
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
    """Captured stripe; the verdict is final once the stripe is handed over to the caller.

    Attributes:
        index: index of the stripe in the standard pattern.
        mirror_angle: commanded mirror angle [rad].
        mirror_angle_reached: mirror angle at the nearest motor step [rad].
        on: frame with the laser on, read-only; None if it or the dark frame after it was lost, if it could not be
            verified, or if its size or dtype had changed.
        off: frame with the laser off, read-only; None if there is none.
        on_stamp: time of the on frame on the monotonic clock [s]; NaN if there is none.
        off_stamp: time of the off frame on the monotonic clock [s]; NaN if there is none.
        verdict: verdict on laser, mirror and frame.
        evidence: measurements on which the verdict is based; None if no frames could be compared.
        dark: frame of the dark flash after the stripe, read-only; None if there was no dark flash or its frame was
            lost.
        dark_stamp: time of the dark frame on the monotonic clock [s]; NaN if there is none.
        is_dark_due: True if a dark flash was planned or taken after this stripe.
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
        """Make a stripe from its frames before the images are compared; `reached` is `mirror_angle_reached`."""
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
    """Result of a scan so far; complete once the iteration over its stripes has ended.

    Attributes:
        planned: indices of the planned stripes, in the firing order.
        fired: indices for which the laser was on, in order; their frames may have been lost.
        verdicts: (index, verdict) of each stripe handed over, in order.
        stopped_early: True if `should_stop` ended the scan.
        failure: text of the error that ended the scan, or None.
        frames_used: number of frames accepted, where a shared off frame counts once; in a sweep (the board moves the
            mirror by itself), number of stripes with verified frames.
        frames_skipped: number of frames discarded because they may have been exposed before a command had taken effect;
            in a sweep, because they have no device time.
        frames_dropped: number of frames that the camera counted but did not deliver: in a sweep, all of them;
            otherwise, only those that were due while a frame was expected.
        frames_repeated: number of frames that were delivered twice.
        duration: time from the start of the scan to the stamp of its last frame [s].
        problems: descriptions of problems; empty for a good scan.
        notes: further remarks.
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
        """Planned indices that were not handed over, in order."""
        done = {index for index, _ in self.verdicts}
        return tuple(index for index in self.planned if index not in done)

    @property
    def in_step(self) -> bool:
        """True if at least one stripe is OK and none is out of step."""
        kinds = [verdict for _, verdict in self.verdicts]
        return StripeVerdict.OK in kinds and all(kind.in_step for kind in kinds)
