"""Where in the picture a laser sheet can be seen: the row, per column, at which it would cross a given height."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from guara_perception.calibration.camera import CameraModel

Float = npt.NDArray[np.float64]

# The line is sampled this far to both sides of the camera: well beyond any picture at half a metre.
HALF_LENGTH_M = 1.2
SAMPLES = 49


def plane_in_frame(plane_in_camera: Float, transform_camera_to_frame: Float) -> Float:
    """A plane (4,) n . X + d = 0 of the camera frame, or several (s, 4), expressed in another frame."""
    rotation, translation = transform_camera_to_frame[:3, :3], transform_camera_to_frame[:3, 3]
    normal = plane_in_camera[..., :3] @ rotation.T
    return np.concatenate((normal, plane_in_camera[..., 3:] - (normal @ translation)[..., None]), axis=-1)


def height_rows(
    camera: CameraModel, transform_camera_to_footprint: Float, planes_in_camera: Float, heights: Float
) -> Iterator[Float]:
    """Rows at which each sheet crosses each height.

    Args:
        camera: intrinsic model.
        transform_camera_to_footprint: (4, 4), z of the target frame is the height.
        planes_in_camera: (s, 4) one plane per stripe.
        heights: (h,) heights above z = 0 of the footprint [m].

    Yields:
        For each plane (h, width) float64 rows; NaN in columns from which that line is not seen.
    """
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
    pixels = camera.project(in_camera.T).reshape(*distance.shape, SAMPLES, 2)
    columns = np.arange(camera.size[0])
    for lines in pixels:
        yield np.array([_rows_of_line(line, columns) for line in lines])


def _rows_of_line(pixels: Float, columns: npt.NDArray[np.int64]) -> Float:
    """Rows of a line, given by some of its pixels (n, 2), at columns; NaN beyond its ends."""
    seen = pixels[np.isfinite(pixels[:, 0])]
    if len(seen) < 2:
        return np.full(columns.size, np.nan)
    seen = seen[np.argsort(seen[:, 0])]
    return np.interp(columns, seen[:, 0], seen[:, 1], left=np.nan, right=np.nan)


def row_band(rows: Float, margin: int, height: int) -> tuple[int, int]:
    """First and end row of a band that holds all finite `rows` and a margin, cut to the picture; (0, 0) when empty."""
    lowest, highest = float(np.fmin.reduce(rows, axis=None)), float(np.fmax.reduce(rows, axis=None))
    if not (math.isfinite(lowest) and math.isfinite(highest)):
        return (0, 0)
    first = max(math.floor(lowest) - margin, 0)
    end = min(math.ceil(highest) + margin + 1, height)
    return (first, end) if end - first >= 2 * margin else (0, 0)
