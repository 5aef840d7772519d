"""Draws frames, range images, surface and hazards for people: x up, y left, millimetres, with legends."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from guara_perception.arrays import Array, Float32, Grey, Interval, Mask
from guara_perception.files import whole_file
from guara_perception.scanning.pictures import cause_image
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK, Hazard

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Colour and text of a legend's entry, and whether its patch is hatched.
Entry = tuple[str, str, bool]
Extent = tuple[float, float, float, float]
DPI = 110
# One colour per cause of unknown, and one per reason against known ground; distinct also for colour-blind eyes.
CAUSES = {
    Hazard.DROPOUT: ("#d55e00", "no return (dark or hole)"),
    Hazard.OCCLUDED: ("#56b4e9", "hidden behind something"),
    Hazard.UNSCANNED: ("#999999", "not looked at"),
    Hazard.OUT_OF_RANGE: ("#000000", "below or above the height limits"),
    Hazard.AMBIGUOUS: ("#cc79a7", "return not trusted"),
    Hazard.SELF: ("#0072b2", "own leg or body"),
}
REASONS = {
    Hazard.STEP: ("#7f0000", "rises too much"),
    Hazard.DROP: ("#b2182b", "falls too much"),
    Hazard.STEEP: ("#ef8a62", "too steep"),
    Hazard.ROUGH: ("#fdbf6f", "too rough"),
    Hazard.UNCERTAIN: ("#ffd92f", "height too uncertain"),
    Hazard.CONFLICT: ("#e31a8c", "looks disagree"),
    Hazard.STALE: ("#6a3d9a", "seen too long ago"),
    Hazard.EDGE: ("#f7f4bf", "sole would reach one of these"),
}
UNKNOWN_COLOUR = "#ffffff"


def draw_image(path: Path, image: Grey, area: tuple[Interval, Interval] | None, title: str) -> Path:
    """A grey image: of the camera (axes in pixels) or of the floor seen from above (axes in millimetres)."""
    figure, axes = _figure()
    if area is None:
        axes.imshow(image, cmap="gray", vmin=0, vmax=255)
        axes.set(xlabel="u [px]", ylabel="v [px]")
    else:
        axes.imshow(image[::-1, ::-1], cmap="gray", vmin=0, vmax=255, extent=_extent(area))
        _label(axes)
    axes.set_title(title)
    return _save(figure, path)


def draw_range_image(
    path: Path, image: Float32, terrain: TerrainGrid | None, area: tuple[Interval, Interval], title: str
) -> Path:
    """A range image (512, 640) [mm], higher is lighter, unknown hatched; with a grid each cause in its own colour."""
    figure, axes = _figure()
    known = image[np.isfinite(image)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    extent = _extent(area)
    shown = axes.imshow(
        np.ma.masked_invalid(image[::-1, ::-1]), cmap="gray", vmin=low, vmax=max(high, low + 1), extent=extent
    )
    figure.colorbar(shown, ax=axes, label="height above the soles [mm]", shrink=0.85)
    unknown = np.isnan(image)
    if terrain is None:
        _hatch(axes, unknown, extent, "#888888")
        _legend(axes, [("#888888", "unknown", True)])
    else:
        entries, rest = _hatch_causes(axes, cause_image(terrain), unknown, extent)
        if rest.any():
            # Pixels between samples in a cell that is known: they are finer than the grid.
            _hatch(axes, rest, extent, "#888888")
            entries.append(("#888888", "between samples of a known cell", True))
        _legend(axes, entries)
    _label(axes)
    axes.set_title(title)
    return _save(figure, path)


def draw_surface(path: Path, terrain: TerrainGrid, title: str) -> Path:
    """The grid's heights as a surface in three dimensions; unknown cells stay open."""
    from matplotlib.colors import LightSource, Normalize
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 6.5), dpi=DPI, layout="constrained")
    axes: Any = figure.add_subplot(projection="3d")
    x, y = (1e3 * centres for centres in terrain.geometry.centres())
    height = 1e3 * terrain.elevation.astype(np.float64)
    known = height[np.isfinite(height)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    import matplotlib

    scale = Normalize(low, max(high, low + 1))
    colours = matplotlib.colormaps["viridis"](scale(np.nan_to_num(height, nan=low)))
    shade = LightSource(azdeg=315, altdeg=50).hillshade(np.nan_to_num(height, nan=low), vert_exag=1.5, dx=5, dy=5)
    colours[..., :3] *= (0.55 + 0.45 * shade)[..., None]
    across, along = np.meshgrid(y, x, indexing="ij")
    axes.plot_surface(across, along, height, facecolors=colours, rstride=1, cstride=1, linewidth=0, antialiased=False)
    bottom, top = min(low, 0.0), max(high, 60.0)
    axes.set(xlim=(y[-1], y[0]), ylim=(x[0], x[-1]), zlim=(bottom, top))
    axes.set_box_aspect((np.ptp(y), np.ptp(x), 2.0 * (top - bottom)))
    axes.set(xlabel="y, left [mm]", ylabel="x, forward [mm]", zlabel="height, drawn twice [mm]")
    axes.view_init(elev=42, azim=-112)
    mappable = matplotlib.cm.ScalarMappable(norm=scale, cmap="viridis")
    figure.colorbar(mappable, ax=axes, label="height above the soles [mm]", shrink=0.7)
    axes.set_title(title)
    return _save(figure, path)


def draw_hazards(path: Path, terrain: TerrainGrid, title: str) -> Path:
    """Free ground in greens by score, hazards and unknown ground by their reason."""
    from matplotlib.colors import to_rgb

    figure, axes = _figure()
    hazard = terrain.hazard
    picture = np.ones((*hazard.shape, 3))
    score = terrain.traversability.astype(np.float64)
    free = hazard == 0
    picture[free] = np.column_stack((0.75 - 0.65 * score[free], 0.92 - 0.42 * score[free], 0.72 - 0.55 * score[free]))
    entries: list[Entry] = [("#1a802b", "free, the darker the better", False)] if free.any() else []
    rest = ~free
    for reason, (colour, label) in REASONS.items():
        mask = rest & ((hazard & int(reason)) != 0) & ((hazard & UNKNOWN_MASK) == 0)
        if mask.any():
            picture[mask] = to_rgb(colour)
            entries.append((colour, label, False))
            rest &= ~mask
    geometry = terrain.geometry
    x, y = (1e3 * centres for centres in geometry.centres())
    half = 5e2 * geometry.resolution
    extent = (y[-1] + half, y[0] - half, x[0] - half, x[-1] + half)
    axes.imshow(picture.swapaxes(0, 1)[::-1, ::-1], extent=extent, interpolation="nearest")
    entries += _hatch_causes(axes, hazard.T, rest.T, extent)[0]
    _legend(axes, entries)
    _label(axes)
    axes.set_title(title)
    return _save(figure, path)


def _figure() -> tuple[Figure, Axes]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.6, 6.4), dpi=DPI, layout="constrained")
    return figure, figure.add_subplot()


def _extent(area: tuple[Interval, Interval]) -> Extent:
    (x0, x1), (y0, y1) = area
    return (1e3 * y1, 1e3 * y0, 1e3 * x0, 1e3 * x1)


def _label(axes: Axes) -> None:
    axes.set(xlabel="y, left [mm]", ylabel="x, forward [mm]", aspect="equal")


def _hatch_causes(axes: Axes, flags: Array, unknown: Mask, extent: Extent) -> tuple[list[Entry], Mask]:
    """Hatch unknown pixels by cause; return the legend's entries and the mask of pixels without a cause."""
    entries: list[Entry] = []
    rest = unknown.copy()
    for cause, (colour, label) in CAUSES.items():
        mask = rest & ((flags & int(cause)) != 0)
        if mask.any():
            _hatch(axes, mask, extent, colour)
            entries.append((colour, label, True))
            rest &= ~mask
    return entries, rest


def _hatch(axes: Axes, mask: Mask, extent: Extent, colour: str) -> None:
    """Hatch the pixels of a mask, rows along x and columns along y, over a light tint of the colour."""
    from matplotlib.colors import to_rgb

    if not mask.any():
        return
    shown = mask[::-1, ::-1]
    is_line = (np.add.outer(np.arange(shown.shape[0]), np.arange(shown.shape[1])) // _line_width(shown.shape)) % 2 == 0
    rgba = np.zeros((*shown.shape, 4))
    rgba[..., :3] = np.where(is_line[..., None], to_rgb(colour), 0.45 * np.array(to_rgb(colour)) + 0.55)
    rgba[..., 3] = shown
    axes.imshow(rgba, extent=extent, interpolation="nearest")


def _line_width(shape: tuple[int, ...]) -> int:
    """Width of a hatching line in entries of the array: a cell of a grid, several pixels of a range image."""
    return max(shape[1] // 110, 1)


def _legend(axes: Axes, entries: list[Entry]) -> None:
    from matplotlib.patches import Patch

    handles = [
        Patch(facecolor=colour, edgecolor="white" if hatched else "#444444", hatch="//" if hatched else "", label=label)
        for colour, label, hatched in entries
    ]
    if handles:
        axes.legend(
            handles=handles, loc="upper center", bbox_to_anchor=(0.5, -0.11), ncols=3, frameon=False, fontsize=9
        )


def _save(figure: Figure, path: Path) -> Path:
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    FigureCanvasAgg(figure)
    with whole_file(path) as temporary:
        figure.savefig(temporary, format="png")
    return path
