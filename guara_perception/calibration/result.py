"""What a calibration run found: the calibration and all the evidence behind it."""

from __future__ import annotations

from dataclasses import dataclass

from guara_perception.arrays import Float, Index
from guara_perception.calibration.board import BoardView
from guara_perception.calibration.bundle import CameraFit
from guara_perception.calibration.calibration import Calibration
from guara_perception.calibration.intrinsics import Intrinsics
from guara_perception.calibration.laser import LaserFit
from guara_perception.calibration.mount import FloorPose
from guara_perception.calibration.plates import LostLine, PlateLine
from guara_perception.calibration.quality import Check
from guara_perception.calibration.session import CalibrationSession
from guara_perception.calibration.surface_map import SurfaceMap


@dataclass(frozen=True, slots=True)
class CalibrationResult:
    """A calibration with its evidence.

    Attributes:
        calibration: ready to be saved; its `quality` holds verdict and reasons.
        session: what it was made from.
        transform_base_to_footprint: (4, 4) of the session's stance.
        views: every board picture, usable or not.
        intrinsics: lens by the boards alone.
        floor: mount by the fiducials alone.
        fit: lens and mount by everything.
        surface: the paper's homography.
        lines: laser lines on the plates.
        lost: stripes on plates that gave no line.
        laser: planes and mirror model.
        checks: the figures behind the verdict.
        coverage: (6, 8) board corners per cell of the picture.
        cross_validation: pixels and differences of the two halves, or None.
        floor_sigma: pixels and standard deviation of the floor point they see [m].
        seconds: time of each stage.
    """

    calibration: Calibration
    session: CalibrationSession
    transform_base_to_footprint: Float
    views: tuple[BoardView, ...]
    intrinsics: Intrinsics
    floor: FloorPose
    fit: CameraFit
    surface: SurfaceMap
    lines: tuple[PlateLine, ...]
    lost: tuple[LostLine, ...]
    laser: LaserFit
    checks: tuple[Check, ...]
    coverage: Index
    cross_validation: tuple[Float, Float] | None
    floor_sigma: tuple[Float, Float]
    seconds: dict[str, float]

    @property
    def verdict(self) -> str:
        """`good`, `usable` or `refused`."""
        return str(self.calibration.quality["verdict"])

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why the verdict is not better."""
        return tuple(self.calibration.quality["reasons"])
