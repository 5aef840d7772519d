"""Two ways from a stripe profile to points in base_footprint: triangulation, and the paper's equations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from guara_perception.calibration.camera import CameraModel
from guara_perception.ranging.paper.rangefinder import Literal, PaperRangefinder
from guara_perception.ranging.triangulate import triangulate

Float = npt.NDArray[np.float64]


class Locator(Protocol):
    """Finds the points of a stripe."""

    @property
    def view_point(self) -> Float:
        """(3,) point in base_footprint about which heights are orthorectified: the optical centre, if all is right."""

    def points(self, plane_in_camera: Float, position_px: npt.ArrayLike) -> Float:
        """Points (w, 3) in base_footprint of a stripe at these rows; NaN where there is none."""

    def measure(
        self, plane_in_camera: Float, position_px: npt.ArrayLike, sigma_px: npt.ArrayLike
    ) -> tuple[Float, Float]:
        """The same points and the standard deviations (w,) of their heights [m]."""


@dataclass(frozen=True, slots=True)
class Triangulator:
    """Each ray meets the calibrated sheet: no step that is not exact.

    Attributes:
        camera: intrinsic model.
        transform_camera_to_footprint: (4, 4).
    """

    camera: CameraModel
    transform_camera_to_footprint: Float

    @property
    def view_point(self) -> Float:
        """Optical centre (3,)."""
        return np.array(self.transform_camera_to_footprint[:3, 3])

    def points(self, plane_in_camera: Float, position_px: npt.ArrayLike) -> Float:
        """Points (w, 3) in base_footprint."""
        return self.measure(plane_in_camera, position_px, np.zeros(np.size(position_px)))[0]

    def measure(
        self, plane_in_camera: Float, position_px: npt.ArrayLike, sigma_px: npt.ArrayLike
    ) -> tuple[Float, Float]:
        """Points (w, 3) and standard deviations (w,) of their heights [m], by the derivative of the meeting point."""
        in_camera, spread = triangulate(self.camera, plane_in_camera, position_px, sigma_px)
        rotation, translation = self.transform_camera_to_footprint[:3, :3], self.transform_camera_to_footprint[:3, 3]
        return in_camera @ rotation.T + translation, np.abs(spread @ rotation[2])


def locator(
    literal: Literal | None,
    camera: CameraModel,
    transform_camera_to_footprint: Float,
    area: tuple[tuple[float, float], tuple[float, float]],
) -> Locator:
    """The paper's equations with what they take as printed, or triangulation when there is nothing of the paper."""
    if literal is None:
        return Triangulator(camera, transform_camera_to_footprint)
    return PaperRangefinder(camera, transform_camera_to_footprint, area, literal)
