"""The view in the browser: robot, terrain, stripes and footholds in 3-D, served to any number of browsers."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from guara_perception.exceptions import InvalidInput
from guara_perception.extras import optional_library
from guara_perception.terrain.drawing.style import rgb
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.layers.hazard import MEANING, Hazard
from guara_perception.view.moment import Moment
from guara_perception.view.robot_looks import robot_looks
from guara_perception.view.terrain_mesh import COLOURINGS, TerrainMesh, terrain_mesh

if TYPE_CHECKING:
    from kinematics import RobotModel

STRIPE_COLOUR, FOOTHOLD_COLOUR = (213, 94, 0), (0, 114, 178)
SOLE_THICKNESS_M = 0.004
EVEN_LIGHT = 2.6
FIRST_LOOK = {"position": (1.45, -0.8, 0.65), "look_at": (0.40, 0.08, 0.0)}


class BrowserView:
    """A small web server that shows moments of a walk; use it in a `with` block.

    Example:
        with BrowserView(robot, port=8080) as view:
            view.show_recording(moments)
            view.wait(stop)
    """

    def __init__(self, robot: RobotModel, *, host: str = "127.0.0.1", port: int = 8080) -> None:
        """Start to serve.

        Args:
            robot: whose shapes are drawn.
            host: address to listen at; only this machine by default.
            port: to listen at; when it is taken, the next free one.

        Raises:
            MissingExtra: viser is not installed.
        """
        viser = optional_library("viser", "view", "the view in the browser")
        self._robot = robot
        self._server: Any = viser.ViserServer(host=host, port=port, label="Guará terrain", verbose=False)
        self._lock = threading.RLock()
        self._moments: list[Moment] = []
        self._shown: Moment | None = None
        self._prepare_scene()
        self._prepare_controls()

    def __enter__(self) -> Self:
        """The view itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Stop serving."""
        self.close()

    @property
    def address(self) -> str:
        """What to open in a browser."""
        return f"http://{self._server.get_host()}:{self._server.get_port()}"

    def show_recording(self, moments: Sequence[Moment]) -> None:
        """Show moments with a slider to go through them.

        Raises:
            InvalidInput: there are none.
        """
        if not moments:
            raise InvalidInput("there is nothing to show: the recording holds no grid")
        with self._lock:
            self._moments = list(moments)
            self._slider.max = max(len(moments) - 1, 1)
            self._slider.visible = len(moments) > 1
            self._slider.value = 0
            self.show(moments[0])

    def show(self, moment: Moment) -> None:
        """Show one moment; in live mode, call it with every new one."""
        with self._lock, self._server.atomic():
            self._shown = moment
            self._draw_robot(moment)
            self._draw_terrain(moment)
            self._draw_stripes(moment)
            self._draw_footholds(moment)
            self._status.content = status_text(self._grid_of(moment))
        self._server.flush()

    def close(self) -> None:
        """Stop serving."""
        self._server.stop()

    def _prepare_scene(self) -> None:
        scene = self._server.scene
        scene.set_up_direction("+z")
        # No pictures of surroundings: they would be fetched from elsewhere.
        scene.configure_environment_map(None)
        # Even light without shadows: a colour on the ground is that of the legend.
        scene.configure_default_lights(enabled=False, cast_shadow=False)
        scene.add_light_ambient("/light/all", intensity=EVEN_LIGHT)
        scene.add_light_directional("/light/above", intensity=0.6, position=(-1.0, -2.0, 4.0), cast_shadow=False)
        scene.add_grid("/ground", width=4.0, height=4.0, cell_size=0.1, section_size=0.5, position=(0.4, 0.0, -0.09))
        self._server.initial_camera.position = FIRST_LOOK["position"]
        self._server.initial_camera.look_at = FIRST_LOOK["look_at"]
        self._server.initial_camera.up = (0.0, 0.0, 1.0)

    def _prepare_controls(self) -> None:
        gui = self._server.gui
        self._slider = gui.add_slider("pause", min=0, max=1, step=1, initial_value=0, visible=False)
        self._colouring = gui.add_dropdown("colour", COLOURINGS, initial_value="hazard")
        self._extent = gui.add_dropdown("terrain", ("map", "footprint"), initial_value="map")
        self._with_stripes = gui.add_checkbox("stripes", initial_value=True)
        self._with_footholds = gui.add_checkbox("footholds", initial_value=True)
        self._status = gui.add_markdown("waiting for a scan")
        self._legend = gui.add_html("")

        def choose(_: Any) -> None:
            with self._lock:
                if self._moments:
                    self.show(self._moments[min(int(self._slider.value), len(self._moments) - 1)])

        def redraw(_: Any) -> None:
            with self._lock:
                if self._shown is not None:
                    self.show(self._shown)

        self._slider.on_update(choose)
        for control in (self._colouring, self._extent, self._with_stripes, self._with_footholds):
            control.on_update(redraw)

    def _grid_of(self, moment: Moment) -> TerrainGrid:
        """The grid that is chosen, or the other one where there is no such."""
        return moment.grids.get(self._extent.value, moment.any_grid)

    def _draw_robot(self, moment: Moment) -> None:
        joints = moment.joint_positions
        if joints is None:
            return
        state = self._robot.state(joints)
        for link, looks in robot_looks(self._robot).items():
            transform = moment.transform_base_to_footprint @ state.transform_to_base(link)
            for number, look in enumerate(looks):
                placed = look.vertices @ transform[:3, :3].T + transform[:3, 3]
                colour = tuple(round(255 * part) for part in look.colour)
                self._server.scene.add_mesh_simple(
                    f"/robot/{link}/{number}", placed, look.faces, color=colour, flat_shading=True, side="double"
                )

    def _draw_terrain(self, moment: Moment) -> None:
        mesh = terrain_mesh(self._grid_of(moment), self._colouring.value)
        self._server.scene.remove_by_name("/terrain")
        if len(mesh.faces):
            self._server.scene.add_mesh_trimesh("/terrain", textured(mesh), cast_shadow=False, receive_shadow=False)
        self._legend.content = legend_html(mesh.legend)

    def _draw_stripes(self, moment: Moment) -> None:
        self._server.scene.remove_by_name("/stripes")
        stripes = moment.stripes() if self._with_stripes.value else []
        points = [stripe[np.isfinite(stripe).all(axis=1)] for stripe in stripes]
        if sum(map(len, points)):
            self._server.scene.add_point_cloud(
                "/stripes", np.vstack(points) + [0, 0, 0.001], STRIPE_COLOUR, point_size=0.0012, point_shape="circle"
            )

    def _draw_footholds(self, moment: Moment) -> None:
        self._server.scene.remove_by_name("/footholds")
        if not self._with_footholds.value:
            return
        length, width = self._robot.sole
        for leg, (x, y, z) in moment.footholds.items():
            position = (x, y, z + SOLE_THICKNESS_M)
            size = (length, width, SOLE_THICKNESS_M)
            self._server.scene.add_box(f"/footholds/{leg}", FOOTHOLD_COLOUR, size, position=position, opacity=0.8)
            self._server.scene.add_label(f"/footholds/{leg}/name", leg, position=(0.0, 0.0, 0.02))


def textured(mesh: TerrainMesh) -> Any:
    """A mesh for viser, its colours as a texture: those come out as they are, vertex colours would be darker."""
    import trimesh
    from PIL import Image

    material = trimesh.visual.material.PBRMaterial(
        baseColorTexture=Image.fromarray(mesh.picture), metallicFactor=0.0, roughnessFactor=1.0, doubleSided=True
    )
    visual = trimesh.visual.TextureVisuals(uv=mesh.texture_positions, material=material)
    return trimesh.Trimesh(mesh.vertices, mesh.faces, visual=visual, process=False)


def status_text(terrain: TerrainGrid) -> str:
    """What is to be said of a grid, in a few lines of Markdown."""
    data = terrain.metadata
    lines = [f"**step {terrain.step}**, {data.get('mode', 'unknown')} scan, {terrain.extent}"]
    known, free = float(np.isfinite(terrain.elevation).mean()), float((terrain.traversability > 0).mean())
    lines.append(f"known {known:.0%}, traversable {free:.0%}")
    if "attitude_source" in data:
        lines.append(f"attitude from {data['attitude_source']}")
    health = data.get("health") or {}
    lines += [str(reason) for reason in health.get("reasons", ())]
    return "  \n".join(lines)


def legend_html(legend: Sequence[tuple[str, str]]) -> str:
    """Names and colours of hazards as a small table."""
    rows = []
    for name, colour in legend:
        meaning = "a foot may be set here" if name == "free" else MEANING[Hazard[name.upper()]]
        red, green, blue = (round(255 * part) for part in rgb(colour))
        box = f'<span style="display:inline-block;width:1em;height:1em;background:rgb({red},{green},{blue})"></span>'
        rows.append(f"<div>{box} <b>{name}</b>: {meaning}</div>")
    return f'<div style="font-size:0.75em;padding:0 1em">{"".join(rows)}</div>'
