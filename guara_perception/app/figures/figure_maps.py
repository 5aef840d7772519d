"""Figures of frames, range images, surface and hazards. Views from above have x up and y to the left."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from guara_perception.arrays import Float32, Grey, Interval, Mask
from guara_perception.scanning.pictures import cause_image
from guara_perception.terrain.drawing.style import (
    TRAVERSABILITY_COLOURS,
    draw_layer,
    new_figure,
    rgb,
    save_figure,
)
from guara_perception.terrain.drawing.style import draw_hazards as draw_flags
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.layers.hazard import Hazard

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.patches import Patch

Extent = tuple[float, float, float, float]
SIZE = (9.6, 6.4)
# Colour of the hatching and text of the legend, by cause of unknown cells. The colours are from a palette for
# colour-blind readers; black and grey are distinguished from heights by the hatching.
CAUSES = {
    Hazard.DROPOUT: ("#d55e00", "no return (dark or hole)"),
    Hazard.OCCLUDED: ("#56b4e9", "hidden from camera or laser"),
    Hazard.UNSCANNED: ("#999999", "not observed"),
    Hazard.OUT_OF_RANGE: ("#000000", "below or above the height limits"),
    Hazard.AMBIGUOUS: ("#cc79a7", "unreliable return"),
    Hazard.SELF: ("#0072b2", "hidden by the robot itself"),
}
OTHER_COLOUR = "#888888"
# Width of the hatching lines in pixels of a range image.
LINE_PX = 5


def draw_image(path: Path, image: Grey, area: tuple[Interval, Interval] | None, title: str) -> Path:
    """Draw a greyscale image to a file; return the path.

    If `area` is None, the image is a frame with axes in pixels; otherwise it shows this area [m] of the floor from
    above, with axes in millimetres.
    """
    figure, ((axes,),) = new_figure(size=SIZE)
    if area is None:
        axes.imshow(image, cmap="gray", vmin=0, vmax=255)
        axes.set(xlabel="u [px]", ylabel="v [px]")
    else:
        axes.imshow(image[::-1, ::-1], cmap="gray", vmin=0, vmax=255, extent=_extent(area))
        _label(axes)
    axes.set_title(title)
    return save_figure(figure, path)


def draw_range_image(
    path: Path, image: Float32, terrain: TerrainGrid | None, area: tuple[Interval, Interval], title: str
) -> Path:
    """Draw a range image [mm] to a file, with higher ground lighter; return the path.

    Unknown pixels are hatched, with a colour for each cause if a grid is given.
    """
    figure, ((axes,),) = new_figure(size=SIZE)
    known = image[np.isfinite(image)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    extent = _extent(area)
    shown = axes.imshow(
        np.ma.masked_invalid(image[::-1, ::-1]), cmap="gray", vmin=low, vmax=max(high, low + 1), extent=extent
    )
    figure.colorbar(shown, ax=axes, label="height above the soles [mm]", shrink=0.85)
    remaining, handles = np.isnan(image), []
    flags = np.zeros(image.shape, np.uint8) if terrain is None else cause_image(terrain)
    for cause, (colour, label) in CAUSES.items():
        mask = remaining & ((flags & int(cause)) != 0)
        handles += _hatch(axes, mask, extent, colour, label)
        remaining &= ~mask
    # Pixels are smaller than cells, so a pixel without a cause in the grid lies between the samples of a known cell.
    rest = "unknown" if terrain is None else "between samples of a known cell"
    handles += _hatch(axes, remaining, extent, OTHER_COLOUR, rest)
    axes.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, -0.11), ncols=3)
    _label(axes)
    axes.set_title(title)
    return save_figure(figure, path)


def draw_surface(path: Path, terrain: TerrainGrid, title: str) -> Path:
    """Draw the heights of a grid as a 3-D surface with holes at unknown cells; return the path of the file."""
    import matplotlib
    from matplotlib.colors import LightSource, Normalize

    axes: Any
    figure, ((axes,),) = new_figure(size=SIZE, subplot_kw={"projection": "3d"})
    x, y = (1e3 * centres for centres in terrain.geometry.centres())
    height = 1e3 * terrain.elevation.astype(np.float64)
    known = height[np.isfinite(height)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    scale = Normalize(low, max(high, low + 1))
    colours = matplotlib.colormaps["viridis"](scale(np.nan_to_num(height, nan=low)))
    shade = LightSource(azdeg=315, altdeg=50).hillshade(np.nan_to_num(height, nan=low), vert_exag=1.5, dx=5, dy=5)
    colours[..., :3] *= (0.55 + 0.45 * shade)[..., None]
    across, along = np.meshgrid(y, x, indexing="ij")
    axes.plot_surface(across, along, height, facecolors=colours, rstride=1, cstride=1, linewidth=0, antialiased=False)
    bottom, top = min(low, 0.0), max(high, 60.0)
    axes.set(xlim=(y[-1], y[0]), ylim=(x[0], x[-1]), zlim=(bottom, top))
    axes.set_box_aspect((np.ptp(y), np.ptp(x), 2.0 * (top - bottom)))
    axes.set(xlabel="y, left [mm]", ylabel="x, forward [mm]", zlabel="height [mm] (vertical exaggeration 2)")
    axes.view_init(elev=42, azim=-112)
    mappable = matplotlib.cm.ScalarMappable(norm=scale, cmap="viridis")
    figure.colorbar(mappable, ax=axes, label="height above the soles [mm]", shrink=0.7)
    axes.set_title(title)
    return save_figure(figure, path)


def draw_hazards(path: Path, terrain: TerrainGrid, title: str) -> Path:
    """Draw traversability and hazards side by side; return the path of the file.

    In the right plot, a cell with several flags has the colour of the first of them in `style.HAZARD_COLOURS`.
    """
    figure, ((score, hazards),) = new_figure(1, 2, size=(11.0, 4.0))
    traversability = np.where(np.isfinite(terrain.elevation), terrain.traversability, np.nan)
    shown = draw_layer(score, terrain.geometry, traversability, cmap=TRAVERSABILITY_COLOURS, vmin=0, vmax=1)
    figure.colorbar(shown, ax=score, label="traversability", shrink=0.8)
    draw_flags(hazards, terrain.geometry, terrain.hazard)
    figure.suptitle(title)
    return save_figure(figure, path)


def _extent(area: tuple[Interval, Interval]) -> Extent:
    (x0, x1), (y0, y1) = area
    return (1e3 * y1, 1e3 * y0, 1e3 * x0, 1e3 * x1)


def _label(axes: Axes) -> None:
    axes.set(xlabel="y, left [mm]", ylabel="x, forward [mm]", aspect="equal")


def _hatch(axes: Axes, mask: Mask, extent: Extent, colour: str, label: str) -> list[Patch]:
    """Hatch the pixels of a mask (rows along x, columns along y); return a list with the legend entry.

    The list is empty if no pixel is set.
    """
    from matplotlib.patches import Patch

    if not mask.any():
        return []
    shown = mask[::-1, ::-1]
    is_line = (np.add.outer(np.arange(shown.shape[0]), np.arange(shown.shape[1])) // LINE_PX) % 2 == 0
    rgba = np.zeros((*shown.shape, 4))
    rgba[..., :3] = np.where(is_line[..., None], rgb(colour), 0.45 * np.array(rgb(colour)) + 0.55)
    rgba[..., 3] = shown
    axes.imshow(rgba, extent=extent, interpolation="nearest")
    return [Patch(facecolor=colour, edgecolor="white", hatch="//", label=label)]
