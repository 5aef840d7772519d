"""Calibration of the laser: planes fitted to lines on plates, leave-one-plate-out errors, uncertainty of heights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from guara_perception.arrays import Float, Index, Interval
from guara_perception.calibration.bundle import CameraFit
from guara_perception.calibration.calibration import CameraModel, floor_pixels, plane_in_frame
from guara_perception.calibration.calibration_input import Plate
from guara_perception.calibration.height_sigma import HeightUncertainty, field_covariance
from guara_perception.calibration.mirror_model import MirrorModel
from guara_perception.calibration.plates import PlateLine
from guara_perception.calibration.stripe_planes import StripeFit, fit_stripes
from guara_perception.calibration.sweep import Sweep, fit_sweep, line_points
from kinematics.arrays import FrozenArrays
from kinematics.transforms import inverse, transform_points

# Points at which the field of height errors is sampled: values of y, heights, and number of stripes.
FIELD_Y_M = np.linspace(-0.27, 0.27, 7)
FIELD_HEIGHTS_M = (-0.02, 0.04, 0.10)
FIELD_STRIPES = 18


@dataclass(frozen=True, slots=True)
class LeaveOneOut:
    """Height error of a plate, measured with laser planes fitted to the other plates.

    Attributes:
        plate: number of the plate.
        mean: measured minus given height, mean over the plate's lines [m].
        scatter: standard deviation of this difference over the plate's lines [m].
        near, far: mean difference over the nearest and the farthest third of the lines [m].
        irregularity: standard deviation of the mirror's step errors in the fit [rad]; small if the other plates agree.
        disagreement: rms height error of the other plates in the fit [m]; nearly zero for two other plates, which
            always agree.
    """

    plate: int
    mean: float
    scatter: float
    near: float
    far: float
    irregularity: float
    disagreement: float

    @property
    def rms(self) -> float:
        """Root mean square height error [m]."""
        return float(np.hypot(self.mean, self.scatter))


@dataclass(frozen=True, slots=True)
class LaserFit(FrozenArrays):
    """Mirror model and laser planes fitted to lines on plates.

    Attributes:
        sweep: mirror model in base_footprint.
        stripes: plane of each stripe in base_footprint.
        planes_in_camera: (s, 4) the same planes in the camera frame.
        line_errors: (lines,) mean height error of each line, measured with the plane of its stripe [m].
        leave_one_out: one entry per plate; empty for fewer than three plates.
        uncertainty: uncertainty of heights measured with these planes.
    """

    sweep: Sweep
    stripes: StripeFit
    planes_in_camera: Float
    line_errors: Float
    leave_one_out: tuple[LeaveOneOut, ...]
    uncertainty: HeightUncertainty


def fit_laser(
    lines: Sequence[PlateLine],
    plates: Sequence[Plate],
    fit: CameraFit,
    nominal: MirrorModel,
    transform_footprint_to_base: Float,
) -> LaserFit:
    """Fit mirror model and laser planes to lines on plates, and compute the uncertainty of heights.

    Args:
        lines: lines of all stripes on all plates, already checked for missed steps and swapped heights.
        plates: plates of the session.
        fit: camera and mount.
        nominal: nominal mirror in base_footprint.
        transform_footprint_to_base: (4, 4) transform at the session's stance.
    """
    points = [line_points(fit.camera, fit.transform_camera_to_footprint, line) for line in lines]
    sweep = fit_sweep(lines, points, nominal)
    stripes = fit_stripes(lines, points, sweep, nominal)
    moved = plane_in_frame(stripes.planes, inverse(fit.transform_camera_to_footprint))
    return LaserFit(
        sweep=sweep,
        stripes=stripes,
        planes_in_camera=moved / np.linalg.norm(moved[:, :3], axis=1, keepdims=True),
        line_errors=_line_heights(lines, points, stripes, fit.transform_camera_to_footprint),
        leave_one_out=_leave_one_out(lines, points, len(plates), nominal, fit.transform_camera_to_footprint),
        uncertainty=_uncertainty(lines, fit, sweep, stripes, nominal, transform_footprint_to_base),
    )


def heights_through(pixels: Float, camera: CameraModel, transform_camera_to_footprint: Float, plane: Float) -> Float:
    """Heights (n,) above z = 0 at which the rays of pixels (n, 2) meet a plane (4,) in base_footprint."""
    rotation, camera_position = transform_camera_to_footprint[:3, :3], transform_camera_to_footprint[:3, 3]
    rays = camera.rays(pixels) @ rotation.T
    depth = -(plane[:3] @ camera_position + plane[3]) / (rays @ plane[:3])
    return np.asarray(camera_position[2] + depth * rays[:, 2])


def height_sigmas(
    fit: CameraFit, laser: LaserFit, lines: Sequence[PlateLine], transform_base_to_footprint: Float, x: Interval
) -> tuple[float, float]:
    """Predicted sigma of a single height on the floor at the near and the far edge of the area [m].

    Args:
        fit: camera and mount.
        laser: mirror model and laser planes.
        lines: lines on plates; the median of their `sigma_px` is assumed for a scan.
        transform_base_to_footprint: (4, 4) pose of the body.
        x: x range of the area in base_footprint [m].
    """
    on_floor = -laser.stripes.planes[:, 3] / laser.stripes.planes[:, 0]
    nearest = np.array([np.argmin(np.abs(on_floor - edge)) for edge in x])
    points = np.column_stack((on_floor[nearest], np.zeros(len(nearest))))
    to_base = inverse(transform_base_to_footprint) @ fit.transform_camera_to_footprint
    near, far = floor_sigmas(fit, laser, lines, to_base, points, nearest)[0].tolist()
    return near, far


def floor_sigmas(
    fit: CameraFit,
    laser: LaserFit,
    lines: Sequence[PlateLine],
    transform_camera_to_base: Float,
    points: Float,
    stripes: Index,
) -> tuple[Float, Float]:
    """Predicted sigmas (n,) of single heights on the floor [m]: in total, and due to the calibration alone.

    Args:
        fit: camera and mount.
        laser: mirror model and laser planes.
        lines: lines on plates; the median of their `sigma_px` is assumed for a scan.
        transform_camera_to_base: (4, 4) mount of the camera.
        points: (n, 2) x and y on the floor, in base_footprint [m].
        stripes: (n,) row in `laser.stripes` of the stripe that measures each point.
    """
    transform = fit.transform_camera_to_footprint
    pixels, height_by_row = floor_pixels(fit.camera, transform, points), np.empty(len(points))
    for k in np.unique(stripes):
        of_stripe, plane = stripes == k, laser.stripes.planes[k]
        below = heights_through(pixels[of_stripe] + (0.0, 1.0), fit.camera, transform, plane)
        height_by_row[of_stripe] = below - heights_through(pixels[of_stripe], fit.camera, transform, plane)
    row_sigma = float(np.median([line.sigma_px for line in lines]))
    on_floor = np.vstack((points.T, np.zeros(len(points))))
    poses = transform, transform_camera_to_base
    systematic = laser.uncertainty.variance(
        laser.stripes.indices, laser.planes_in_camera, on_floor, *poses, rows=stripes
    )
    return np.sqrt((height_by_row * row_sigma) ** 2 + systematic), np.sqrt(systematic)


def _line_heights(lines: Sequence[PlateLine], points: Sequence[Float], stripes: StripeFit, transform: Float) -> Float:
    """Mean height error (lines,) of each line, measured with the plane of its stripe [m]."""
    row = {index: k for k, index in enumerate(stripes.indices)}
    errors = np.empty(len(lines))
    for i, (line, point) in enumerate(zip(lines, points, strict=True)):
        plane = stripes.planes[row[line.index]]
        ray = point - transform[:3, 3]
        lift = -(point @ plane[:3] + plane[3]) / (ray @ plane[:3]) * ray[:, 2]
        errors[i] = np.average(lift, weights=line.weights)
    return errors


def _leave_one_out(
    lines: Sequence[PlateLine], points: Sequence[Float], plates: int, nominal: MirrorModel, transform: Float
) -> tuple[LeaveOneOut, ...]:
    if plates < 3:
        return ()
    results = []
    for plate in range(plates):
        kept = [i for i, line in enumerate(lines) if line.plate != plate]
        rest, rest_points = [lines[i] for i in kept], [points[i] for i in kept]
        sweep = fit_sweep(rest, rest_points, nominal)
        stripes = fit_stripes(rest, rest_points, sweep, nominal)
        known = set(stripes.indices)
        own = [i for i, line in enumerate(lines) if line.plate == plate and line.index in known]
        own.sort(key=lambda i: lines[i].index)
        errors = _line_heights([lines[i] for i in own], [points[i] for i in own], stripes, transform)
        others = [i for i in range(len(rest)) if rest[i].index in known]
        rest_errors = _line_heights([rest[i] for i in others], [rest_points[i] for i in others], stripes, transform)
        third = max(len(errors) // 3, 1)
        near, far = errors[:third].mean(), errors[-third:].mean()
        disagreement = np.sqrt(np.mean(rest_errors**2))
        values = (errors.mean(), errors.std(), near, far, np.std(sweep.step_errors), disagreement)
        results.append(LeaveOneOut(plate, *map(float, values)))
    return tuple(results)


def _uncertainty(
    lines: Sequence[PlateLine], fit: CameraFit, sweep: Sweep, stripes: StripeFit, nominal: MirrorModel, to_base: Float
) -> HeightUncertainty:
    """Height uncertainty from the plane covariances and from refits of the laser with changed camera parameters."""
    bases = plane_in_frame(stripes.bases, inverse(fit.transform_camera_to_footprint))
    covariances = bases.transpose(0, 2, 1) @ stripes.covariance @ bases

    samples = np.unique(np.linspace(0, len(stripes.indices) - 1, FIELD_STRIPES).astype(int))
    points, pixels, rows = [], [], []
    for k in samples:
        plane = stripes.planes[k]
        for height in FIELD_HEIGHTS_M:
            x = -(plane[1] * FIELD_Y_M + plane[2] * height + plane[3]) / plane[0]
            xy = np.column_stack((x, FIELD_Y_M))
            pixels.append(floor_pixels(fit.camera, fit.transform_camera_to_footprint, xy, height))
            points.append(np.column_stack((xy, np.full(len(xy), height))))
            rows.append(np.full(len(xy), k))
    point, pixel, row = np.concatenate(points), np.concatenate(pixels), np.concatenate(rows)
    seen = np.isfinite(pixel).all(axis=1)
    point, pixel, row = point[seen], pixel[seen], row[seen]

    errors = []
    for sigma, camera, transform in fit.moved():
        moved = [line_points(camera, transform, line) for line in lines]
        refitted = fit_stripes(lines, moved, fit_sweep(lines, moved, nominal, sweep), nominal, noise_of=stripes)
        heights = np.empty(len(point))
        for k in samples:
            of_stripe = row == k
            heights[of_stripe] = heights_through(pixel[of_stripe], camera, transform, refitted.planes[k])
        errors.append((heights - point[:, 2]) / sigma)
    in_base = transform_points(to_base, point)
    origin = in_base.mean(axis=0)
    planes = dict(zip(stripes.indices, covariances, strict=True))
    return HeightUncertainty(planes, origin, field_covariance(in_base - origin, errors, fit.covariance))
