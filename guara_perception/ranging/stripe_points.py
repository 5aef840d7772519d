"""The points of one stripe in the robot's frame, those that cannot be trusted set apart with their reason."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from guara_perception.ranging.locate import Locator
from guara_perception.ranging.run_ends import run_ends
from guara_perception.readonly import readonly
from guara_perception.stripes.profile import StripeProfile, StripeStatus

Float = npt.NDArray[np.float64]
Stored = npt.NDArray[Any]
Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class StripePoints:
    """One stripe of an organised scan, one entry per image column; float32, because a scan keeps all its stripes.

    Attributes:
        points: (w, 3) in base_footprint [m], NaN where there is no trusted return within the height gates.
        variance: (w,) variance of the height from the stripe position [m^2], NaN likewise.
        strength: (w,) height of the return above background [grey levels], NaN likewise.
        status: (w,) uint8 StripeStatus.
        out_of_range: (w, 3) points seen below or above the gates, NaN elsewhere.
        doubtful: (w, 3) points of returns that may not be used, NaN elsewhere.
    """

    points: Stored
    variance: Stored
    strength: Stored
    status: npt.NDArray[np.uint8]
    out_of_range: Stored
    doubtful: Stored

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        for field in dataclasses.fields(self):
            array = np.asarray(getattr(self, field.name))
            object.__setattr__(
                self, field.name, readonly(array if field.name == "status" else array.astype(np.float32))
            )


def stripe_points(
    profile: StripeProfile,
    locator: Locator,
    plane_in_camera: Float,
    gates: tuple[float, float],
    on_robot: Callable[[Float], Mask] | None = None,
) -> StripePoints:
    """Locate the points of a profile and sort them.

    Args:
        profile: stripe along the columns of the whole picture.
        locator: makes points of rows.
        plane_in_camera: (4,) calibrated sheet.
        gates: lowest and highest height that counts as terrain [m].
        on_robot: tells which points (n, 3) in base_footprint lie on the robot itself; None = none does.
    """
    points, sigma = locator.measure(plane_in_camera, profile.position_px, profile.sigma_px)
    doubtful = locator.points(plane_in_camera, profile.doubtful_px)
    status = profile.status.copy()
    own = np.zeros(len(points), dtype=bool)
    if on_robot is not None:
        own = on_robot(points)
        doubtful[on_robot(doubtful)] = np.nan
    points[own] = np.nan

    mixed = run_ends(points[:, 2], profile.peak.astype(np.float64))
    doubtful[mixed] = points[mixed]
    with np.errstate(invalid="ignore"):
        outside = (points[:, 2] < gates[0]) | (points[:, 2] > gates[1])
        unusual = (doubtful[:, 2] < gates[0]) | (doubtful[:, 2] > gates[1])
    out_of_range = np.where((outside & ~mixed)[:, None], points, np.nan)
    doubtful[unusual] = np.nan
    status[mixed] = StripeStatus.MIXED_EDGE
    status[outside] = StripeStatus.OUT_OF_BAND
    kept = np.isfinite(points[:, 2]) & ~outside & ~mixed
    return StripePoints(
        points=np.where(kept[:, None], points, np.nan),
        variance=np.where(kept, sigma**2, np.nan),
        strength=np.where(kept, profile.peak, np.nan),
        status=status,
        out_of_range=out_of_range,
        doubtful=doubtful,
    )
