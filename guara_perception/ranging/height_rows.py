"""Where in the picture a laser sheet can be seen: the row, per column, at which it would cross a given height."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from guara_perception.calibration.camera import CameraModel

Float = npt.NDArray[np.float64]

# The line is sampled this far to both sides of the camera: well beyond any picture at half a metre.
HALF_LENGTH_M = 1.2
SAMPLES = 49


def plane_in_frame(plane_in_camera: Float, transform_camera_to_frame: Float) -> Float:
    """A plane (4,) n . X + d = 0 of the camera frame, expressed in another frame."""
    rotation, translation = transform_camera_to_frame[:3, :3], transform_camera_to_frame[:3, 3]
    normal = rotation @ plane_in_camera[:3]
    return np.append(normal, plane_in_camera[3] - normal @ translation)


def height_rows(
    camera: CameraModel, transform_camera_to_footprint: Float, planes_in_camera: Float, heights: Float
) -> Float:
    """Rows at which each sheet crosses each height.

    Args:
        camera: intrinsic model.
        transform_camera_to_footprint: (4, 4), z of the target frame is the height.
        planes_in_camera: (s, 4) one plane per stripe.
        heights: (h,) heights above z = 0 of the footprint [m].

    Returns:
        (s, h, width) float64 rows; NaN in columns from which that line is not seen.
    """
    rotation, translation = transform_camera_to_footprint[:3, :3], transform_camera_to_footprint[:3, 3]
    along = np.linspace(-HALF_LENGTH_M, HALF_LENGTH_M, SAMPLES)
    points = np.empty((len(planes_in_camera), len(heights), SAMPLES, 3))
    for i, plane_in_camera in enumerate(planes_in_camera):
        plane = plane_in_frame(plane_in_camera, transform_camera_to_footprint)
        horizontal = plane[:2]
        steepness = float(np.linalg.norm(horizontal))
        direction = np.array([-horizontal[1], horizontal[0]]) / max(steepness, 1e-12)
        for j, height in enumerate(heights):
            # The point of the line nearest to the spot below the camera.
            distance = -(plane @ np.append(translation[:2], [height, 1.0])) / max(steepness, 1e-12)
            foot = translation[:2] + distance * horizontal / max(steepness, 1e-12)
            points[i, j, :, :2] = foot + along[:, None] * direction
            points[i, j, :, 2] = height
    pixels = camera.project((points.reshape(-1, 3) - translation) @ rotation)
    pixels = pixels.reshape(*points.shape[:3], 2)
    rows = np.full((*points.shape[:2], camera.size[0]), np.nan)
    columns = np.arange(camera.size[0])
    for i, j in np.ndindex(*points.shape[:2]):
        seen = pixels[i, j][np.isfinite(pixels[i, j, :, 0])]
        if len(seen) > 1:
            seen = seen[np.argsort(seen[:, 0])]
            rows[i, j] = np.interp(columns, seen[:, 0], seen[:, 1], left=np.nan, right=np.nan)
    return rows


def row_band(rows: Float, margin: int, height: int) -> tuple[int, int]:
    """First and end row of a band that holds all finite `rows` and a margin, cut to the picture; (0, 0) when empty."""
    finite = rows[np.isfinite(rows)]
    if not finite.size:
        return (0, 0)
    first = max(int(np.floor(finite.min())) - margin, 0)
    end = min(int(np.ceil(finite.max())) + margin + 1, height)
    return (first, end) if end - first >= 2 * margin else (0, 0)
