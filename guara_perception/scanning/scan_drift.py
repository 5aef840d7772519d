"""The drift check of one processed scan."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from guara_perception.calibration.drift import DRIFTING, HOLDS, Drift, check_drift
from guara_perception.ranging.stripe_points import StripePoints
from guara_perception.scanning.scan_processor import ScanProcessor

# Neighbouring columns are smoothed over one another: every fourth says as much of the floor, in half of the time.
COLUMNS_APART = 4
MIRRORED = (
    "mirrored left to right, the frames fit the calibration: the camera or its driver flips them, and what lies on the "
    "left is taken for the right"
)


def scan_drift(processor: ScanProcessor) -> Drift:
    """Whether what a scan shows of the floor fits its calibration and the soles that the robot stands on.

    Mirrored frames look like drift; they are distinguished from it, since they fit when mirrored again.
    """
    drift = _check(processor, processor.points)
    if drift.verdict == DRIFTING and _check(processor, processor.mirrored_points()).verdict == HOLDS:
        return replace(drift, reasons=(MIRRORED, *drift.reasons))
    return drift


def _check(processor: ScanProcessor, stripes: Mapping[int, StripePoints]) -> Drift:
    points = {index: stripe.points[::COLUMNS_APART] for index, stripe in stripes.items()}
    return check_drift(points, processor.pose.covariance, processor.pose.soles_in_footprint)
