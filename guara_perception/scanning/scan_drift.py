"""The drift check of one processed scan."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import islice
from typing import TYPE_CHECKING, Protocol

from guara_perception.calibration.drift import DRIFTING, HOLDS, Drift, check_drift
from guara_perception.ranging.stripe_points import StripePoints

if TYPE_CHECKING:
    from kinematics import StancePose

# Neighbouring columns are smoothed together: every fourth one carries as much information, in half of the time.
COLUMNS_APART = 4
# So many stripes, all over the scan, show that the whole scan is worth a check for mirrored frames.
SUSPECTED = 12
MIRRORED = (
    "mirrored left to right, the frames fit the calibration: the camera or its driver flips them, and what is on the "
    "left is taken for the right"
)


class ProcessedScan(Protocol):
    """Part of a `ScanProcessor` that the check reads."""

    pose: StancePose

    @property
    def points(self) -> Mapping[int, StripePoints]:
        """Points of each stripe, by index."""

    def mirrored_points(self) -> Mapping[int, StripePoints]:
        """The same, had every frame been mirrored left to right."""


def scan_drift(processor: ProcessedScan) -> Drift:
    """Check that the floor seen by a scan fits its calibration and the soles that the robot stands on.

    Mirrored frames look like drift, but fit when they are mirrored again.
    """
    drift = _check(processor, processor.points)
    if drift.verdict == DRIFTING and _check(processor, processor.mirrored_points()).verdict == HOLDS:
        return replace(drift, reasons=(MIRRORED, *drift.reasons))
    return drift


def mirrored(processor: ProcessedScan) -> str:
    """MIRRORED where a scan of a flat floor fits its calibration only when its frames are mirrored, else empty."""
    points = processor.points
    some = dict(islice(points.items(), 0, None, max(len(points) // SUSPECTED, 1)))
    if _check(processor, some).verdict != DRIFTING:
        return ""
    return MIRRORED if MIRRORED in scan_drift(processor).reasons else ""


def _check(processor: ProcessedScan, stripes: Mapping[int, StripePoints]) -> Drift:
    points = {index: stripe.points[::COLUMNS_APART] for index, stripe in stripes.items()}
    return check_drift(points, processor.pose.covariance, processor.pose.soles_in_footprint)
