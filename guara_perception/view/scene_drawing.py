"""Drawing of robot, terrain and plans of one moment in a viser scene, with odom as its frame."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from guara_perception.arrays import Float
from guara_perception.terrain.drawing.style import HAZARD_COLOURS, rgb
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.layers.hazard import Hazard
from guara_perception.view.moment import Moment, pose_of
from guara_perception.view.robot_looks import Colour, visual_shapes
from guara_perception.view.terrain_mesh import TerrainMesh
from kinematics import RobotModel
from kinematics.urdf import Shape

STRIPE_COLOUR, FOOTHOLD_COLOUR, TRAIL_COLOUR, CELL_COLOUR = (230, 20, 60), (0, 114, 178), (120, 40, 120), (0, 0, 0)
REGION_COLOUR = (0, 89, 61)
HOLE_COLOUR, OBSTACLE_COLOUR = (122, 31, 31), tuple(round(255 * value) for value in rgb(HAZARD_COLOURS[Hazard.STEP]))
SOLE_THICKNESS_M = 0.004
# Height of lines above the ground [m].
LIFT_M = 0.002
LINE_PX = 2.0
# Tolerance of simplified outlines, slightly more than a cell of the default grid [m].
OUTLINE_M = 0.006
# Size of the points of stripes [m], largest number of points drawn, and their height above the ground [m].
STRIPE_SIZE_M, STRIPE_POINTS, STRIPE_LIFT_M = 0.0007, 12_000, 0.001
EVEN_LIGHT = 2.2
# Height of the reference grid, below the ground that the legs can reach [m].
GROUND_M = -0.09

Picked = Callable[[Float, Float], None]


class SceneDrawing:
    """Drawing of moments in one viser scene.

    The shapes of the robot are sent once, and its pose with every moment.
    """

    def __init__(self, scene: Any, robot: RobotModel, picked: Picked) -> None:
        """Set up light, ground and the robot.

        Args:
            scene: `scene` of viser, to which nodes are added.
            robot: robot whose shapes are drawn.
            picked: called when the terrain is clicked, with origin and direction (3,) of the view ray in odom.
        """
        self._scene, self._robot, self._picked = scene, robot, picked
        scene.set_up_direction("+z")
        # No environment map, because it would be fetched from the network.
        scene.configure_environment_map(None)
        # Even light without shadows, so that colours match the legend.
        scene.configure_default_lights(enabled=False, cast_shadow=False)
        scene.add_light_ambient("/light/all", intensity=EVEN_LIGHT)
        scene.add_light_directional("/light/above", intensity=1.2, position=(-1.0, -2.0, 4.0), cast_shadow=False)
        scene.add_grid(
            "/ground",
            40.0,
            40.0,
            cell_size=0.1,
            cell_color=(226, 228, 232),
            section_size=0.5,
            section_color=(196, 200, 208),
            position=(0.0, 0.0, GROUND_M),
            fade_distance=7.0,
        )
        self._footprint = scene.add_frame("/odom/footprint", show_axes=False)
        self._body = scene.add_frame("/odom/footprint/robot", show_axes=False, visible=False)
        self._links: dict[str, Any] = {}
        for link, visuals in visual_shapes(robot).items():
            self._links[link] = scene.add_frame(f"/odom/footprint/robot/{link}", show_axes=False)
            for number, visual in enumerate(visuals):
                self._add_shape(f"/odom/footprint/robot/{link}/{number}", *visual)

    def robot(self, moment: Moment) -> None:
        """Draw the robot in its stance, at its pose in odom; hide it if the moment has no joint positions."""
        _set_pose(self._footprint, moment.transform_footprint_to_odom)
        joints = moment.joint_positions
        self._body.visible = joints is not None
        if joints is None:
            return
        _set_pose(self._body, moment.transform_base_to_footprint)
        state = self._robot.state(joints)
        for link, frame in self._links.items():
            _set_pose(frame, state.transform_to_base(link))

    def terrain(self, terrain: TerrainGrid, mesh: TerrainMesh) -> None:
        """Draw a grid at its pose in odom, and report clicks on it."""
        self._scene.remove_by_name("/odom/terrain")
        if not len(mesh.faces):
            return
        handle = self._scene.add_mesh_trimesh("/odom/terrain", textured(mesh), cast_shadow=False, receive_shadow=False)
        _set_pose(handle, pose_of(terrain))

        @handle.on_click
        def click(event: Any) -> None:
            self._picked(np.array(event.ray_origin), np.array(event.ray_direction))

    def stripes(self, stripes: Sequence[Float]) -> None:
        """Draw the measured points (n, 3) of each stripe, given in base_footprint."""
        name = "/odom/footprint/stripes"
        self._scene.remove_by_name(name)
        points = [stripe[np.isfinite(stripe).all(axis=1)] for stripe in stripes]
        if sum(map(len, points)):
            cloud = np.vstack(points)
            cloud = cloud[:: -(-len(cloud) // STRIPE_POINTS)] + [0.0, 0.0, STRIPE_LIFT_M]
            self._scene.add_point_cloud(name, cloud, STRIPE_COLOUR, point_size=STRIPE_SIZE_M, point_shape="circle")

    def footholds(self, moment: Moment, *, shown: bool) -> None:
        """Draw a sole at each planned foothold."""
        name = "/odom/footprint/footholds"
        self._scene.remove_by_name(name)
        length, width = self._robot.sole
        for leg, (x, y, z) in moment.footholds.items() if shown else ():
            position, size = (x, y, z + SOLE_THICKNESS_M), (length, width, SOLE_THICKNESS_M)
            self._scene.add_box(f"{name}/{leg}", FOOTHOLD_COLOUR, size, position=position, opacity=0.8)
            self._scene.add_label(f"{name}/{leg}/name", leg, position=(0.0, 0.0, 0.02), anchor="bottom-center")

    def obstacles(self, terrain: TerrainGrid, *, shown: bool) -> None:
        """Draw each obstacle of a grid as a prism, labelled with its height."""
        name = "/odom/obstacles"
        self._renew(name, terrain)
        for number, obstacle in enumerate(terrain.obstacles() if shown else ()):
            top, height = float(obstacle.position[2]), obstacle.height
            colour = OBSTACLE_COLOUR if height > 0 else HOLE_COLOUR
            self._lines(f"{name}/{number}", prism(simplify(obstacle.outline), top - height, top + LIFT_M), colour)
            position = obstacle.position + (0.0, 0.0, 0.015)
            text = f"{1e3 * height:+.0f} mm"
            self._scene.add_label(f"{name}/{number}/height", text, position=position, anchor="bottom-center")

    def regions(self, terrain: TerrainGrid, *, shown: bool) -> None:
        """Draw the outlines of the steppable regions of a grid."""
        name = "/odom/regions"
        self._renew(name, terrain)
        if found := terrain.steppable_regions() if shown else []:
            lines = np.concatenate([outline(region.vertices) for region in found])
            self._lines(f"{name}/outlines", lines, REGION_COLOUR, 2 * LINE_PX)

    def trail(self, poses: Sequence[Float], *, shown: bool) -> None:
        """Draw the track of the body, from poses (4, 4) of base_footprint in odom, with a tick at each pause."""
        self._scene.remove_by_name("/odom/trail")
        if shown and len(poses) > 1:
            self._lines("/odom/trail", track(poses), TRAIL_COLOUR, 2 * LINE_PX)

    def cell(self, terrain: TerrainGrid, point: Float | None) -> None:
        """Mark a point (3,) of a grid with a square and a pin; None removes the mark."""
        name = "/odom/cell"
        self._renew(name, terrain)
        if point is None:
            return
        half, (x, y, z) = terrain.resolution, point
        corners = np.array([(x + i * half, y + j * half) for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
        pin = np.array([[(x, y, z), (x, y, z + 0.06)]])
        lines = np.concatenate((prism(corners, z + LIFT_M, z + 2 * LIFT_M), pin))
        self._lines(f"{name}/pin", lines, CELL_COLOUR)

    def _add_shape(self, name: str, shape: Shape, colour: Colour) -> None:
        """Add a shape of a link below the frame of the link."""
        size, looks = shape.size, {"color": tuple(round(255 * value) for value in colour), "flat_shading": True}
        shadows = {"cast_shadow": False, "receive_shadow": False}
        if shape.kind == "box":
            handle = self._scene.add_box(name, dimensions=size, **looks, **shadows)
        elif shape.kind == "cylinder":
            handle = self._scene.add_cylinder(name, *size, **looks, **shadows)
        else:
            handle = self._scene.add_icosphere(name, *size, **looks, **shadows)
        _set_pose(handle, shape.transform_shape_to_link)

    def _renew(self, name: str, terrain: TerrainGrid) -> None:
        """Replace a node by an empty frame at the pose of a grid."""
        self._scene.remove_by_name(name)
        _set_pose(self._scene.add_frame(name, show_axes=False), pose_of(terrain))

    def _lines(self, name: str, lines: Float, colour: tuple[int, ...], width: float = LINE_PX) -> None:
        self._scene.add_line_segments(name, lines, colour, thickness=width, thickness_units="screen")


def simplify(outline: Float) -> Float:
    """Simplify an outline (n, 2) of cell edges to corners (m, 2), with a deviation of at most OUTLINE_M."""
    import cv2

    corners = cv2.approxPolyDP(outline.astype(np.float32)[:, None], OUTLINE_M, closed=True)[:, 0]
    return np.asarray(corners if len(corners) > 2 else outline, dtype=np.float64)


def prism(outline: Float, bottom: float, top: float) -> Float:
    """Edges (3 n, 2, 3) of an upright prism over an outline (n, 2), which does not repeat its first corner."""
    following = np.roll(outline, -1, axis=0)
    rings = [
        np.stack([np.column_stack((ends, np.full(len(ends), z))) for ends in (outline, following)], axis=1)
        for z in (bottom, top)
    ]
    upright = np.stack([ring[:, 0] for ring in rings], axis=1)
    return np.concatenate((*rings, upright)).astype(np.float32)


def outline(corners: Float) -> Float:
    """Sides (n, 2, 3) of a polygon (n, 3), raised by LIFT_M."""
    lifted = corners + [0, 0, LIFT_M]
    return np.stack((lifted, np.roll(lifted, -1, axis=0)), axis=1).astype(np.float32)


def track(poses: Sequence[Float]) -> Float:
    """Lines (n, 2, 3) in odom that connect poses (4, 4), with a tick across each pose."""
    centres = np.array([pose[:3, 3] for pose in poses]) + [0, 0, LIFT_M]
    across = np.array([pose[:3, 1] for pose in poses]) * 0.015
    ticks = np.stack((centres - across, centres + across), axis=1)
    return np.concatenate((np.stack((centres[:-1], centres[1:]), axis=1), ticks)).astype(np.float32)


def textured(mesh: TerrainMesh) -> Any:
    """Convert a mesh for viser, with its colours as a texture because viser renders vertex colours too dark."""
    import trimesh
    from PIL import Image

    material = trimesh.visual.material.PBRMaterial(
        baseColorTexture=Image.fromarray(mesh.picture), metallicFactor=0.0, roughnessFactor=1.0, doubleSided=True
    )
    visual = trimesh.visual.TextureVisuals(uv=mesh.texture_positions, material=material)
    return trimesh.Trimesh(mesh.vertices, mesh.faces, visual=visual, process=False)


def _set_pose(handle: Any, transform: Float) -> None:
    """Set the pose of a node from the transform (4, 4) to its parent."""
    from scipy.spatial.transform import Rotation

    handle.position = transform[:3, 3]
    handle.wxyz = Rotation.from_matrix(transform[:3, :3]).as_quat(scalar_first=True)
