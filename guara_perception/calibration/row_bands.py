"""Image rows in which a surface lit by a laser plane can appear."""

from __future__ import annotations

import math

import numpy as np

from guara_perception.arrays import Float
from guara_perception.calibration.calibration import CameraModel, plane_in_frame

# Half length of the sampled part of the line in which a laser plane and a horizontal plane intersect. Seen from half a
# metre, this part extends beyond the image.
HALF_LENGTH_M = 1.2
SAMPLES = 49


def row_bands(
    camera: CameraModel, transform_camera_to_footprint: Float, planes_in_camera: Float, heights: Float, margin: int
) -> list[tuple[int, int]]:
    """Range of image rows, for each laser plane, in which a surface at one of several heights can appear.

    Args:
        camera: intrinsic model.
        transform_camera_to_footprint: (4, 4) pose of the camera; heights are measured along z of the footprint.
        planes_in_camera: (s, 4) one plane per stripe.
        heights: (h,) heights above z = 0 of the footprint [m].
        margin: rows added on each side; a band with fewer than 2 * margin rows inside the image is empty.

    Returns:
        First row and end row (exclusive) of the band of each plane, clipped to the image; (0, 0) if it is empty.
    """
    lines = _lines(camera, transform_camera_to_footprint, planes_in_camera, heights)
    order = np.argsort(lines[..., 0], axis=-1)[..., None]
    u, v = np.moveaxis(np.take_along_axis(lines, order, axis=-2), -1, 0)
    width, height = camera.size
    with np.errstate(divide="ignore", invalid="ignore"):
        # The line is taken as straight between two samples, so its extreme rows there are in the first or the last
        # column.
        steepness = np.diff(v) / np.diff(u)
        columns = np.stack((np.maximum(np.ceil(u[..., :-1]), 0), np.minimum(np.floor(u[..., 1:]), width - 1)))
        rows = steepness * (columns - u[..., :-1]) + v[..., :-1]
        rows[:, ~(columns[0] <= columns[1])] = np.nan
    lowest, highest = (choose.reduce(rows, axis=(0, 2, 3)).tolist() for choose in (np.fmin, np.fmax))
    return [_band(*ends, margin, height) for ends in zip(lowest, highest, strict=True)]


def _band(lowest: float, highest: float, margin: int, height: int) -> tuple[int, int]:
    if not (math.isfinite(lowest) and math.isfinite(highest)):
        return (0, 0)
    first = max(math.floor(lowest) - margin, 0)
    end = min(math.ceil(highest) + margin + 1, height)
    return (first, end) if end - first >= 2 * margin else (0, 0)


def _lines(camera: CameraModel, transform_camera_to_footprint: Float, planes_in_camera: Float, heights: Float) -> Float:
    """Pixels (s, h, SAMPLES, 2) along the intersections of laser planes with horizontal planes; NaN as in `project`."""
    translation = transform_camera_to_footprint[:3, 3]
    planes = plane_in_frame(planes_in_camera, transform_camera_to_footprint)
    steepness = np.maximum(np.hypot(planes[:, 0], planes[:, 1]), 1e-12)[:, None]
    across = planes[:, :2] / steepness
    # Signed distance (s, h) in the xy plane from the camera to each line, along `across`.
    distance = -(planes[:, :2] @ translation[:2] + planes[:, 3])[:, None] - planes[:, 2:3] * heights
    distance /= steepness
    along = np.linspace(-HALF_LENGTH_M, HALF_LENGTH_M, SAMPLES)
    points = np.empty((3, *distance.shape, SAMPLES))
    points[0] = (translation[0] + distance * across[:, :1])[:, :, None] - across[:, 1, None, None] * along
    points[1] = (translation[1] + distance * across[:, 1:])[:, :, None] + across[:, 0, None, None] * along
    points[2] = heights[:, None]
    in_camera = transform_camera_to_footprint[:3, :3].T @ (points.reshape(3, -1) - translation[:, None])
    return camera.project(in_camera.T).reshape(*distance.shape, SAMPLES, 2)
