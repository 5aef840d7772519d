"""Predicted geometry of a scan (image rows and laser plane of each stripe), and conversion of stripes to points."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from guara_perception.arrays import Float, Mask
from guara_perception.calibration.calibration import Calibration, plane_in_frame
from guara_perception.calibration.row_bands import row_bands
from guara_perception.ranging.locate import Locator, Triangulator
from guara_perception.ranging.stripe_points import StripePoints, stripe_points
from guara_perception.settings import Settings
from guara_perception.stripes.band import StripeProfile
from kinematics.self_filter import SelfFilter

# Bands extend this far beyond the height limits, so that a stripe just outside the limits is still detected.
LIMIT_MARGIN_M = 0.025
# Rows added at both edges of a band, for smoothing and for the window around the centre of the stripe.
ROW_MARGIN_PX = 8
# Number of stripes processed together; the arrays of more stripes would exceed the processor's cache.
TOGETHER = 10
Item = TypeVar("Item")


@dataclass(frozen=True, slots=True)
class StripeGeometry:
    """One stripe of the pattern.

    Attributes:
        plane_in_camera: (4,) laser plane n . X + d = 0 in the camera frame.
        band: image rows (first, end) between which the stripe can appear; (0, 0) if it is out of view.
    """

    plane_in_camera: Float
    band: tuple[int, int]


@dataclass(frozen=True, slots=True, eq=False)
class StripePlace:
    """Pose of the camera and the body at the flash of one stripe.

    Attributes:
        transform_camera_to_footprint: (4, 4) pose of the camera.
        body: body of the robot, in base_footprint.
        covariance: (6, 6) covariance of the camera's motion since the stance of the scan, in REP-103 order along the
            axes of base_footprint: translation of the optical centre [m], rotation [rad].
    """

    transform_camera_to_footprint: Float
    body: SelfFilter
    covariance: Float

    def height_variance(self, points: Float) -> Float:
        """Variances (...) of the heights of points (3, ...) in base_footprint [m^2]."""
        return variance_by_motion(points, self.transform_camera_to_footprint[:3, 3], self.covariance[2:5, 2:5])


@dataclass(frozen=True, slots=True)
class ScanGeometry:
    """All stripes of a scan as seen from one stance.

    Attributes:
        calibration: calibration of the rangefinder.
        transform_camera_to_footprint: (4, 4) pose of the camera.
        stripes: calibrated stripes of the pattern by index, in the order of the pattern.
        planes_in_footprint: (s, 4) laser planes of these stripes in base_footprint, in the same order.
        sensor_origins: positions (3,) of the camera and of the laser in base_footprint [m]. That of the laser is the
            point of the mirror axis nearest to the camera.
    """

    calibration: Calibration
    transform_camera_to_footprint: Float
    stripes: dict[int, StripeGeometry]
    planes_in_footprint: Float
    sensor_origins: tuple[Float, Float]

    def pixels(self, points_in_footprint: Float) -> Float:
        """Image positions (n, 2) of points (n, 3) in base_footprint [px]."""
        transform = self.transform_camera_to_footprint
        return self.calibration.camera.project((points_in_footprint - transform[:3, 3]) @ transform[:3, :3])

    def moved(self, places: Mapping[int, StripePlace]) -> ScanGeometry:
        """Copy for a moving camera.

        Each laser plane is placed by the camera pose at the flash of its stripe, camera and laser by the pose at the
        flash of the middle stripe. A stripe without a pose keeps the plane of this geometry.
        """
        poses = {index: place.transform_camera_to_footprint for index, place in places.items()}
        planes = [
            plane_in_frame(stripe.plane_in_camera[None], poses.get(index, self.transform_camera_to_footprint))
            for index, stripe in self.stripes.items()
        ]
        middle = sorted(places)[len(places) // 2]
        transform = poses[middle]
        return replace(
            self,
            transform_camera_to_footprint=transform,
            planes_in_footprint=np.concatenate(planes),
            sensor_origins=_sensor_origins(self.calibration, transform),
        )


def scan_geometry(
    calibration: Calibration, transform_base_to_footprint: Float, settings: Settings, mode: str
) -> ScanGeometry:
    """Predict the geometry of a scan from the calibration and the pose of the body.

    Args:
        calibration: calibration of the rangefinder.
        transform_base_to_footprint: (4, 4) pose of the body.
        settings: settings of the robot.
        mode: "coarse" or "standard".
    """
    transform = transform_base_to_footprint @ calibration.transform_camera_to_base
    pattern = set(settings.pattern(mode))
    planned = [stripe for stripe in calibration.stripes if stripe.index in pattern]
    planes = np.array([stripe.plane for stripe in planned]).reshape(-1, 4)
    height_limits = np.array([settings.minimum_height - LIMIT_MARGIN_M, settings.maximum_height + LIMIT_MARGIN_M])
    bands = row_bands(calibration.camera, transform, planes, height_limits, ROW_MARGIN_PX)
    stripes = {each.index: StripeGeometry(each.plane, band) for each, band in zip(planned, bands, strict=True)}
    origins = _sensor_origins(calibration, transform)
    return ScanGeometry(calibration, transform, stripes, plane_in_frame(planes, transform), origins)


def _sensor_origins(calibration: Calibration, transform: Float) -> tuple[Float, Float]:
    """Positions (3,) of camera and laser for a pose (4, 4) of the camera, from the planes of all calibrated stripes."""
    planes = plane_in_frame(np.array([stripe.plane for stripe in calibration.stripes]), transform)
    return transform[:3, 3], laser_origin(planes, transform[:3, 3])


def laser_origin(planes: Float, near: Float) -> Float:
    """Point (3,) of the mirror axis nearest to `near`, in the frame of the planes.

    All laser planes pass nearly through this axis, which is their line of intersection in the least-squares sense.

    Args:
        planes: (s, 4) planes of all stripes in one frame.
        near: (3,) point in the same frame, for instance the optical centre.
    """
    normals, offsets = planes[:, :3], planes[:, 3]
    axis = np.linalg.svd(normals)[2][-1]
    rows = np.vstack((normals, axis))
    return np.linalg.lstsq(rows, np.append(-offsets, axis @ near), rcond=None)[0]


class StripeRanger:
    """Converter of the stripe profiles of a scan to points."""

    def __init__(
        self,
        geometry: ScanGeometry,
        locator: Locator,
        height_limits: tuple[float, float],
        on_robot: Callable[[Float], Mask],
    ) -> None:
        """Store what all stripes have in common.

        Args:
            geometry: geometry of the scan.
            locator: converts image rows to points.
            height_limits: lowest and highest height that counts as terrain [m].
            on_robot: returns the mask of points (n, 3) in base_footprint that lie on the robot itself; for stripes
                with a `StripePlace`, its body is used instead.
        """
        self._geometry, self._locator = geometry, locator
        self._height_limits, self._on_robot = height_limits, on_robot

    def points(
        self, profiles: Mapping[int, StripeProfile], places: Mapping[int, StripePlace] | None = None
    ) -> dict[int, StripePoints]:
        """Points of stripes by index.

        Args:
            profiles: profiles of usable frames by index.
            places: pose of camera and body at the flash of each stripe, which requires a `Triangulator`; None = the
                camera stood still.
        """
        found: dict[int, StripePoints] = {}
        for group in in_groups(list(profiles), TOGETHER if places is None else 1):
            locator, on_robot, place = self._locator, self._on_robot, None
            if places is not None:
                assert isinstance(locator, Triangulator)
                place = places[group[0]]
                locator, on_robot = locator.at(place.transform_camera_to_footprint), place.body.contains
            points = stripe_points(
                [profiles[index] for index in group],
                locator,
                np.array([self._geometry.stripes[index].plane_in_camera for index in group]),
                self._height_limits,
                on_robot,
                None if place is None else place.height_variance,
            )
            found.update(zip(group, points, strict=True))
        return found


def variance_by_motion(points: Float, camera: Float, motion: Float) -> Float:
    """Variances (...) of the heights of points due to camera motion [m^2].

    A small motion (v, w) of the camera moves a point at r relative to the camera by v_z + w_x r_y - w_y r_x along z.

    Args:
        points: (3, ...) points in base_footprint.
        camera: (3,) optical centre in base_footprint.
        motion: (3, 3) covariance of v_z [m], w_x and w_y [rad].
    """
    x, y = points[0] - camera[0], points[1] - camera[1]
    (zz, zx, zy), (_, xx, xy), (_, _, yy) = motion
    # Written out instead of as a matrix product, whose rounding can depend on the number of points.
    return np.asarray(zz + 2.0 * (zx * y - zy * x) + xx * y**2 - 2.0 * xy * x * y + yy * x**2)


def in_groups(items: list[Item], size: int = TOGETHER) -> Iterator[list[Item]]:
    """Split items into groups of `size`, in order; the last group may be smaller."""
    return (items[begin : begin + size] for begin in range(0, len(items), size))
