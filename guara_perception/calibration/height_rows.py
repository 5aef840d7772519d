"""Where in the picture a laser plane can be seen: the rows in which it would cross given heights."""

from __future__ import annotations

import math

import numpy as np

from guara_perception.arrays import Float
from guara_perception.calibration.calibration import CameraModel

# The line is sampled this far to both sides of the camera: well beyond any picture at half a metre.
HALF_LENGTH_M = 1.2
SAMPLES = 49


def plane_in_frame(plane_in_camera: Float, transform_camera_to_frame: Float) -> Float:
    """A plane (4,) n . X + d = 0 of the camera frame, or several (s, 4), expressed in another frame."""
    rotation, translation = transform_camera_to_frame[:3, :3], transform_camera_to_frame[:3, 3]
    normal = plane_in_camera[..., :3] @ rotation.T
    return np.concatenate((normal, plane_in_camera[..., 3:] - (normal @ translation)[..., None]), axis=-1)


def row_bands(
    camera: CameraModel, transform_camera_to_footprint: Float, planes_in_camera: Float, heights: Float, margin: int
) -> list[tuple[int, int]]:
    """First and end row of the band in which each laser plane crosses any of the heights, cut to the picture.

    Args:
        camera: intrinsic model.
        transform_camera_to_footprint: (4, 4), z of the target frame is the height.
        planes_in_camera: (s, 4) one plane per stripe.
        heights: (h,) heights above z = 0 of the footprint [m].
        margin: rows to add at either side; a band that is not wider than both is empty.

    Returns:
        One band per plane, (0, 0) where it is empty or no such line is seen.
    """
    lines = _lines(camera, transform_camera_to_footprint, planes_in_camera, heights)
    order = np.argsort(lines[..., 0], axis=-1)[..., None]
    u, v = np.moveaxis(np.take_along_axis(lines, order, axis=-2), -1, 0)
    width, height = camera.size
    with np.errstate(divide="ignore", invalid="ignore"):
        # Between two samples of a line its row is highest or lowest in the first or the last column.
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
    """Pixels (s, h, SAMPLES, 2) along the lines in which laser planes cross heights; NaN where they are not seen."""
    translation = transform_camera_to_footprint[:3, 3]
    planes = plane_in_frame(planes_in_camera, transform_camera_to_footprint)
    steepness = np.maximum(np.hypot(planes[:, 0], planes[:, 1]), 1e-12)[:, None]
    across = planes[:, :2] / steepness
    # The point of the line nearest to the spot below the camera, (s, h) along `across`.
    distance = -(planes[:, :2] @ translation[:2] + planes[:, 3])[:, None] - planes[:, 2:3] * heights
    distance /= steepness
    along = np.linspace(-HALF_LENGTH_M, HALF_LENGTH_M, SAMPLES)
    points = np.empty((3, *distance.shape, SAMPLES))
    points[0] = (translation[0] + distance * across[:, :1])[:, :, None] - across[:, 1, None, None] * along
    points[1] = (translation[1] + distance * across[:, 1:])[:, :, None] + across[:, 0, None, None] * along
    points[2] = heights[:, None]
    in_camera = transform_camera_to_footprint[:3, :3].T @ (points.reshape(3, -1) - translation[:, None])
    return camera.project(in_camera.T).reshape(*distance.shape, SAMPLES, 2)
