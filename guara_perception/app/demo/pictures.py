"""Pictures of the demo: the last scan, the fused map with every foothold, and how the map grew, animated."""

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
    from guara_perception.app.demo.walk import DemoPause


PAUSE_MS = 250
ANIMATION_DOTS_PER_INCH = 80
LEG_COLOURS = dict(zip(("lf", "rf", "lh", "rh"), LINE_COLOURS, strict=False))


def draw_demo(folder: Path, pauses: Sequence[DemoPause]) -> list[Path]:
    """Draw everything into `folder`; return the files.

    Args:
        folder: folder that exists.
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
    """One scan: heights and hazards side by side."""
    figure, axes = new_figure(1, 2, size=(8.2, 3.6))
    heights = draw_layer(axes[0, 0], terrain.geometry, 1e3 * np.asarray(terrain.elevation))
    figure.colorbar(heights, ax=axes[0, 0], label="height [mm]", shrink=0.8)
    axes[0, 0].set_title(f"Heights, pause {terrain.step}")
    draw_hazards(axes[0, 1], terrain.geometry, np.asarray(terrain.hazard))
    axes[0, 1].set_title("Where a foot may not go, and why")
    save_figure(figure, path)


def draw_map(path: Path, pauses: Sequence[DemoPause]) -> None:
    """The map at the last pause, with every foothold that was chosen on the way."""
    fused = pauses[-1].fused
    figure, axes = new_figure(1, 2, size=(8.2, 5.6))
    heights = draw_layer(axes[0, 0], fused.geometry, 1e3 * np.asarray(fused.elevation))
    figure.colorbar(heights, ax=axes[0, 0], label="height [mm]", shrink=0.6)
    axes[0, 0].set_title("Fused map: heights")
    draw_hazards(axes[0, 1], fused.geometry, np.asarray(fused.hazard))
    axes[0, 1].set_title("Fused map: hazards and footholds")
    (x0, y0), (ny, nx) = fused.origin, fused.shape
    for leg, colour in LEG_COLOURS.items():
        footholds = footholds_in_last_footprint(pauses, leg)
        inside = (
            (footholds[:, 0] > x0)
            & (footholds[:, 0] < x0 + nx * fused.resolution)
            & (footholds[:, 1] > y0)
            & (footholds[:, 1] < y0 + ny * fused.resolution)
        )
        for panel in axes[0]:
            panel.plot(
                footholds[inside, 1],
                footholds[inside, 0],
                "o",
                color=colour,
                markersize=4,
                markeredgecolor="white",
                markeredgewidth=0.5,
                label=f"{leg} foothold",
            )
    axes[0, 0].legend(loc="lower left", fontsize=6.0, frameon=True, framealpha=0.8)
    save_figure(figure, path)


def animate(path: Path, pauses: Sequence[DemoPause]) -> None:
    """The fused map from pause to pause, hazards and heights, as a GIF."""
    from PIL import Image

    images = [Image.fromarray(_map_image(item)).quantize(64) for item in pauses]
    with whole_file(path) as temporary:
        images[0].save(temporary, save_all=True, append_images=images[1:], duration=PAUSE_MS, loop=0, optimize=True)


def footholds_in_last_footprint(pauses: Sequence[DemoPause], leg: str) -> Float:
    """Where the feet of a leg were put, (n, 3) in base_footprint of the last pause [m]."""
    to_last = inverse(pauses[-1].pause.transform_footprint_to_world)
    positions = [
        item.pause.last_footstep.sole_in_world
        for item in pauses
        if item.pause.last_footstep is not None and item.pause.last_footstep.leg == leg
    ]
    soles = np.array(positions, dtype=np.float64).reshape(-1, 3)
    return transform_points(to_last, soles)


def _map_image(item: DemoPause) -> Image:
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    fused = item.fused
    figure, axes = new_figure(1, 2, size=(6.4, 5.0))
    figure.set_dpi(ANIMATION_DOTS_PER_INCH)
    draw_layer(axes[0, 0], fused.geometry, 1e3 * np.asarray(fused.elevation), vmin=-60, vmax=90)
    axes[0, 0].set_title(f"Heights, pause {fused.step}")
    draw_hazards(axes[0, 1], fused.geometry, np.asarray(fused.hazard), legend=False)
    axes[0, 1].set_title("Hazards (pale green: a foot may go)")
    if item.foothold is not None:
        x, y, _ = item.answer["foothold"]
        for panel in axes[0]:
            panel.plot(y, x, "o", color=LEG_COLOURS.get(item.pause.next_leg, "black"), markersize=6)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[:, :, :3].copy()
