"""Pictures and animations of the demo: scan, fused map and footsteps of a walk, and the crossing of a course."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from guara_perception.arrays import Array, Float
from guara_perception.files import whole_file
from guara_perception.simulation.world import World
from guara_perception.terrain.drawing.style import (
    FREE_COLOUR,
    LINE_COLOURS,
    UNKNOWN_COLOUR,
    draw_hazards,
    draw_layer,
    new_figure,
    save_figure,
    styled,
)
from guara_perception.terrain.grid import TerrainGrid
from kinematics.transforms import inverse, transform_points

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from PIL.Image import Image

    from guara_perception.app.demo.walk import DemoPause

# Time that each pause of an animation is shown [ms].
PAUSE_MS = 250
WALK_DOTS_PER_INCH, COURSE_DOTS_PER_INCH = 80, 90
LEG_COLOURS = dict(zip(("lf", "rf", "lh", "rh"), LINE_COLOURS, strict=False))
# Size of the cells of a course, and area drawn before, beyond and beside it [m].
CELL_M, BEFORE_M, BEYOND_M, ASIDE_M = 0.005, 0.45, 0.55, 0.30
# Height difference per cell above which a rim is drawn [m]. Central differences halve an isolated step, so it must be
# twice as high.
RIM_M = 0.005
UNKNOWN, REFUSED, FREE = 0, 1, 2
COLOURS = {"unknown": UNKNOWN_COLOUR, "refused": "#F2B79B", "free": FREE_COLOUR}


def draw_demo(folder: Path, pauses: Sequence[DemoPause]) -> list[Path]:
    """Draw all pictures to files in `folder`; return their paths, none if there are no pauses.

    Args:
        folder: existing folder.
        pauses: pauses of the walk, in order.
    """
    if not pauses:
        return []
    midway = pauses[len(pauses) // 2]
    files = [folder / "scan.png", folder / "map.png", folder / "walk.gif"]
    with styled():
        draw_scan(files[0], midway.terrain)
        draw_map(files[1], pauses)
        save_film(files[2], [_map_frame(item) for item in pauses])
    return files


def draw_scan(path: Path, terrain: TerrainGrid) -> None:
    """Draw heights and hazards of one scan side by side to a file."""
    titles = f"Heights, pause {terrain.step}", "Hazards, by cause"
    figure, heights, _ = _draw_grid(terrain, titles, (8.2, 3.6))
    figure.colorbar(heights.images[0], ax=heights, label="height [mm]", shrink=0.8)
    save_figure(figure, path)


def draw_map(path: Path, pauses: Sequence[DemoPause]) -> None:
    """Draw the map of the last pause to a file, with the footsteps of the legs in `LEG_COLOURS` on it."""
    fused = pauses[-1].fused
    figure, *panels = _draw_grid(fused, ("Fused map: heights", "Fused map: hazards and footholds"), (8.2, 5.6))
    figure.colorbar(panels[0].images[0], ax=panels[0], label="height [mm]", shrink=0.6)
    for leg, colour in LEG_COLOURS.items():
        footholds = footholds_in_last_footprint(pauses, leg)
        x, y = footholds[:, :2].T
        inside = fused.geometry.contains(*fused.geometry.indices(x, y))
        for panel in panels:
            panel.plot(
                y[inside],
                x[inside],
                "o",
                color=colour,
                markersize=4,
                markeredgecolor="white",
                markeredgewidth=0.5,
                label=f"{leg} foothold",
            )
    hazards = panels[1]
    # A second legend of the same axes replaces the first one, which is therefore kept as an artist.
    if (causes := hazards.get_legend()) is not None:
        hazards.add_artist(causes)
    hazards.legend(
        handles=hazards.get_lines(), loc="lower left", bbox_to_anchor=(1.01, 0.0), borderaxespad=0.0, fontsize=7.0
    )
    save_figure(figure, path)


def film_frame(figure: Figure, dots_per_inch: int) -> Image:
    """Render a figure as an image with 64 colours, for `save_film`."""
    from PIL import Image

    figure.set_dpi(dots_per_inch)
    canvas: Any = figure.canvas
    canvas.draw()
    return Image.fromarray(np.asarray(canvas.buffer_rgba())[:, :, :3]).quantize(64)


def save_film(path: Path, frames: Sequence[Image]) -> None:
    """Write an animated GIF that shows each frame for PAUSE_MS."""
    with whole_file(path) as temporary:
        frames[0].save(temporary, save_all=True, append_images=frames[1:], duration=PAUSE_MS, loop=0, optimize=True)


def footholds_in_last_footprint(pauses: Sequence[DemoPause], leg: str) -> Float:
    """Positions (n, 3) of all footsteps of a leg, in base_footprint of the last pause [m]."""
    to_last = inverse(pauses[-1].pause.transform_footprint_to_world)
    positions = [
        item.pause.last_footstep.sole_in_world
        for item in pauses
        if item.pause.last_footstep is not None and item.pause.last_footstep.leg == leg
    ]
    soles = np.array(positions, dtype=np.float64).reshape(-1, 3)
    return transform_points(to_last, soles)


def _draw_grid(
    grid: TerrainGrid, titles: tuple[str, str], size: tuple[float, float], *, legend: bool = True, **limits: float
) -> tuple[Figure, Axes, Axes]:
    """Draw heights and hazards of a grid side by side; `limits` (vmin, vmax) bound the colour scale of heights [mm]."""
    figure, ((heights, hazards),) = new_figure(1, 2, size=size)
    draw_layer(heights, grid.geometry, 1e3 * np.asarray(grid.elevation), **limits)
    draw_hazards(hazards, grid.geometry, np.asarray(grid.hazard), legend=legend)
    heights.set_title(titles[0])
    hazards.set_title(titles[1])
    return figure, heights, hazards


def _map_frame(item: DemoPause) -> Image:
    """Heights and hazards of the fused map of a pause, with the chosen foothold."""
    fused = item.fused
    titles = f"Heights, pause {fused.step}", "Hazards (pale green: traversable)"
    figure, *panels = _draw_grid(fused, titles, (6.4, 5.0), legend=False, vmin=-60, vmax=90)
    if item.foothold is not None:
        x, y, _ = item.answer["foothold"]
        for panel in panels:
            panel.plot(y, x, "o", color=LEG_COLOURS.get(item.pause.next_leg, "black"), markersize=6)
    return film_frame(figure, WALK_DOTS_PER_INCH)


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
        frames.append(film_frame(figure, COURSE_DOTS_PER_INCH))
    files = [folder / "crossing.png", folder / "crossing.gif"]
    save_figure(figure, files[0])
    save_film(files[1], frames)
    return files
