"""Straight lines of stripes on the ground, and projection between pixels and a level plane."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from guara_perception.arrays import Float, Index, Mask
from guara_perception.calibration.calibration import CameraModel
from kinematics.arrays import FrozenArrays

# A stripe is cut along y into this number of parts; the median height of a part is the height of the ground there.
PARTS = 12
PAIRS = np.array(list(combinations(range(PARTS), 2)))
LEAST_POINTS = 4
# A part is on a line within this distance: fifteen times the scatter of medians on a flat floor.
LINE_TOLERANCE_M = 0.0005
# A stripe is straight if at least this many of its parts, and this share of those that returned, are on one line.
LEAST_PARTS = 6
LEAST_SHARE = 0.7


@dataclass(frozen=True, slots=True)
class FloorLines(FrozenArrays):
    """Straight stripes of a scan, in order of their index; a line z = offset + slope y each.

    A moved camera or laser leaves a straight stripe straight; ground that is not flat bends it. Straightness therefore
    proves a floor, and the positions of the lines prove the calibration.

    Attributes:
        seen: number of stripes that returned enough points.
        index: (s,) stripe indices of the straight ones.
        x: (s,) mean x of the points on the line [m].
        offset: (s,) z at y = 0 [m].
        slope: (s,) dz/dy [-].
        roughness: (s,) rms distance of the parts from their line [m].
    """

    seen: int
    index: Index
    x: Float
    offset: Float
    slope: Float
    roughness: Float


def find_floor_lines(points: Mapping[int, Float]) -> FloorLines:
    """Lines of the stripes that run straight over most of their length.

    Args:
        points: (w, 3) points in base_footprint of each stripe, by index, NaN where there are none.
    """
    index, x, y, z = _parts(points)
    enough = np.flatnonzero(np.isfinite(z).sum(axis=1) >= LEAST_PARTS)
    index, x, y, z = index[enough], x[enough], y[enough], z[enough]
    on_line = _largest_agreement(y, z)
    count = on_line.sum(axis=1)
    straight = (count >= LEAST_PARTS) & (count >= LEAST_SHARE * np.isfinite(z).sum(axis=1))
    on_line, count = on_line[straight], count[straight]
    x, y, z = (np.where(on_line, values[straight], 0.0) for values in (x, y, z))
    mean_y, mean_z = y.sum(axis=1) / count, z.sum(axis=1) / count
    dy, dz = (np.where(on_line, v - m[:, None], 0.0) for v, m in ((y, mean_y), (z, mean_z)))
    slope = (dy * dz).sum(axis=1) / (dy * dy).sum(axis=1)
    rest = dz - slope[:, None] * dy
    return FloorLines(
        seen=len(enough),
        index=index[straight],
        x=x.sum(axis=1) / count,
        offset=mean_z - slope * mean_y,
        slope=slope,
        roughness=np.sqrt((rest * rest).sum(axis=1) / (count - 2)),
    )


def _parts(points: Mapping[int, Float]) -> tuple[Index, Float, Float, Float]:
    """Indices (s,) of the stripes; mean x, mean y and median z (s, PARTS) of their parts, NaN for too few points."""
    indices = sorted(points)
    stacked = np.concatenate([np.empty((0, 3)), *(np.asarray(points[index], np.float64) for index in indices)])
    known = np.flatnonzero(np.isfinite(stacked[:, 2]))
    x, y, z = stacked[known].T
    stripe = np.repeat(np.arange(len(indices)), [len(points[index]) for index in indices])[known]
    low, high = (float(y.min()), float(y.max())) if y.size else (0.0, 1.0)
    part = np.minimum((y - low) * (PARTS / max(high - low, 1e-9)), PARTS - 1).astype(np.intp) + stripe * PARTS
    shape = len(indices), PARTS
    count = np.bincount(part, minlength=len(indices) * PARTS)
    order = np.lexsort((z, part))
    median_index = np.minimum(np.cumsum(count) - count + count // 2, max(len(order) - 1, 0))
    few = count < LEAST_POINTS
    divisor = np.where(few, 1, count)

    def whole(values: Float) -> Float:
        return np.where(few, np.nan, values).reshape(shape)

    sums = (np.bincount(part, values, len(indices) * PARTS) / divisor for values in (x, y))
    medians = z[order][median_index] if len(order) else np.zeros(0)
    mean_x, mean_y = (whole(values) for values in sums)
    return np.array(indices, np.intp), mean_x, mean_y, whole(medians) if len(order) else np.full(shape, np.nan)


def _largest_agreement(y: Float, z: Float) -> Mask:
    """Mask (s, PARTS) of the parts on the best line of each stripe: the line through two parts with most others."""
    if not len(z):
        return np.zeros((0, PARTS), np.bool_)
    first, second = PAIRS.T
    slope = (z[:, second] - z[:, first]) / (y[:, second] - y[:, first])
    distance = z[:, None, :] - z[:, first, None] - slope[:, :, None] * (y[:, None, :] - y[:, first, None])
    distance = np.nan_to_num(np.abs(distance), nan=np.inf)
    # Weights decrease with the distance, so that of lines with equally many parts the closest wins.
    weight = np.maximum(1.0 - 0.5 * distance / LINE_TOLERANCE_M, 0.0) * (distance < LINE_TOLERANCE_M)
    best = np.argmax(weight.sum(axis=2), axis=1)
    return np.asarray(distance[np.arange(len(z)), best] < LINE_TOLERANCE_M)


def floor_pixels(camera: CameraModel, transform_camera_to_footprint: Float, points: Float) -> Float:
    """Pixels (n, 2) of floor points (n, 2)."""
    rotation, translation = transform_camera_to_footprint[:3, :3], transform_camera_to_footprint[:3, 3]
    in_footprint = np.column_stack((points, np.zeros(len(points))))
    return camera.project((in_footprint - translation) @ rotation)


def to_floor(camera: CameraModel, transform_camera_to_footprint: Float, pixels: Float, height: float = 0.0) -> Float:
    """Points (n, 2), x and y in base_footprint, at which the rays of pixels (n, 2) meet the plane z = `height`."""
    rotation, translation = transform_camera_to_footprint[:3, :3], transform_camera_to_footprint[:3, 3]
    rays = camera.rays(pixels) @ rotation.T
    depth = (height - translation[2]) / rays[:, 2]
    return translation[:2] + rays[:, :2] * depth[:, None]
