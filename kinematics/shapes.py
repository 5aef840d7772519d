"""Points and rays against boxes, cylinders and spheres, vectorised over the points.

Each shape is grown by a margin when it is made. A coarse test against its bounding sphere leaves few points for the
exact one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinematics.arrays import Float, Mask
from kinematics.urdf import Shape

# Stands for a zero component of a ray: its slab then reaches from minus to plus infinity, or is empty.
NO_DIRECTION = 1e-300


@dataclass(frozen=True, slots=True, eq=False)
class PlacedShape:
    """A shape of a link, in `base_link`.

    Attributes:
        link: the link it belongs to.
        kind: "box", "cylinder" (axis z) or "sphere".
        half: (3,) half extents along its own axes, margin included; radius in x and y for a cylinder [m].
        centre: (3,) in `base_link` [m].
        rotation: (3, 3) from the shape's axes to `base_link`.
        reach: radius of its bounding sphere [m].
    """

    link: str
    kind: str
    half: Float
    centre: Float
    rotation: Float
    reach: float

    def contains(self, points_in_base: Float) -> Mask:
        """Which of the points (n, 3) lie inside."""
        local = (points_in_base - self.centre) @ self.rotation
        if self.kind == "box":
            return np.asarray(np.all(np.abs(local) <= self.half, axis=1))
        if self.kind == "cylinder":
            within = np.einsum("ni,ni->n", local[:, :2], local[:, :2]) <= self.half[0] ** 2
            return np.asarray(within & (np.abs(local[:, 2]) <= self.half[2]))
        return np.asarray(np.einsum("ni,ni->n", local, local) <= self.half[0] ** 2)

    def blocks(self, origins: Float, directions: Float) -> Mask:
        """Which segments it touches, from `origins` (n, 3) or (1, 3) along `directions` (n, 3), in `base_link` [m]."""
        start, along = (origins - self.centre) @ self.rotation, directions @ self.rotation
        if self.kind == "box":
            enter, leave = _through_slabs(start, along, self.half)
        else:
            enter, leave = _through_round(start, along, self.half[0], flat=self.kind == "cylinder")
            if self.kind == "cylinder":
                low, high = _through_slabs(start[:, 2:], along[:, 2:], self.half[2:])
                enter, leave = np.maximum(enter, low), np.minimum(leave, high)
        return np.asarray((enter <= leave) & (leave >= 0.0) & (enter <= 1.0))


def place_shape(shape: Shape, link: str, transform_link_to_base: Float, margin: float) -> PlacedShape:
    """A shape of the URDF at its pose on the robot, grown by a margin [m]."""
    transform = transform_link_to_base @ shape.transform_shape_to_link
    if shape.kind == "box":
        half = np.asarray(shape.size) / 2.0
        reach = float(np.linalg.norm(half + margin))
    elif shape.kind == "cylinder":
        half = np.array([shape.size[0], shape.size[0], shape.size[1] / 2.0])
        reach = float(np.hypot(half[0] + margin, half[2] + margin))
    else:
        half = np.full(3, shape.size[0])
        reach = shape.size[0] + margin
    return PlacedShape(link, shape.kind, half + margin, transform[:3, 3], transform[:3, :3], reach)


def _through_slabs(start: Float, along: Float, half: Float) -> tuple[Float, Float]:
    """Where rays enter and leave the slabs |x_i| <= half_i of all axes at once, as shares of their length."""
    direction = np.where(along == 0.0, NO_DIRECTION, along)
    with np.errstate(over="ignore"):
        one, other = (-half - start) / direction, (half - start) / direction
    return np.minimum(one, other).max(axis=1), np.maximum(one, other).min(axis=1)


def _through_round(start: Float, along: Float, radius: float, *, flat: bool) -> tuple[Float, Float]:
    """Where rays enter and leave a sphere, or (flat) an endless cylinder about z; enter > leave where they miss."""
    used = slice(0, 2) if flat else slice(0, 3)
    a = np.einsum("ni,ni->n", along[:, used], along[:, used])
    b = np.einsum("ni,ni->n", np.broadcast_to(start, along.shape)[:, used], along[:, used])
    c = np.einsum("ni,ni->n", start[:, used], start[:, used]) - radius**2
    root = b * b - a * c
    a = np.where(a == 0.0, NO_DIRECTION, a)
    with np.errstate(over="ignore", invalid="ignore"):
        half_chord = np.sqrt(np.maximum(root, 0.0))
        enter, leave = (-b - half_chord) / a, (-b + half_chord) / a
    # A ray that runs along the axis is inside for all its length or nowhere.
    along_axis = a == NO_DIRECTION
    enter = np.where(along_axis, np.where(c <= 0.0, -np.inf, np.inf), enter)
    leave = np.where(along_axis, np.where(c <= 0.0, np.inf, -np.inf), leave)
    return np.where(root < 0.0, np.inf, enter), np.where(root < 0.0, -np.inf, leave)
