"""How far the centre of mass is from tipping over the feet that carry it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from kinematics.arrays import Float
from kinematics.exceptions import ArgumentError, StanceError, unknown_name
from kinematics.stance_pose import StancePose
from kinematics.transforms import transform_points


def polygon_margin(corners: npt.ArrayLike, point: npt.ArrayLike) -> float:
    """Signed distance [m] of a point (2,) from the border of the convex hull of corners (n, 2): positive inside.

    One or two corners, or corners on a line, hold nothing: the distance to them is negative.

    Raises:
        ArgumentError: wrong shape or not finite.
    """
    vertices, position = np.asarray(corners, dtype=np.float64), np.asarray(point, dtype=np.float64)
    if vertices.ndim != 2 or vertices.shape[1] != 2 or len(vertices) < 1 or not np.all(np.isfinite(vertices)):
        raise ArgumentError(f"corners have shape {vertices.shape}; (n, 2) finite numbers with n >= 1 are needed")
    if position.shape != (2,) or not np.all(np.isfinite(position)):
        raise ArgumentError(f"point has shape {position.shape}; (2,) finite numbers are needed")
    hull = _convex_hull(vertices)
    edges = np.roll(hull, -1, axis=0) - hull
    lengths = np.maximum(np.einsum("ni,ni->n", edges, edges), np.finfo(float).tiny)
    share = np.clip(np.einsum("ni,ni->n", position - hull, edges) / lengths, 0.0, 1.0)
    distance = float(np.linalg.norm(position - hull - share[:, None] * edges, axis=1).min())
    # Counter-clockwise: inside is on the left of every edge.
    left = edges[:, 0] * (position - hull)[:, 1] - edges[:, 1] * (position - hull)[:, 0]
    return distance if len(hull) >= 3 and np.all(left >= 0.0) else -distance


def _convex_hull(points: Float) -> Float:
    """Corners of the convex hull (m, 2), counter-clockwise, without those on its edges (monotone chain)."""
    ordered = np.unique(points, axis=0)
    if len(ordered) < 3:
        return ordered

    def chain(rows: Float) -> list[Float]:
        kept: list[Float] = []
        for row in rows:
            while len(kept) >= 2 and _turn(kept[-2], kept[-1], row) <= 0.0:
                kept.pop()
            kept.append(row)
        return kept[:-1]

    return np.array(chain(ordered) + chain(ordered[::-1]))


def _turn(a: Float, b: Float, c: Float) -> float:
    return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))


def stability_margin(pose: StancePose, *, lifted: str | None = None) -> float:
    """Static stability margin [m]: the centre of mass, dropped along the vertical, against the polygon of the soles.

    Args:
        pose: the stance pose; its used feet span the polygon (sole centres, so half a sole to spare).
        lifted: a leg that is about to be lifted and is left out; its own weight stays where it is now.

    Raises:
        StanceError: the lifted leg does not carry the body.
        UnknownName: no such leg.
    """
    legs = list(pose.support_feet_used)
    soles = pose.soles_in_footprint
    if lifted is not None:
        if lifted not in pose.state.tree.legs:
            raise unknown_name("leg", lifted, pose.state.tree.legs)
        if lifted not in legs:
            raise StanceError(f"leg {lifted!r} does not carry the body; these do: {', '.join(legs)}")
        soles = np.delete(soles, legs.index(lifted), axis=0)
        if not len(soles):
            raise StanceError(f"without {lifted!r} no foot is left to stand on")
    centre = transform_points(pose.transform_base_to_footprint, pose.state.centre_of_mass_in_base)
    return polygon_margin(soles[:, :2], centre[:2])
