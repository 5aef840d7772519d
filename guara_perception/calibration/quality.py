"""Quality of a calibration: checks with limits, verdict, coverage, projection uncertainty, cross-validation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from guara_perception.arrays import Float, Index
from guara_perception.calibration.board import BoardSpec, BoardView
from guara_perception.calibration.bundle import CameraFit
from guara_perception.calibration.calibration import to_floor
from guara_perception.calibration.intrinsics import calibrate_views
from guara_perception.exceptions import CalibrationRefused

GOOD, USABLE, REFUSED = "good", "usable", "refused"
# Number of cells of the image in which corners are counted, columns x rows.
COVERAGE_CELLS = (8, 6)
# Number of pixels at which the projection is evaluated, columns x rows.
GRID = (9, 7)


@dataclass(frozen=True, slots=True)
class Check:
    """Figure of merit of a calibration, with its limits.

    Attributes:
        name: short name, which is also the name of the figure in the calibration file.
        value: measured value, in `unit`; NaN if it could not be computed.
        unit: unit of `value`, as text.
        usable_from: limit between good and usable.
        refused_from: limit between usable and refused.
        meaning: description of the value.
        advice: remedy if the verdict is not good.
        higher_is_better: True if values below the limits are worse; False if values above the limits are worse.
    """

    name: str
    value: float
    unit: str
    usable_from: float
    refused_from: float
    meaning: str
    advice: str
    higher_is_better: bool = False

    @property
    def verdict(self) -> str:
        """Verdict of this figure alone; `usable` if it could not be computed."""
        if np.isnan(self.value):
            return USABLE
        sign = -1.0 if self.higher_is_better else 1.0
        if sign * self.value > sign * self.refused_from:
            return REFUSED
        return USABLE if sign * self.value > sign * self.usable_from else GOOD

    @property
    def reason(self) -> str:
        """Explanation of a verdict other than good."""
        if np.isnan(self.value):
            return f"{self.name} could not be computed: {self.advice}"
        limit = self.refused_from if self.verdict == REFUSED else self.usable_from
        side = "below" if self.higher_is_better else "above"
        return f"{self.name} is {self.value:.3g} {self.unit}, {side} {limit:.3g}: {self.advice}"


def verdict_of(checks: Sequence[Check], warnings: Sequence[str]) -> tuple[str, tuple[str, ...]]:
    """Verdict on a calibration, by its worst check and its warnings, and the reasons for it.

    Args:
        checks: all figures.
        warnings: faults that do not prevent a calibration, such as an omitted view or a stripe filled in by the mirror
            model; with any warning, the verdict is `usable` at best.
    """
    by_verdict = {verdict: [c.reason for c in checks if c.verdict == verdict] for verdict in (REFUSED, USABLE)}
    reasons = (*by_verdict[REFUSED], *by_verdict[USABLE], *warnings)
    return (REFUSED if by_verdict[REFUSED] else USABLE if reasons else GOOD), reasons


def quality_record(checks: Sequence[Check], verdict: str, reasons: Sequence[str]) -> dict[str, Any]:
    """Convert checks and verdict to the object `quality` of calibration.json, without `handedness`."""
    return {
        "verdict": verdict,
        "reasons": list(reasons),
        "figures": [
            {
                "name": check.name,
                "value": None if np.isnan(check.value) else round(float(check.value), 6),
                "unit": check.unit,
                "usable_from": check.usable_from,
                "refused_from": check.refused_from,
                "verdict": check.verdict,
            }
            for check in checks
        ],
    }


def coverage(views: Sequence[BoardView], size: tuple[int, int]) -> Index:
    """Number of corners in each cell of the image, (6, 8); see COVERAGE_CELLS."""
    u, v = np.concatenate([np.empty((0, 2)), *(view.corners_px for view in views)]).T
    ranges = (0, size[1]), (0, size[0])
    return np.histogram2d(v, u, COVERAGE_CELLS[::-1], ranges)[0].astype(np.intp)


def picture_grid(size: tuple[int, int]) -> Float:
    """Pixels (63, 2) evenly distributed over the image."""
    u, v = np.meshgrid(np.linspace(0, size[0] - 1, GRID[0]), np.linspace(0, size[1] - 1, GRID[1]))
    return np.column_stack((u.ravel(), v.ravel()))


def projection_uncertainty(fit: CameraFit, far: float) -> tuple[Float, Float]:
    """Standard deviation of the floor point seen by a pixel, for pixels all over the image.

    The joint covariance of lens and mount is propagated to the floor.

    Args:
        fit: lens and mount.
        far: far end of the scanned area, x in base_footprint [m].

    Returns:
        Pixels (63, 2), and the standard deviation (63,) of the floor point seen by each pixel [m]: the root of the
        summed variances of x and y; NaN for pixels that see beyond the scanned area or above the horizon.
    """
    pixels = picture_grid(fit.camera.size)
    floor = to_floor(fit.camera, fit.transform_camera_to_footprint, pixels)
    moved = [(to_floor(camera, transform, pixels) - floor) / sigma for sigma, camera, transform in fit.moved()]
    derivative = np.stack(moved, axis=-1)
    covariance = np.einsum("nij,jk,nlk->nil", derivative, fit.covariance, derivative)
    sigma = np.sqrt(np.trace(covariance, axis1=1, axis2=2))
    is_below_horizon = fit.camera.rays(pixels) @ fit.transform_camera_to_footprint[2, :3] < 0
    return pixels, np.where(is_below_horizon & (floor[:, 0] <= far), sigma, np.nan)


def cross_validation(
    views: Sequence[BoardView], board: BoardSpec, size: tuple[int, int], distortion: str, distance: float
) -> tuple[Float, Float] | None:
    """Difference in projection between two lens models, calibrated from the even and from the odd views.

    A rotation and a translation between the two cameras do not count, because the mount would compensate them. They are
    removed by aligning points at floor distance, as in mrcal.

    Args:
        views: usable views.
        board: the board.
        size: image width and height [px].
        distortion: as in `calibrate_intrinsics`.
        distance: height of the camera above the floor [m].

    Returns:
        Pixels (63, 2), and differences (63, 2) at these pixels [px]; None if a half has fewer than three views or
        cannot be calibrated.
    """
    halves = views[0::2], views[1::2]
    if min(len(half) for half in halves) < 3:
        return None
    try:
        first, second = (calibrate_views(half, board, size, distortion).camera for half in halves)
    except (CalibrationRefused, cv2.error):
        return None
    pixels = picture_grid(size)
    points = first.rays(pixels) * distance
    start = np.zeros((3, 1)), np.zeros((3, 1))
    _, rotation, translation = cv2.solvePnP(
        points, pixels, second.matrix, second.distortion, *start, useExtrinsicGuess=True
    )
    seen, _ = cv2.projectPoints(points, rotation, translation, second.matrix, second.distortion)
    return pixels, np.asarray(seen, dtype=np.float64).reshape(-1, 2) - pixels
