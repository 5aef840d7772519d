"""How far a calibration may put a height wrong: stored as JSON, evaluated for every point of a scan."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from guara_perception.calibration.calibration import Calibration
from guara_perception.exceptions import FileFormatError
from guara_perception.readonly import readonly

Float = npt.NDArray[np.float64]

# The height field is a quadratic about this point of base_link: middle of the area, 40 mm over the floor.
FIELD_TERMS = ("1", "x", "y", "z", "xx", "yy", "zz", "xy", "xz", "yz")
# A ray that meets the sheet at a smaller sine has no height worth the name.
MIN_SINE = 1e-3


@dataclass(frozen=True, slots=True)
class HeightUncertainty:
    """Variance of heights that comes from the calibration, not from the stripe's place in the picture.

    Two parts: the plane of each stripe (own covariance, with the mirror's repeatability), and a smooth field of
    height over the area that lens and mount may have wrong together.

    Attributes:
        planes: (4, 4) covariance of the plane (nx, ny, nz, d) in the camera frame, by stripe index.
        field_origin: (3,) point of base_link the field is written about [m].
        field: (10, 10) covariance of the coefficients of FIELD_TERMS [m, 1, 1/m].
    """

    planes: Mapping[int, Float]
    field_origin: Float
    field: Float

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        object.__setattr__(self, "planes", {index: readonly(plane) for index, plane in self.planes.items()})
        object.__setattr__(self, "field_origin", readonly(self.field_origin))
        object.__setattr__(self, "field", readonly(self.field))

    @staticmethod
    def of(calibration: Calibration) -> HeightUncertainty | None:
        """The uncertainty stored in a calibration; None where it holds none (one made from a drawing).

        Raises:
            FileFormatError: the covariance is there and is not what docs/calibration.md says.
        """
        stored = calibration.covariance
        if not stored:
            return None
        try:
            planes = {
                int(item["index"]): _matrix(item["plane"], (4, 4), f"stripes[{i}].plane")
                for i, item in enumerate(stored["stripes"])
            }
            field = stored["height_field"]
            if tuple(field["terms"]) != FIELD_TERMS:
                raise FileFormatError(f"covariance.height_field.terms must be {', '.join(FIELD_TERMS)}")
            origin = _matrix(field["origin_in_base"], (3,), "height_field.origin_in_base")
            matrix = _matrix(field["matrix"], (10, 10), "height_field.matrix")
        except (KeyError, TypeError, ValueError) as error:
            if isinstance(error, FileFormatError):
                raise
            raise FileFormatError(f"covariance of the calibration is not as documented: {error!r}") from None
        return HeightUncertainty(planes, origin, matrix)

    def variance(
        self, index: int, plane: Float, points_in_camera: Float, transform_camera_to_base: Float, up_in_camera: Float
    ) -> Float:
        """Variance (n,) of the heights of points on one stripe [m^2]; NaN where a point is NaN.

        Args:
            index: of the stripe; one that has no covariance of its own gets that of its nearest neighbour.
            plane: (4,) calibrated plane in the camera frame.
            points_in_camera: (n, 3).
            transform_camera_to_base: (4, 4).
            up_in_camera: (3,) unit vector along which heights are measured.
        """
        nearest = min(self.planes, key=lambda other: abs(other - index))
        # Coordinates in rows, each in one piece of memory: several times faster than points in rows.
        in_camera = np.ascontiguousarray(points_in_camera.T)
        off_plane = _quadratic_form(np.vstack((in_camera, np.ones(in_camera.shape[1]))), self.planes[nearest])
        sine = plane[:3] @ in_camera
        with np.errstate(divide="ignore", invalid="ignore"):
            gain = (up_in_camera @ in_camera) / np.where(np.abs(sine) < MIN_SINE, np.nan, sine)
        offsets = transform_camera_to_base[:3, :3] @ in_camera
        offsets += (transform_camera_to_base[:3, 3] - self.field_origin)[:, None]
        return np.asarray(gain**2 * off_plane + _quadratic_form(field_terms(offsets.T).T, self.field))

    def variance_of_scan(
        self,
        index: int,
        plane: Float,
        points_in_footprint: Float,
        transform_camera_to_footprint: Float,
        transform_camera_to_base: Float,
    ) -> Float:
        """As `variance`, of points (n, 3) in base_footprint with heights along its z."""
        rotation, translation = transform_camera_to_footprint[:3, :3], transform_camera_to_footprint[:3, 3]
        in_camera = (points_in_footprint - translation) @ rotation
        return self.variance(index, plane, in_camera, transform_camera_to_base, rotation[2])

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON values, as `of` reads them."""
        return {
            "stripes": [{"index": index, "plane": plane.tolist()} for index, plane in sorted(self.planes.items())],
            "height_field": {
                "terms": list(FIELD_TERMS),
                "origin_in_base": self.field_origin.tolist(),
                "matrix": self.field.tolist(),
            },
        }


def field_terms(offsets: Float) -> Float:
    """(n, 10) values of FIELD_TERMS at offsets (n, 3) from the field's origin."""
    x, y, z = offsets.T
    return np.stack((np.ones(len(x)), x, y, z, x * x, y * y, z * z, x * y, x * z, y * z)).T


def plane_covariance(bases: Float, covariance: Float) -> Float:
    """(4, 4) covariance of a plane from that of its turn, tilt and shift (3, 3) with their effects (3, 4)."""
    return np.asarray(bases.T @ covariance @ bases)


def field_covariance(offsets: Float, errors: Sequence[Float], parameters: Float) -> Float:
    """Covariance of the height field from what one unit of each parameter does to the heights.

    Args:
        offsets: (n, 3) points about the field's origin.
        errors: per parameter (n,) change of height per unit.
        parameters: (p, p) covariance of the parameters.
    """
    terms = field_terms(offsets)
    effect = np.linalg.lstsq(terms, np.column_stack(errors), rcond=None)[0]
    return np.asarray(effect @ parameters @ effect.T)


def _quadratic_form(vectors: Float, matrix: Float) -> Float:
    """Values v . M v (n,) of vectors (k, n)."""
    return np.einsum("kn,kn->n", vectors, matrix @ vectors)


def _matrix(value: Any, shape: tuple[int, ...], name: str) -> Float:
    matrix = np.array(value, dtype=np.float64)
    if matrix.shape != shape or not np.isfinite(matrix).all():
        raise FileFormatError(f"covariance.{name} has shape {matrix.shape}, it must be {shape} and finite")
    return matrix
