"""Pictures of the demo: a scan, the last fused map with the footsteps on it, and an animation of the map."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from guara_perception.arrays import Float, Image
from guara_perception.files import whole_file
from guara_perception.terrain.drawing.style import (
    LINE_COLOURS,
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

    from guara_perception.app.demo.walk import DemoPause


PAUSE_MS = 250
ANIMATION_DOTS_PER_INCH = 80
LEG_COLOURS = dict(zip(("lf", "rf", "lh", "rh"), LINE_COLOURS, strict=False))


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
        animate(files[2], pauses)
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


def animate(path: Path, pauses: Sequence[DemoPause]) -> None:
    """Write an animated GIF with heights and hazards of the fused map and the chosen foothold at each pause."""
    from PIL import Image

    images = [Image.fromarray(_map_image(item)).quantize(64) for item in pauses]
    with whole_file(path) as temporary:
        images[0].save(temporary, save_all=True, append_images=images[1:], duration=PAUSE_MS, loop=0, optimize=True)


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


def _map_image(item: DemoPause) -> Image:
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    fused = item.fused
    titles = f"Heights, pause {fused.step}", "Hazards (pale green: traversable)"
    figure, *panels = _draw_grid(fused, titles, (6.4, 5.0), legend=False, vmin=-60, vmax=90)
    figure.set_dpi(ANIMATION_DOTS_PER_INCH)
    if item.foothold is not None:
        x, y, _ = item.answer["foothold"]
        for panel in panels:
            panel.plot(y, x, "o", color=LEG_COLOURS.get(item.pause.next_leg, "black"), markersize=6)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[:, :, :3].copy()
