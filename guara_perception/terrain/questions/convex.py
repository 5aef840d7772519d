"""Large convex polygons that avoid squares.

Half-planes and an ellipse are computed alternately, as in IRIS (Deits and Tedrake, Computing large convex regions of
obstacle-free space through semidefinite programming, WAFR 2014): each half-plane excludes the nearest square not yet
excluded, and the next ellipse is computed from the polygon of the half-planes. The distance of a square is measured in
the metric of the ellipse, to the point of the square that is closest to the centre in the Euclidean sense. Unlike in
IRIS, the ellipse is that of the polygon's second moments, not the largest inscribed one, and a half-plane that would
exclude the seed is replaced.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from guara_perception.arrays import Float, Index

MOST_ROUNDS = 4
# Least relative gain in area after which another round follows.
LEAST_GAIN = 0.01
# Gap between half-planes and squares. It covers rounding errors, and keeps the polygon off the lower edges of cells,
# since a cell includes its lower edges.
OFF_M = 2e-6
# Length below which a side is removed.
LEAST_SIDE_M = 1e-9


@dataclass(frozen=True, slots=True)
class ConvexPolygon:
    """Convex polygon in the plane.

    Attributes:
        halfspaces: (n, 3) a, b, c of a x + b y <= c, (a, b) of length 1; none is redundant.
        vertices: (n, 2) corners, counter-clockwise [m].
        area: area [m^2].
    """

    halfspaces: Float
    vertices: Float
    area: float


def grow_polygon(seed: Float, bounds: Float, squares: Float, half: float) -> ConvexPolygon:
    """Grow a large convex polygon that contains a seed and intersects no square.

    Args:
        seed: (2,) point inside `bounds` and outside all squares.
        bounds: (k, 3) half-planes around the seed that bound the polygon to within 2 m of it.
        squares: (n, 2) centres of axis-aligned squares [m].
        half: half the edge of a square [m].
    """
    best = _polygon(np.vstack((bounds, _cuts(seed, seed, np.eye(2), squares, half))), seed)
    for _ in range(MOST_ROUNDS - 1):
        centre, metric = _ellipse(best.vertices)
        grown = _polygon(np.vstack((bounds, _cuts(seed, centre, metric, squares, half))), seed)
        if grown.area < best.area * (1 + LEAST_GAIN):
            break
        best = grown
    return best


def _cuts(seed: Float, centre: Float, metric: Float, squares: Float, half: float) -> Float:
    """Half-planes (n, 3) that contain the seed and exclude all squares, beginning with the nearest in the metric."""
    cuts: list[tuple[float, float, float]] = []
    reach = half + OFF_M
    x, y = np.ascontiguousarray(squares.T)
    (xx, xy), (_, yy) = metric.tolist()
    seed_x, seed_y = seed.tolist()
    offset_x, offset_y = _nearest(x - centre[0], reach), _nearest(y - centre[1], reach)
    left = np.argsort(offset_x * (xx * offset_x + 2 * xy * offset_y) + yy * offset_y**2, kind="stable")
    x, y, offset_x, offset_y = x[left], y[left], offset_x[left], offset_y[left]
    while x.size:
        at_x, at_y, dx, dy = (float(values[0]) for values in (x, y, offset_x, offset_y))
        a, b, edge = _side(xx * dx + xy * dy, xy * dx + yy * dy, at_x, at_y, reach)
        if not a * seed_x + b * seed_y < edge:
            # This half-plane would exclude the seed, so its normal is replaced by the vector from the seed to the
            # nearest point of the square.
            dx, dy = _nearest(np.array([at_x - seed_x, at_y - seed_y]), reach).tolist()
            a, b, edge = _side(dx, dy, at_x, at_y, reach)
        cuts.append((a, b, edge))
        within = a * x + b * y < edge + reach * (abs(a) + abs(b)) - 1e-12
        within[0] = False
        x, y, offset_x, offset_y = x[within], y[within], offset_x[within], offset_y[within]
    return np.array(cuts).reshape(-1, 3)


def _nearest(offset: Float, reach: float) -> Float:
    """Coordinates (n,) of the points nearest to the origin in squares with centre coordinates `offset` (n,).

    Each coordinate is treated independently.
    """
    return np.asarray(offset - np.minimum(np.maximum(offset, -reach), reach))


def _side(normal_x: float, normal_y: float, x: float, y: float, reach: float) -> tuple[float, float, float]:
    """Half-plane (a, b, c) with this outward normal that touches the square of half-width `reach` centred at (x, y).

    c is -inf for a zero normal.
    """
    length = math.hypot(normal_x, normal_y)
    if length == 0:
        return 0.0, 0.0, -math.inf
    a, b = normal_x / length, normal_y / length
    return a, b, a * x + b * y - reach * (abs(a) + abs(b))


def _polygon(halfspaces: Float, inside: Float) -> ConvexPolygon:
    """Bounded polygon of half-planes that all contain a point.

    Relative to that point, a line at distance c with normal n has the dual point n / c. The corners of the convex hull
    of the dual points, in order, correspond to the sides of the polygon. Dual points are rounded to float32 to merge
    nearly equal lines. This moves the border by less than 1e-6 of its distance from the point, which is below OFF_M for
    polygons within 2 m of it.
    """
    normals, offsets = halfspaces[:, :2], halfspaces[:, 2] - halfspaces[:, :2] @ inside
    on = _hull((normals / offsets[:, None]).astype(np.float32).astype(np.float64))
    after = np.append(on[1:], on[0])
    (a, b), c = normals[on].T, offsets[on]
    (next_a, next_b), next_c = normals[after].T, offsets[after]
    # Sine of the counter-clockwise turn from one side to the next; not 0, because neighbouring sides are not parallel.
    turn = a * next_b - b * next_a
    vertices = np.column_stack((c * next_b - b * next_c, a * next_c - c * next_a)) / turn[:, None]
    # Corner i lies between sides i and i + 1. A side that is too short is removed with the corner at its end.
    before = np.concatenate((vertices[-1:], vertices[:-1]))
    apart = np.abs(vertices - before).max(axis=1) > LEAST_SIDE_M
    if not apart.all():
        vertices, on = vertices[apart], on[apart]
        before = np.concatenate((vertices[-1:], vertices[:-1]))
    area = 0.5 * float(before[:, 0] @ vertices[:, 1] - before[:, 1] @ vertices[:, 0])
    return ConvexPolygon(halfspaces[on], vertices + inside, area)


def _hull(points: Float) -> Index:
    """Indices of the corners of the convex hull of points (n, 2) around the origin, counter-clockwise."""
    x, y = points.T
    order = np.lexsort((x * x + y * y, np.arctan2(y, x)))
    # The farthest point is a corner.
    first = int(np.argmax((x * x + y * y)[order]))
    left = np.concatenate((order[first:], order[:first])).tolist()
    xs, ys = x.tolist(), y.tolist()
    hull = [left[0]]
    for point in (*left[1:], left[0]):
        px, py = xs[point], ys[point]
        while len(hull) > 1:
            (ax, ay), (bx, by) = (xs[hull[-2]], ys[hull[-2]]), (xs[hull[-1]], ys[hull[-1]])
            if (bx - ax) * (py - by) > (by - ay) * (px - bx):
                break
            hull.pop()
        hull.append(point)
    return np.array(hull[:-1])


def _ellipse(vertices: Float) -> tuple[Float, Float]:
    """Centre of a polygon, and the metric in which the ellipse of its second moments is a circle."""
    mean = vertices.mean(axis=0)
    # In millimetres relative to the mean. Adding 1e-3 mm^2 to the variances below is negligible, and keeps the
    # covariance invertible.
    corner = 1e3 * (vertices - mean)
    after = np.concatenate((corner[1:], corner[:1]))
    cross = corner[:, 0] * after[:, 1] - after[:, 0] * corner[:, 1]
    if not cross.sum() > 0:
        return mean, np.eye(2)
    # Moments of the triangles (0, corner, after). Element by element, since the last bit of matrix products depends on
    # the processor.
    share, both = (cross / cross.sum())[:, None], corner + after
    centre = (share * both).sum(axis=0) / 3
    moments = sum(side[:, :, None] * side[:, None, :] for side in (both, corner, after))
    covariance = (share[:, None] * moments).sum(axis=0) / 12 - np.outer(centre, centre) + 1e-3 * np.eye(2)
    return mean + 1e-3 * centre, np.asarray(np.linalg.inv(covariance), dtype=np.float64)
