"""Scene as seen by the simulated camera from one pose, computed once for all stripes."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from guara_perception.arrays import Float, Float32, Mask
from guara_perception.simulation.features import MATERIALS
from guara_perception.simulation.light import Light
from guara_perception.simulation.relief import PolarView, Relief
from kinematics import RobotState
from kinematics.self_filter import place_shape

# Range and resolution of the polar views from camera and laser.
RADIUS_M = 1.3
RADIUS_SPACING_M = 0.001
TANGENTS = 2400
LASER_BEARINGS = 3000
LASER_RADIUS_M = 0.75
SUN_DIRECTION = np.array([0.35, 0.45, 0.82])
# Limits of the texture's factor, because no natural surface varies from black to white.
TEXTURE_RANGE = (0.5, 1.6)
LEG_ALBEDO = (0.30, 0.30, 0.32)
# Edge length of a square of the chessboard, and albedo of black and white squares; printed black is brighter than coal.
SQUARE_M = 0.020
BOARD_ALBEDO = (0.06, 0.75)
# Largest albedo of absorbing material.
DARK_ALBEDO = 0.03
MIRRORED_EXPONENT = 60.0
MIRRORED_GAIN = 6.0


@dataclass(frozen=True, slots=True, eq=False)
class SceneView:
    """Surface point of each pixel (h, w) and its brightness in ambient and laser light.

    Attributes:
        points: (h, w, 3) float32, surface points in the world, relative to `origin`.
        origin: (3,) position in the world at which the laser leaves the mirror [m].
        normals: (h, w, 3) float32, unit normals of the surface.
        reflectance: (h, w) float32, share of red light scattered towards the camera, reduced by vignetting.
        laser_gain: (h, w) float32, red level of each point if it is at the centre of a stripe; 0 in shadow or beside
            the fan.
        ambient: (h, w, 3) float32, BGR grey levels without laser light at nominal exposure.
        is_body: (h, w) bool, pixels that show the robot itself.
    """

    points: Float32
    origin: Float
    normals: Float32
    reflectance: Float32
    laser_gain: Float32
    ambient: Float32
    is_body: Mask


def view_scene(
    relief: Relief,
    rays: Float32,
    transform_camera_to_world: Float,
    beam: tuple[Float, Float],
    body: Body | None,
    light: Light,
) -> SceneView:
    """Compute the view of the scene from one pose of the camera.

    Args:
        relief: the ground.
        rays: (h, w, 3) float32, viewing rays of all pixels in the camera frame, z = 1.
        transform_camera_to_world: (4, 4) pose of the camera.
        beam: point (3,) at which the laser leaves the mirror, and direction (3,) of the mirror axis, in the world.
        body: shapes of the robot in the world, or None.
        light: light and sensor.
    """
    camera, (laser, across) = transform_camera_to_world[:3, 3], beam
    directions = rays @ transform_camera_to_world[:3, :3].T.astype(np.float32)
    points = _ground_points(relief, camera, directions)
    slope = relief.sample(relief.slope, points[..., 0], points[..., 1])
    steepness = 1 / np.sqrt(1 + slope[..., 0] ** 2 + slope[..., 1] ** 2)
    normals = np.dstack((-slope[..., 0] * steepness, -slope[..., 1] * steepness, steepness))
    albedo, shine = _surface(relief, points, normals, light.texture)
    if light.chessboard:
        # The chessboard does not cover absorbing material, so that dark ground stays dark.
        board = np.where(albedo.max(axis=2) > DARK_ALBEDO, _chessboard(points), albedo[..., 0])
        albedo += np.float32(light.chessboard) * (board[..., None] - albedo)
    is_body = np.zeros(points.shape[:2], dtype=bool)
    if body is not None:
        is_body = _add_body(body, camera, directions, points, normals, albedo, shine)
    view = PolarView.around(relief, laser, (-np.pi, np.pi), LASER_BEARINGS, LASER_RADIUS_M, RADIUS_SPACING_M)
    lit = view.sees(points) | is_body
    if body is not None:
        _shade(body, laser, points, lit)
    cosine_camera = (rays[..., 2] / np.sqrt((rays**2).sum(axis=2))).astype(np.float32)
    vignette = cosine_camera ** np.float32(light.vignetting)
    points -= laser.astype(np.float32)
    laser_gain = _laser_gain(points, normals, directions, albedo[..., 0], shine, across, light) * lit * vignette
    sun = np.maximum(normals @ (SUN_DIRECTION / np.linalg.norm(SUN_DIRECTION)).astype(np.float32), 0)
    sky = (1 - light.sun) * (0.6 + 0.4 * normals[..., 2]) + light.sun * sun / np.float32(SUN_DIRECTION[2])
    ambient = albedo[..., ::-1] * (sky * vignette)[..., None] * np.array(light.ambient, dtype=np.float32)
    return SceneView(
        points=points,
        origin=laser,
        normals=normals,
        reflectance=albedo[..., 0] * vignette,
        laser_gain=np.ascontiguousarray(laser_gain, dtype=np.float32),
        ambient=np.ascontiguousarray(ambient, dtype=np.float32),
        is_body=is_body,
    )


def _ground_points(relief: Relief, camera: Float, directions: Float32) -> Float32:
    """Points (h, w, 3) in the world at which the lines of sight meet the ground."""
    horizontal = np.sqrt(directions[..., 0] ** 2 + directions[..., 1] ** 2) + np.float32(1e-9)
    down = np.maximum(-directions[..., 2], np.float32(1e-3))
    tangent = horizontal / down
    # Bearings are computed relative to the image centre, so that they do not wrap around inside the image.
    ahead = directions[directions.shape[0] // 2, directions.shape[1] // 2]
    heading = float(np.arctan2(ahead[1], ahead[0]))
    c, s = np.float32(np.cos(heading)), np.float32(np.sin(heading))
    bearing = np.arctan2(
        c * directions[..., 1] - s * directions[..., 0], c * directions[..., 0] + s * directions[..., 1]
    )
    bearing += np.float32(heading)
    first, last = float(bearing.min()), float(bearing.max())
    count = int(2 * directions.shape[1] * max((last - first) / 2.2, 0.5))
    view = PolarView.around(relief, camera, (first, last), count, RADIUS_M, RADIUS_SPACING_M)
    radius = view.meets(bearing, tangent, TANGENTS)
    points = directions * (radius / horizontal)[..., None]
    points += camera.astype(np.float32)
    return points


def _surface(relief: Relief, points: Float32, normals: Float32, contrast: float) -> tuple[Float32, Float32]:
    """Albedo (h, w, 3) in red, green, blue, and shine (h, w); for a point on a wall, sampled just behind its face."""
    behind = np.float32(0.0015) * (1 - normals[..., 2])
    x = points[..., 0] - behind * normals[..., 0]
    y = points[..., 1] - behind * normals[..., 1]
    index = relief.sample(relief.material, x, y, cv2.INTER_NEAREST)
    rows = ((material.albedo, material.shine, material.texture) for material in MATERIALS)
    albedo, shine, depth = (np.array(values, dtype=np.float32)[index] for values in zip(*rows, strict=True))
    texture = relief.sample_texture(x + points[..., 2], y - points[..., 2])
    mottled = np.clip(1 + np.float32(contrast) * depth * texture, *TEXTURE_RANGE)
    return np.clip(albedo * mottled[..., None], 0, 1).astype(np.float32), shine


def _chessboard(points: Float32) -> Float32:
    """Albedo (h, w) of a chessboard of black and white cubes, which shows squares on walls too."""
    square = np.floor(points / np.float32(SQUARE_M) + np.float32(1e-3)).astype(np.int64)
    return np.where(square.sum(axis=2) % 2 == 0, BOARD_ALBEDO[0], BOARD_ALBEDO[1]).astype(np.float32)


def _laser_gain(
    points: Float32, normals: Float32, directions: Float32, albedo: Float32, shine: Float32, across: Float, light: Light
) -> Float32:
    """Grey level of the stripe's centre at each point, from diffuse and specular reflection.

    The points are relative to the laser.
    """
    distance = np.sqrt((points**2).sum(axis=2)) + np.float32(1e-6)
    cosine = np.maximum(-(points * normals).sum(axis=2) / distance, 0)
    scattered = albedo * cosine
    shiny = shine > 0
    if shiny.any():
        arriving, normal = points[shiny] / distance[shiny][:, None], normals[shiny]
        leaving = arriving - 2 * (arriving * normal).sum(axis=1)[:, None] * normal
        towards = -directions[shiny] / np.linalg.norm(directions[shiny], axis=1)[:, None]
        lobe = np.maximum((leaving * towards).sum(axis=1), 0) ** np.float32(MIRRORED_EXPONENT)
        scattered[shiny] += shine[shiny] * np.float32(MIRRORED_GAIN) * lobe * (cosine[shiny] > 0)
    beside = np.abs(points @ across.astype(np.float32)) <= np.float32(np.sin(light.fan)) * distance
    # The fan spreads the laser in one direction only, so the light decreases as 1 / distance, not 1 / distance^2.
    return np.asarray(np.float32(light.laser * 0.5) * scattered * beside / distance, dtype=np.float32)


def _add_body(
    body: Body, camera: Float, directions: Float32, points: Float32, normals: Float32, albedo: Float32, shine: Float32
) -> Mask:
    """Draw the robot's shapes in front of the ground, in place; return the mask of their pixels."""
    is_body = np.zeros(directions.shape[:2], dtype=bool)
    share = ((points - camera.astype(np.float32)) * directions).sum(axis=2) / (directions**2).sum(axis=2)
    directions, points, normals, albedo = (array.reshape(-1, 3) for array in (directions, points, normals, albedo))
    lowest, highest = directions.min(axis=0), directions.max(axis=0)
    for number, corners in enumerate(body.corners()):
        # Cheap tests skip boxes above the camera or outside the cone of all lines of sight.
        towards = corners - camera
        depth = -towards[:, 2]
        if depth.max() <= 0.01:
            continue
        scaled = towards[:, :2] / np.maximum(depth, 0.01)[:, None]
        bounds = np.array([lowest[:2], highest[:2]]) / np.maximum(-highest[2], 0.05)
        if (scaled.max(axis=0) < bounds[0]).any() or (scaled.min(axis=0) > bounds[1]).any():
            continue
        enter, axis = body.meets(number, camera, directions)
        nearer = np.flatnonzero(enter < share.ravel())
        if not nearer.size:
            continue
        chosen = directions[nearer]
        points[nearer] = chosen * enter[nearer, None] + camera.astype(np.float32)
        normals[nearer] = body.normal(number, axis[nearer], chosen)
        albedo[nearer] = LEG_ALBEDO
        shine.ravel()[nearer] = 0
        share.ravel()[nearer] = enter[nearer]
        is_body.ravel()[nearer] = True
    return is_body


def _shade(body: Body, laser: Float, points: Float32, lit: Mask) -> None:
    """Clear `lit`, in place, where the robot's shapes cast a shadow."""
    flat, is_lit = points.reshape(-1, 3), lit.reshape(-1)
    floor = float(points[..., 2].min())
    x, y = np.ascontiguousarray(flat[:, 0]), np.ascontiguousarray(flat[:, 1])
    seen_low, seen_high = np.array([x.min(), y.min()]), np.array([x.max(), y.max()])
    for number, corners in enumerate(body.corners()):
        depth = laser[2] - corners[:, 2]
        if depth.max() <= 0.01:
            continue
        # The shadow on the lowest ground contains the shadow on all higher ground.
        stretch = np.maximum((laser[2] - floor) / np.maximum(depth, 0.01), 1.0)
        shadow = np.vstack((corners[:, :2], laser[:2] + (corners[:, :2] - laser[:2]) * stretch[:, None]))
        low, high = shadow.min(axis=0), shadow.max(axis=0)
        if (low > seen_high).any() or (high < seen_low).any():
            continue
        inside = np.flatnonzero((x >= low[0]) & (x <= high[0]) & (y >= low[1]) & (y <= high[1]) & is_lit)
        if not inside.size:
            continue
        enter, _ = body.meets(number, laser, flat[inside] - laser.astype(np.float32))
        # A ray to a point on the shape itself meets the shape at that point, which is lit.
        is_lit[inside[enter < np.float32(0.995)]] = False


class Body:
    """Boxes that bound the robot's collision shapes, posed by forward kinematics."""

    def __init__(self, state: RobotState, transform_base_to_world: Float) -> None:
        """Place the boxes.

        Args:
            state: forward kinematics of the joint positions.
            transform_base_to_world: (4, 4) pose of the body.
        """
        self._boxes = tuple(
            place_shape(shape, name, transform_base_to_world @ state.transform_to_base(name), 0.0)
            for name, link in state.tree.links.items()
            for shape in link.shapes
        )

    def corners(self) -> Float:
        """Corners (n, 8, 3) of all boxes in the world."""
        signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
        return np.array([signs * box.half @ box.rotation.T + box.centre for box in self._boxes])

    def meets(self, number: int, viewpoint: Float, directions: Float32) -> tuple[Float32, npt.NDArray[np.int8]]:
        """Intersect lines from a viewpoint with one box.

        Args:
            number: number of the box.
            viewpoint: (3,) position in the world [m].
            directions: (n, 3) directions of the lines, of any length.

        Returns:
            Distance (n,) from the viewpoint to the box, as a multiple of the line's direction vector, inf for a line
            that misses the box; and axis (n,), 0, 1 or 2, of the face through which the line enters.
        """
        box = self._boxes[number]
        start, along = (viewpoint - box.centre) @ box.rotation, directions @ box.rotation.astype(np.float32)
        with np.errstate(divide="ignore", invalid="ignore"):
            one, other = (((side - start) / along).astype(np.float32) for side in (-box.half, box.half))
        near, far = np.minimum(one, other), np.maximum(one, other)
        enter = near.max(axis=1)
        hit = (enter <= far.min(axis=1)) & (enter > 0)
        return np.where(hit, enter, np.float32(np.inf)), near.argmax(axis=1).astype(np.int8)

    def normal(self, number: int, axis: npt.NDArray[np.int8], directions: Float32) -> Float32:
        """Unit normals (n, 3), in world axes and towards the viewpoint, of the faces that lines (n, 3) enter."""
        normals = self._boxes[number].rotation.astype(np.float32).T[axis]
        facing = np.sign(np.einsum("ni,ni->n", normals, directions))
        return np.asarray(-facing[:, None] * normals)
