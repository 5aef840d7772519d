"""Top-view picture and animation of a crossing: true ground, ground known to the robot, feet and body."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from guara_perception.arrays import Array, Float, Image
from guara_perception.files import whole_file
from guara_perception.simulation.world import World
from guara_perception.terrain.drawing.style import FREE_COLOUR, LINE_COLOURS, UNKNOWN_COLOUR, new_figure, save_figure
from kinematics.transforms import inverse, transform_points

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from guara_perception.app.demo.walk import DemoPause

CELL_M, BEFORE_M, BEYOND_M, ASIDE_M = 0.005, 0.45, 0.55, 0.30
# Height difference per cell above which a rim is drawn [m]. Central differences halve an isolated step, so it must be
# twice as high.
RIM_M = 0.005
UNKNOWN, REFUSED, FREE = 0, 1, 2
COLOURS = {"unknown": UNKNOWN_COLOUR, "refused": "#F2B79B", "free": FREE_COLOUR}
LEG_COLOURS = dict(zip(("lf", "rf", "lh", "rh"), LINE_COLOURS, strict=False))
FRAME_MS, FILM_DOTS_PER_INCH = 250, 90


class CourseDrawing:
    """Drawing of a course, and of the ground known to the robot while it walks along x.

    Attributes:
        cells: (ny, nx, 3) centres of the drawn cells in the world, with z = 0 [m].
    """

    def __init__(self, world: World, start: float, goal: float) -> None:
        """Start with unknown ground. The drawing extends from before x = `start` to beyond x = `goal` [m]."""
        self._x, self._y = np.arange(start - BEFORE_M, goal + BEYOND_M, CELL_M), np.arange(-ASIDE_M, ASIDE_M, CELL_M)
        self.cells = np.stack([*np.meshgrid(self._x, self._y), np.zeros((self._y.size, self._x.size))], axis=-1)
        heights = world.height(self.cells[..., 0], self.cells[..., 1])
        self._rims = np.hypot(*np.gradient(heights)) > RIM_M
        self._known = np.full(heights.shape, UNKNOWN)
        self._feet: list[tuple[str, float, float]] = []
        self._bodies: list[Float] = []

    def know(self, inside: Array, is_free: Array, is_unknown: Array) -> None:
        """Update the known ground with a map.

        Args:
            inside: (ny, nx) mask of the cells that are inside the map.
            is_free: (ny, nx) mask of the traversable cells.
            is_unknown: (ny, nx) mask of the unknown cells.
        """
        self._known = np.where(inside, np.where(is_free, FREE, np.where(is_unknown, UNKNOWN, REFUSED)), self._known)

    def step(self, leg: str, sole: Float, body: Float) -> None:
        """Add a footstep: the positions of the sole of a leg and of the body, in the world [m]."""
        self._feet.append((leg, float(sole[0]), float(sole[1])))
        self._bodies.append(body)

    def figure(self, title: str) -> Figure:
        """Draw the ground and the footsteps so far, with x to the right and y upwards."""
        from matplotlib.colors import ListedColormap
        from matplotlib.patches import Patch

        figure, ((axes,),) = new_figure(size=(10, 3.6))
        extent = (self._x[0], self._x[-1], self._y[0], self._y[-1])
        axes.imshow(
            self._known, origin="lower", extent=extent, cmap=ListedColormap([*COLOURS.values()]), vmin=0, vmax=2
        )
        axes.contour(self._x, self._y, self._rims, levels=[0.5], colors="black", linewidths=0.8)
        if self._bodies:
            axes.plot(*np.array(self._bodies)[:, :2].T, color="0.3", linewidth=0.8, linestyle=":")
        handles = []
        for leg, colour in LEG_COLOURS.items():
            places = np.array([(x, y) for name, x, y in self._feet if name == leg]).reshape(-1, 2)
            handles += axes.plot(*places.T, "o", color=colour, markersize=7, markeredgecolor="white", label=leg)
            axes.plot(*places[-1:].T, "o", color=colour, markersize=12, markeredgecolor="black", zorder=3)
        handles += [Patch(color=colour, label=name) for name, colour in COLOURS.items()]
        axes.set(title=title, xlabel="x [m]", ylabel="y [m]", xlim=extent[:2], ylim=extent[2:])
        figure.legend(handles=handles, ncols=7, loc="outside lower center", frameon=False)
        return figure


def draw_course(folder: Path, world: World, goal: float, pauses: Sequence[DemoPause]) -> list[Path]:
    """Draw a crossing to crossing.png, and to crossing.gif with a frame for each pause; return the paths."""
    from PIL import Image

    start = min(feature.bounds[0] for feature in world.features)
    drawing, frames = CourseDrawing(world, start, goal), []
    for item in pauses:
        pause, fused = item.pause, item.fused
        x, y, _ = np.moveaxis(transform_points(inverse(pause.transform_footprint_to_world), drawing.cells), -1, 0)
        drawing.know(
            fused.geometry.contains(*fused.geometry.indices(x, y)),
            fused.is_traversable(x, y),
            np.isnan(fused.height_at(x, y)),
        )
        moved = pause.soles_in_world if pause.last_footstep is None else [pause.last_footstep.leg]
        for leg in moved:
            drawing.step(leg, pause.soles_in_world[leg], pause.transform_base_to_world[:3, 3])
        figure = drawing.figure(f"Crossing planned on the laser map, step {pause.step}")
        frames.append(Image.fromarray(_picture(figure)).quantize(64))
    files = [folder / "crossing.png", folder / "crossing.gif"]
    save_figure(figure, files[0])
    with whole_file(files[1]) as temporary:
        frames[0].save(temporary, save_all=True, append_images=frames[1:], duration=FRAME_MS, loop=0, optimize=True)
    return files


def _picture(figure: Figure) -> Image:
    """Pixels (h, w, 3) of a figure."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    figure.set_dpi(FILM_DOTS_PER_INCH)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[:, :, :3].copy()
