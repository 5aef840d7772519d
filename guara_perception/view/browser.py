"""3-D view of a walk in the browser, with timeline and camera image, for any number of browsers."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from contextlib import AbstractContextManager
from typing import Any

import numpy as np

from guara_perception.arrays import Float
from guara_perception.exceptions import InvalidInput, optional_library
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.view.controls import SHOWN, Controls, cell_text, legend_html, status_text
from guara_perception.view.moment import Moment, Timeline, pose_of
from guara_perception.view.scene_drawing import SceneDrawing
from guara_perception.view.terrain_mesh import met_by_ray, terrain_mesh
from kinematics import RobotModel
from kinematics.transforms import inverse, transform_points
from transport.supervision import supervised

# Initial camera position and target relative to the robot, along the axes of odom [m].
VIEWPOINT, LOOKED_AT = np.array([1.20, -0.95, 0.80]), np.array([0.36, 0.02, 0.06])
# Time per moment during playback.
PLAY_PERIOD_S = 0.7


class BrowserView(AbstractContextManager["BrowserView"]):
    """Web server that shows moments of a walk; use it in a `with` block.

    Example:
        with BrowserView(robot, port=8080) as view:
            view.show_recording(moments)
            stop.wait()
    """

    def __init__(self, robot: RobotModel, port: int) -> None:
        """Start the server, which accepts connections from this machine only.

        Args:
            robot: robot whose shapes are drawn.
            port: port to listen on; if it is in use, the next free one.

        Raises:
            MissingExtra: viser is not installed.
        """
        viser = optional_library("viser", "view", "the view in the browser")
        self._server: Any = viser.ViserServer(host="127.0.0.1", port=port, label="Guará terrain", verbose=False)
        self._lock = threading.RLock()
        self._timeline = Timeline()
        self._viewed_from = np.zeros(3)
        self._drawn: dict[str, tuple[Any, ...]] = {}
        # Clicked point (3,) in odom.
        self._clicked: Float | None = None
        self._halt = threading.Event()
        self._player: threading.Thread | None = None
        self._drawing = SceneDrawing(self._server.scene, robot, self._click)
        self._controls = Controls(self._server.gui, go_to=self._go_to, play=self._play_or_stop, redraw=self._redraw)
        self._look_from(np.zeros(3))

    def __exit__(self, *error: object) -> None:
        """Stop playback and the server."""
        self._halt.set()
        if (player := self._player) is not None:
            player.join()
        self._server.stop()

    @property
    def address(self) -> str:
        """URL of the view."""
        return f"http://{self._server.get_host()}:{self._server.get_port()}"

    def show_recording(self, moments: Sequence[Moment]) -> None:
        """Show recorded moments, beginning with the first.

        Raises:
            InvalidInput: there are no moments.
        """
        if not moments:
            raise InvalidInput("there is nothing to show: the recording contains no grid")
        with self._lock:
            self._timeline.replace(moments)
            self._redraw()

    def add(self, moment: Moment) -> None:
        """Add a moment of a live walk; show it unless an earlier one is selected."""
        with self._lock:
            follow = self._timeline.is_newest
            self._timeline.add(moment)
            if follow:
                self._redraw()
            else:
                self._show_timeline()

    def report(self, text: str, is_stale: bool) -> None:
        """Show a line about the live grid, in red if the grid is stale."""
        with self._lock, self._server.atomic():
            self._controls.live(text, is_stale)
        self._server.flush()

    def _redraw(self) -> None:
        with self._lock, self._server.atomic():
            moment = self._timeline.shown
            if moment is None:
                return
            controls, drawing = self._controls, self._drawing
            grid = self._grid_of(moment)
            shows = {name: controls.shows(name) for name in SHOWN}
            drawing.robot(moment)
            if self._is_other("terrain", grid, controls.colouring.value):
                mesh = terrain_mesh(grid, controls.colouring.value)
                drawing.terrain(grid, mesh)
                controls.describe(status_text(grid), legend_html(mesh))
            for name, draw in (("obstacles", drawing.obstacles), ("regions", drawing.regions)):
                if self._is_other(name, grid, shows[name]):
                    draw(grid, shown=shows[name])
            if self._is_other("stripes", moment.stripes, shows["stripes"]):
                drawing.stripes(moment.stripes() if moment.stripes and shows["stripes"] else [])
            if self._is_other("footholds", moment.footholds, shows["footholds"]):
                drawing.footholds(moment, shown=shows["footholds"])
            drawing.trail(self._timeline.poses(), shown=shows["trail"])
            controls.has_stripes(moment.stripes is not None)
            controls.picture(moment.picture and moment.picture())
            self._explain(grid)
            self._show_timeline()
            self._look_from(moment.transform_footprint_to_odom[:3, 3])
        self._server.flush()

    def _is_other(self, part: str, *of: Any) -> bool:
        """Test whether the data of a part changed since it was last drawn; unnecessary redraws would flicker."""
        before, self._drawn[part] = self._drawn.get(part), of
        return before != of

    def _grid_of(self, moment: Moment) -> TerrainGrid:
        """Grid of the selected extent if the moment has it, otherwise its first grid."""
        return moment.grids.get(self._controls.extent.value, moment.any_grid)

    def _show_timeline(self) -> None:
        playing = self._player is not None
        self._controls.timeline(len(self._timeline), self._timeline.number, playing=playing)

    def _go_to(self, number: int) -> None:
        with self._lock:
            if self._timeline.go_to(number):
                self._redraw()

    def _play_or_stop(self) -> None:
        with self._lock:
            if self._player is not None:
                self._halt.set()
                return
            if self._timeline.is_newest:
                self._timeline.go_to(0)
                self._redraw()
            self._halt.clear()
            self._player = supervised("guara-view-play", self._play)
            self._player.start()
            self._show_timeline()

    def _play(self) -> None:
        while not self._halt.wait(PLAY_PERIOD_S):
            with self._lock:
                self._go_to(self._timeline.number + 1)
                if self._timeline.is_newest:
                    break
        with self._lock:
            self._player = None
            self._show_timeline()

    def _click(self, origin: Float, direction: Float) -> None:
        """Explain the point at which the ray of a click, given in odom, meets the terrain."""
        with self._lock, self._server.atomic():
            moment = self._timeline.shown
            if moment is None:
                return
            grid = self._grid_of(moment)
            pose = pose_of(grid)
            to_grid = inverse(pose)
            met = met_by_ray(grid, transform_points(to_grid, origin), to_grid[:3, :3] @ direction)
            self._clicked = None if met is None else transform_points(pose, met)
            self._explain(grid)

    def _explain(self, grid: TerrainGrid) -> None:
        """Show the explanation of the clicked cell in this grid."""
        point, text = None, None
        if self._clicked is not None:
            point = transform_points(inverse(pose_of(grid)), self._clicked)
            text = cell_text(grid.explain(float(point[0]), float(point[1])))
        self._drawing.cell(grid, point)
        self._controls.cell(text)

    def _look_from(self, position: Float) -> None:
        """Move all cameras with the robot if "follow" is selected, and set the initial camera of later browsers."""
        moved = position - self._viewed_from
        self._viewed_from = position
        if self._controls.follow.value:
            for client in self._server.get_clients().values() if np.any(moved) else ():
                client.camera.position = client.camera.position + moved
        camera = self._server.initial_camera
        camera.position, camera.look_at, camera.up = VIEWPOINT + position, LOOKED_AT + position, (0.0, 0.0, 1.0)
