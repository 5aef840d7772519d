"""The drift check of one processed scan."""

from __future__ import annotations

from guara_perception.calibration.drift import Drift, check_drift
from guara_perception.scan_processor import ScanProcessor

# Neighbouring columns are smoothed over one another: every fourth says as much of the floor, in half of the time.
COLUMNS_APART = 4


def scan_drift(processor: ScanProcessor) -> Drift:
    """Whether what a scan shows of the floor fits its calibration and the soles that it stands on."""
    points = {index: stripe.points[::COLUMNS_APART] for index, stripe in processor.points.items()}
    return check_drift(points, processor.pose.covariance, processor.pose.soles_in_footprint)
