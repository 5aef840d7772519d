"""Static stability: distance of the centre of mass from the border of the support polygon."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from kinematics.exceptions import ArgumentError, StanceError
from kinematics.stance_pose import StancePose
from kinematics.transforms import transform_points


def polygon_margin(corners: npt.ArrayLike, point: npt.ArrayLike) -> float:
    """Signed distance [m] of a point (2,) from the border of the convex hull of corners (n, 2), positive inside.

    One or two corners, or corners on a line, have no interior; the result is then zero or negative.

    Raises:
        ArgumentError: an array has the wrong shape or is not finite.
    """
    vertices, position = np.asarray(corners, dtype=np.float64), np.asarray(point, dtype=np.float64)
    if vertices.ndim != 2 or vertices.shape[1] != 2 or len(vertices) < 1 or not np.all(np.isfinite(vertices)):
        raise ArgumentError(f"corners have shape {vertices.shape}; (n, 2) finite numbers with n >= 1 are needed")
    if position.shape != (2,) or not np.all(np.isfinite(position)):
        raise ArgumentError(f"point has shape {position.shape}; (2,) finite numbers are needed")
    from scipy.spatial import ConvexHull, QhullError

    relative = vertices - position
    try:
        margin = -float(ConvexHull(relative).equations[:, 2].max())
    except (QhullError, ValueError):  # fewer than three corners, or corners on a line
        margin = -1.0
    if margin >= 0.0:
        return margin
    # For a point outside, the nearest point of the hull is on a segment between two corners.
    first, edges = relative[:, None], relative - relative[:, None]
    share = -np.vecdot(first, edges) / np.maximum(np.vecdot(edges, edges), np.finfo(float).tiny)
    return -float(np.linalg.norm(first + np.clip(share, 0.0, 1.0)[..., None] * edges, axis=-1).min())


def stability_margin(pose: StancePose, *, lifted: str | None = None) -> float:
    """Static stability margin [m]: signed distance of the projected centre of mass from the support polygon's border.

    Positive inside. The polygon is spanned by the centres of the soles, so it lies inside the true polygon of contacts,
    which extends about half a sole further.

    Args:
        pose: the stance pose; the soles of its `support_feet_used` span the polygon.
        lifted: leg that is about to be lifted; its sole is excluded, but its mass stays at its current position.

    Raises:
        StanceError: the lifted leg does not carry the body, or no other leg does.
        UnknownName: the robot has no such leg.
    """
    legs = list(pose.support_feet_used)
    soles = pose.soles_in_footprint
    if lifted is not None:
        if pose.state.tree.leg(lifted).name not in legs:
            raise StanceError(f"leg {lifted!r} does not carry the body; these do: {', '.join(legs)}")
        soles = np.delete(soles, legs.index(lifted), axis=0)
        if not len(soles):
            raise StanceError(f"no foot carries the body once leg {lifted!r} is lifted; at least one other must")
    centre = transform_points(pose.transform_base_to_footprint, pose.state.centre_of_mass_in_base)
    return polygon_margin(soles[:, :2], centre[:2])
