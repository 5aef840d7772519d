"""Self-filter: detection of points on the robot itself and of points that it hides from the camera or the laser.

The robot is represented by the collision shapes of its URDF, each enlarged by a margin and placed by forward
kinematics. Points on these shapes are not terrain; points in their shadow are occluded by the robot, not by terrain.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from kinematics.arrays import Float, Mask
from kinematics.exceptions import ArgumentError, named
from kinematics.robot_settings import SelfFilterSettings
from kinematics.transforms import checked_points
from kinematics.tree import RobotState
from kinematics.urdf import Shape

# Margin of the coarse tests [m^2] for the rounding error of squared lengths computed as differences of larger squares.
ROUNDING = 1e-12
# Replaces a zero component of a ray's direction, so that the interval of the ray inside a slab is infinite or empty.
NO_DIRECTION = 1e-300


class SelfFilter:
    """Shapes of the robot in one state, for tests of many points.

    Args:
        state: the robot's state.
        margin: added to every shape on all sides [m]; None = `[self_filter] margin` of robot.toml.
        ignore: links to leave out; None = `[self_filter] ignore` of robot.toml.
        transform_base_to_frame: (4, 4) transform to another frame, in which all points and origins are then given
            instead of `base_link`.

    Raises:
        UnknownName: `ignore` names a link that the robot does not have.
        ArgumentError: the margin is negative or not finite.
    """

    def __init__(
        self,
        state: RobotState,
        *,
        margin: float | None = None,
        ignore: tuple[str, ...] | None = None,
        transform_base_to_frame: npt.ArrayLike | None = None,
    ) -> None:
        """Place every shape by the state's forward kinematics."""
        links = state.tree.links
        settings = SelfFilterSettings.from_table(state.tree.config.root.table("self_filter"), links)
        self.margin = settings.margin if margin is None else float(margin)
        if not np.isfinite(self.margin) or self.margin < 0.0:
            raise ArgumentError(f"margin is {margin}; a length of 0 m or more is needed")
        ignored = settings.ignore if ignore is None else tuple(ignore)
        for link in ignored:
            named("link to ignore", link, links)
        to_frame = np.eye(4) if transform_base_to_frame is None else np.asarray(transform_base_to_frame, np.float64)
        self.shapes = tuple(
            place_shape(shape, name, to_frame @ state.transform_to_base(name), self.margin)
            for name, link in links.items()
            if name not in ignored
            for shape in link.shapes
        )
        centres = np.array([shape.centre for shape in self.shapes]).reshape(-1, 3)
        self._reaches = reaches = np.array([shape.reach for shape in self.shapes])
        self._lowest, self._highest = centres - reaches[:, None], centres + reaches[:, None]
        # |p - c|^2 <= r^2 is equivalent to |p|^2 - 2 p . c <= r^2 - |c|^2.
        self._twice_centres = 2.0 * centres.T
        self._powers = reaches**2 - np.einsum("ni,ni->n", centres, centres) + ROUNDING
        # Single origins that passed `_check_outside`; a scan tests those of its camera and laser many times.
        self._outside = set[bytes]()

    def contains(self, points_in_base: npt.ArrayLike) -> Mask:
        """Mask of the points that lie on the robot.

        Args:
            points_in_base: (n, 3) in `base_link` [m]; a point with NaN does not lie on the robot.

        Returns:
            (n,) True for a point inside an enlarged shape.

        Raises:
            ArgumentError: the array has the wrong shape.
        """
        points = checked_points(points_in_base, "points_in_base", "(n, 3)")
        inside = np.zeros(len(points), dtype=np.bool_)
        if not len(points):
            return inside
        # Most points of a scan are ahead of the robot, so few shapes, if any, overlap the bounding box of the points.
        columns = np.ascontiguousarray(points.T)
        low, high = _box(columns)
        shapes = np.flatnonzero(np.all((self._lowest <= high) & (self._highest >= low), axis=1))
        if not len(shapes):
            return inside
        low, high = self._lowest[shapes].min(axis=0), self._highest[shapes].max(axis=0)
        is_within = np.ones(len(points), dtype=np.bool_)
        for values, least, most in zip(columns, low, high, strict=True):
            is_within &= (values >= least) & (values <= most)
        rows = np.flatnonzero(is_within)
        close = points[rows]
        # Test all bounding spheres at once, (n, shapes): few points are inside any of them.
        square = np.einsum("ni,ni->n", close, close)
        is_near = square[:, None] - close @ self._twice_centres[:, shapes] <= self._powers[shapes]
        for index in np.flatnonzero(is_near.any(axis=0)).tolist():
            near = np.flatnonzero(is_near[:, index])
            inside[rows[near]] |= self.shapes[shapes[index]].contains(close[near])
        return inside

    def blocks(self, origins_in_base: npt.ArrayLike, points_in_base: npt.ArrayLike) -> Mask:
        """Mask of the points whose line segment from the camera or laser meets the robot.

        Args:
            origins_in_base: origin of all segments (3,), or of each segment (n, 3), in `base_link` [m].
            points_in_base: (n, 3) in `base_link` [m]; a point with NaN is not blocked.

        Returns:
            (n,) True if the segment, including its ends, meets an enlarged shape.

        Raises:
            ArgumentError: an array has the wrong shape, or an origin is inside an enlarged shape. If that shape's link
                carries the camera or laser, name the link in `ignore`.
        """
        points = checked_points(points_in_base, "points_in_base", "(n, 3)")
        origins = np.asarray(origins_in_base, dtype=np.float64)
        if origins.shape not in ((3,), (len(points), 3)):
            raise ArgumentError(
                f"origins_in_base has shape {origins.shape}; (3,) or ({len(points)}, 3), one for each point, is needed"
            )
        origins = np.atleast_2d(origins)
        self._check_outside(origins)
        blocked = np.zeros(len(points), dtype=np.bool_)
        if not len(points):
            return blocked
        low, high = _box(np.ascontiguousarray(points.T))
        low, high = np.fmin(low, origins.min(axis=0)), np.fmax(high, origins.max(axis=0))
        shapes = np.flatnonzero(np.all((self._lowest <= high) & (self._highest >= low), axis=1))
        if not len(shapes):
            return blocked
        directions = points - origins
        lengths = np.sqrt(np.einsum("ni,ni->n", directions, directions))
        # Products that are the same for all shapes.
        by_origins = directions @ origins[0] if len(origins) == 1 else np.einsum("ni,ni->n", directions, origins)
        squares = np.einsum("ni,ni->n", origins, origins)
        twice_centres = self._twice_centres[:, shapes]
        along = (directions @ twice_centres) / 2 - by_origins[:, None]
        apart = squares[:, None] - origins @ twice_centres - self._powers[shapes]
        may_meet = _may_meet(along, apart, lengths[:, None], self._reaches[shapes])
        for column in np.flatnonzero(may_meet.any(axis=0)).tolist():
            near = np.flatnonzero(may_meet[:, column] & ~blocked)
            if len(near):
                own = origins if len(origins) == 1 else origins[near]
                blocked[near] = self.shapes[shapes[column]].blocks(own, directions[near])
        return blocked

    def _check_outside(self, origins: Float) -> None:
        if len(origins) == 1 and origins.tobytes() in self._outside:
            return
        inside = origins[self.contains(origins)]
        for shape in self.shapes if len(inside) else ():
            if np.any(shape.contains(inside)):
                raise ArgumentError(
                    f"an origin lies inside the shape of link {shape.link!r} (margin {self.margin:g} m); "
                    "if that link carries the camera or laser, name it in robot.toml, [self_filter] ignore"
                )
        if len(origins) == 1:
            self._outside.add(origins.tobytes())


def _may_meet(along: Float, apart: Float, lengths: Float, reach: Float) -> Mask:
    """Conservative mask (n, k) of the segments that may come within `reach` (k,) of a centre; includes all that do.

    With c the vector from a segment's origin to the centre and w the segment, the arguments are w . c,
    |c|^2 - reach^2 and |w|, each (n, k), or 1 in place of n or k.
    """
    # The squared distance of the centre from the line is |c|^2 - (w . c)^2 / |w|^2; compared here without dividing.
    beside = apart * lengths**2 <= along**2
    behind, beyond = along < -reach * lengths, along > (lengths + reach) * lengths
    return np.asarray(beside & ~behind & ~beyond)


def _box(columns: Float) -> tuple[Float, Float]:
    """Minimum and maximum (3,) of the rows of an array (3, n), ignoring NaN."""
    return np.fmin.reduce(columns, axis=1), np.fmax.reduce(columns, axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class PlacedShape:
    """Collision shape of a link, placed in `base_link` or in the filter's other frame.

    Attributes:
        link: name of the link.
        kind: "box", "cylinder" (axis z) or "sphere".
        half: (3,) half extents along the shape's own axes, margin included [m]; x and y of a cylinder, and all three of
            a sphere, are the radius.
        centre: (3,) position in that frame [m].
        rotation: (3, 3) rotation from the shape's axes to that frame.
        reach: radius of the bounding sphere [m].
    """

    link: str
    kind: str
    half: Float
    centre: Float
    rotation: Float
    reach: float

    def contains(self, points_in_base: Float) -> Mask:
        """Mask of the points (n, 3) that lie inside."""
        local = (points_in_base - self.centre) @ self.rotation
        if self.kind == "box":
            return np.asarray(np.all(np.abs(local) <= self.half, axis=1))
        if self.kind == "cylinder":
            within = np.einsum("ni,ni->n", local[:, :2], local[:, :2]) <= self.half[0] ** 2
            return np.asarray(within & (np.abs(local[:, 2]) <= self.half[2]))
        return np.asarray(np.einsum("ni,ni->n", local, local) <= self.half[0] ** 2)

    def blocks(self, origins: Float, directions: Float) -> Mask:
        """Mask of the segments that meet the shape, from `origins` (n or 1, 3) along `directions` (n, 3) [m]."""
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
    """Place a shape of the URDF at its pose on the robot, enlarged by a margin [m]."""
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
    """Entry and exit of rays through the slabs |x_i| <= half_i of all axes, as fractions of their length."""
    direction = np.where(along == 0.0, NO_DIRECTION, along)
    with np.errstate(over="ignore"):
        one, other = (-half - start) / direction, (half - start) / direction
    return np.minimum(one, other).max(axis=1), np.maximum(one, other).min(axis=1)


def _through_round(start: Float, along: Float, radius: float, *, flat: bool) -> tuple[Float, Float]:
    """Entry and exit of rays through a sphere or (flat) an infinite cylinder about z; entry > exit for a miss."""
    used = slice(0, 2) if flat else slice(0, 3)
    a = np.einsum("ni,ni->n", along[:, used], along[:, used])
    b = np.einsum("ni,ni->n", np.broadcast_to(start, along.shape)[:, used], along[:, used])
    c = np.einsum("ni,ni->n", start[:, used], start[:, used]) - radius**2
    root = b * b - a * c
    a = np.where(a == 0.0, NO_DIRECTION, a)
    with np.errstate(over="ignore", invalid="ignore"):
        half_chord = np.sqrt(np.maximum(root, 0.0))
        enter, leave = (-b - half_chord) / a, (-b + half_chord) / a
    # A ray parallel to the cylinder's axis is inside everywhere or nowhere.
    along_axis = a == NO_DIRECTION
    enter = np.where(along_axis, np.where(c <= 0.0, -np.inf, np.inf), enter)
    leave = np.where(along_axis, np.where(c <= 0.0, np.inf, -np.inf), leave)
    return np.where(root < 0.0, np.inf, enter), np.where(root < 0.0, -np.inf, leave)
