"""Result of a calibration run: the calibration with its evidence, and the records of its file."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from guara_perception.arrays import Float, Index, Interval
from guara_perception.calibration.board import BoardView
from guara_perception.calibration.bundle import CameraFit
from guara_perception.calibration.calibration import Calibration, CameraModel, StripePlane, format_indices, to_floor
from guara_perception.calibration.calibration_input import CalibrationSession
from guara_perception.calibration.intrinsics import Intrinsics
from guara_perception.calibration.laser import LaserFit
from guara_perception.calibration.mirror_model import MirrorModel
from guara_perception.calibration.mount import FloorPose
from guara_perception.calibration.plates import LostLine, PlateLine
from guara_perception.calibration.quality import Check
from guara_perception.calibration.surface_map import SurfaceMap, stripe_constants
from guara_perception.exceptions import InvalidInput


@dataclass(frozen=True, slots=True)
class CalibrationResult:
    """Calibration with the evidence for its verdict.

    Attributes:
        calibration: calibration ready to be saved; its `quality` contains verdict and reasons.
        session: session from which it was computed.
        transform_base_to_footprint: (4, 4) pose of the body at the session's stance.
        intrinsics: lens from the boards alone, or the given lens.
        floor: pose of the camera over the floor, from the fiducials alone.
        fit: lens and mount from boards and fiducials.
        surface: the paper's homography.
        lines: laser lines on the plates.
        lost: stripes in plate scans without a usable laser line.
        laser: laser planes and mirror model.
        checks: figures of merit; together with the warnings, they determine the verdict.
        coverage: (6, 8) number of board corners in each cell of the image.
        cross_validation: pixels (n, 2), and differences (n, 2) at these pixels between the lenses calibrated from the
            two halves of the views [px]; None if not computed.
        floor_sigma: pixels (n, 2), and standard deviations (n,) of the floor points seen by these pixels [m], NaN for
            pixels that see beyond the scanned area.
        area: x and y range of the scanned area, in base_footprint [m].
    """

    calibration: Calibration
    session: CalibrationSession
    transform_base_to_footprint: Float
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
    area: tuple[Interval, Interval]

    @property
    def verdict(self) -> str:
        """`good`, `usable` or `refused`."""
        return str(self.calibration.quality["verdict"])

    @property
    def reasons(self) -> tuple[str, ...]:
        """Reasons for a verdict other than `good`."""
        return tuple(self.calibration.quality["reasons"])


def stripe_records(
    laser: LaserFit, session: CalibrationSession, missing: Sequence[int], mirror_in_camera: MirrorModel
) -> tuple[StripePlane, ...]:
    """Plane of each stripe; a stripe without a line on any plate gets the plane of the mirror model."""
    found = zip(laser.stripes.indices, laser.stripes.mirror_angles, laser.planes_in_camera, strict=True)
    stripes = [StripePlane(index, float(angle), plane) for index, angle, plane in found]
    if missing:
        commanded = {s.index: s.mirror_angle for plate in session.plates for s in plate.scan.stripes}
        planes = mirror_in_camera.planes([commanded[index] for index in missing])
        stripes += [StripePlane(i, commanded[i], plane) for i, plane in zip(missing, planes, strict=True)]
    return tuple(stripes)


def mirror_record(
    laser: LaserFit, mirror_in_camera: MirrorModel, mount: FloorPose, missing: Sequence[int]
) -> dict[str, Any]:
    """Object `mirror` of calibration.json; docs/calibration.md describes its fields."""
    return {
        "frame": "camera_optical_frame",
        "mount": mount.mount,
        **mirror_in_camera.to_dict(),
        "step_errors": [
            {"index": index, "error": float(error)}
            for index, error in zip(laser.sweep.indices, laser.sweep.step_errors, strict=True)
        ],
        "sheet_jitter": laser.stripes.jitter,
        "filled_in": list(missing),
    }


def covariance_record(fit: CameraFit, laser: LaserFit) -> dict[str, Any]:
    """Object `covariance` of calibration.json; docs/calibration.md describes its fields."""
    return {
        "parameters": [*fit.free, "rx", "ry", "rz", "tx", "ty", "tz"],
        "values": [*fit.lens.tolist(), *fit.pose.tolist()],
        "matrix": fit.covariance.tolist(),
        "corner_sigma_px": fit.corner_sigma_px,
        **laser.uncertainty.to_dict(),
    }


def paper_record(surface: SurfaceMap, fit: CameraFit, lines: Sequence[PlateLine]) -> dict[str, Any]:
    """Object `paper` of calibration.json; docs/calibration.md describes its fields.

    Only stripes that were found on plates of two or more heights, at different positions, have constants n, d and k
    (eqs. 17 to 19).
    """
    camera_position = fit.transform_camera_to_footprint[:3, 3]
    seen: dict[int, list[tuple[float, float]]] = {}
    for line in lines:
        floor = to_floor(fit.camera, fit.transform_camera_to_footprint, line.pixels)
        slope, offset = np.polyfit(floor[:, 1], floor[:, 0], 1)
        seen.setdefault(line.index, []).append((line.height, float(offset + slope * camera_position[1])))
    stripes = []
    for index, pairs in sorted(seen.items()):
        heights, x = zip(*pairs, strict=True)
        with suppress(InvalidInput):
            stripes.append(stripe_constants(index, float(camera_position[2]), x, heights))
    return {
        "homography": surface.homography.tolist(),
        "condition": surface.condition,
        "residual": surface.rms,
        "height": float(camera_position[2]),
        "nadir": [float(camera_position[0]), float(camera_position[1])],
        "stripes": stripes,
    }


def undistorted(camera: CameraModel, pixels: Float) -> Float:
    """Remove the lens distortion from pixels (n, 2)."""
    return np.asarray((camera.rays(pixels) @ camera.matrix.T)[:, :2])


def warnings(
    session: CalibrationSession,
    views: Sequence[BoardView],
    intrinsics: Intrinsics,
    lost: Sequence[LostLine],
    missing: Sequence[int],
) -> list[str]:
    """Warnings about omitted views, a given lens, missing laser lines, and planes taken from the mirror model."""
    found = [f"view {view.name} was left out: {view.reason}" for view in views if not view.is_usable]
    found += [f"view {name} was left out: {reason}" for name, reason in intrinsics.outliers]
    if intrinsics.is_given:
        found.append("the lens was given without its uncertainty; that of a lens estimated from 14 pictures is assumed")
    faults = [one for one in lost if not one.is_beside]
    found += [f"stripe index {one.index} on plate {session.plates[one.plate].name}: {one.reason}" for one in faults]
    if missing:
        found.append(f"stripe index {format_indices(tuple(missing))}: filled in by the mirror model")
    return found
