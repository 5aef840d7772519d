"""Uncertainty of heights due to the calibration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from guara_perception.arrays import Float, Index
from guara_perception.calibration.calibration import Calibration
from guara_perception.exceptions import FileFormatError
from guara_perception.fields import Fields
from guara_perception.stripes.kernel.library import address, addresses, kernel
from kinematics.arrays import read_only

# Terms of the polynomial field of height errors; x, y and z are relative to the field's origin.
FIELD_TERMS = ("1", "x", "y", "z", "xx", "yy", "zz", "xy", "xz", "yz")
# Least distance of the camera from a laser plane; a closer camera sees the plane edge-on and gives unusable heights.
MIN_BASELINE_M = 1e-3


@dataclass(frozen=True, slots=True)
class HeightUncertainty:
    """Height uncertainty due to the calibration, without errors of the stripe's position in the image.

    The variance of a height is the sum of two variances: that due to the stripe's laser plane, including the
    repeatability of the mirror, and that of a smooth field of height errors due to lens and mount of the camera.

    Attributes:
        planes: stripe index -> (4, 4) covariance of its plane (nx, ny, nz, d) in the camera frame.
        field_origin: (3,) origin of the field in base_link [m].
        field: (10, 10) covariance of the coefficients of FIELD_TERMS, which have the units m, 1 and 1/m.
    """

    planes: Mapping[int, Float]
    field_origin: Float
    field: Float

    def __post_init__(self) -> None:
        object.__setattr__(self, "planes", {index: read_only(plane) for index, plane in self.planes.items()})
        object.__setattr__(self, "field_origin", read_only(self.field_origin))
        object.__setattr__(self, "field", read_only(self.field))

    @staticmethod
    def of(calibration: Calibration) -> HeightUncertainty | None:
        """Read the uncertainty from a calibration.

        Returns:
            The uncertainty; None without a stored covariance, for example in a nominal calibration.

        Raises:
            FileFormatError: the stored covariance does not follow docs/calibration.md.
        """
        if not calibration.covariance:
            return None
        stored = Fields(calibration.covariance, "calibration", "covariance")
        planes = {item.integer("index"): item.array("plane", (4, 4)) for item in stored.items("stripes")}
        if not planes:
            raise FileFormatError(f"{stored.path_to('stripes')} is empty; allowed: the plane of each calibrated stripe")
        field = stored.sub("height_field")
        if tuple(field.sequence("terms")) != FIELD_TERMS:
            raise FileFormatError(f"{field.path_to('terms')} must be {', '.join(FIELD_TERMS)}")
        return HeightUncertainty(planes, field.array("origin_in_base", (3,)), field.array("matrix", (10, 10)))

    def variance(
        self,
        indices: Sequence[int],
        planes: Float,
        points_in_footprint: Float,
        transform_camera_to_footprint: Float,
        transform_camera_to_base: Float,
        rows: Index | None = None,
    ) -> Float:
        """Variances of the heights of points on stripes [m^2], with the shape of `rows`.

        NaN where a point is NaN or the camera is closer than MIN_BASELINE_M to the laser plane.

        Args:
            indices: indices of s stripes; a stripe without a covariance uses that of the nearest stripe.
            planes: (s, 4) calibrated planes in the camera frame.
            points_in_footprint: (3, ...) coordinates x, y, z of the points [m].
            transform_camera_to_footprint: (4, 4) pose of the camera over the ground.
            transform_camera_to_base: (4, 4) mount of the camera.
            rows: (...) row of each point's stripe in `indices`; None = the points are (3, s, n), n on each stripe.
        """
        points = np.ascontiguousarray(points_in_footprint, np.float64)
        if rows is None:
            rows = np.broadcast_to(np.arange(len(indices))[:, None], points.shape[1:])
        stripes = np.ascontiguousarray(rows, np.int64)
        variance = np.empty(stripes.shape)
        poses = transform_camera_to_footprint, transform_camera_to_base
        given = planes, self.plane_covariances(indices), *poses, self.field_origin, self.field
        arrays = [np.ascontiguousarray(each, np.float64) for each in given]
        at = addresses(points, stripes)
        kernel().height_variance(*at, stripes.size, *addresses(*arrays), MIN_BASELINE_M, address(variance))
        return variance

    def plane_covariances(self, indices: Sequence[int]) -> Float:
        """Covariances (s, 4, 4) of the planes of stripes, each from the nearest index that has a covariance."""
        known = np.array(list(self.planes))
        nearest = np.abs(known - np.asarray(indices)[:, None]).argmin(axis=1)
        return np.array(list(self.planes.values()))[nearest]

    def to_dict(self) -> dict[str, Any]:
        """Convert the uncertainty to JSON values, which `of` reads."""
        return {
            "stripes": [{"index": index, "plane": plane.tolist()} for index, plane in sorted(self.planes.items())],
            "height_field": {
                "terms": list(FIELD_TERMS),
                "origin_in_base": self.field_origin.tolist(),
                "matrix": self.field.tolist(),
            },
        }


def field_terms(offsets: Float) -> Float:
    """Values (..., 10, n) of FIELD_TERMS at offsets (..., 3, n) from the field's origin."""
    x, y, z = (offsets[..., axis, :] for axis in range(3))
    return np.stack((np.ones_like(x), x, y, z, x * x, y * y, z * z, x * y, x * z, y * z), axis=-2)


def field_covariance(offsets: Float, errors: Sequence[Float], parameters: Float) -> Float:
    """Covariance (10, 10) of the coefficients of the field of height errors, from that of lens and mount.

    Args:
        offsets: (n, 3) points relative to the field's origin [m].
        errors: p arrays (n,), the derivatives of the heights with respect to each parameter.
        parameters: (p, p) covariance of these parameters.
    """
    effect = np.linalg.lstsq(field_terms(offsets.T).T, np.column_stack(errors), rcond=None)[0]
    return np.asarray(effect @ parameters @ effect.T)
