"""Style of all figures (colour-blind-safe colours, sizes, x up and y left), and writing of figures to files.

Figures of `new_figure` need neither pyplot nor a display.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from guara_perception.arrays import Array, Flags, Float32
from guara_perception.exceptions import optional_library
from guara_perception.files import whole_file
from guara_perception.terrain.layers.geometry import GridGeometry
from guara_perception.terrain.layers.hazard import Hazard

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage

# Perceptually uniform, readable in grey and with colour blindness.
HEIGHT_COLOURS = "cividis"
TRAVERSABILITY_COLOURS = "viridis"
UNKNOWN_COLOUR = "#E4E4E4"

# Colours of lines and points in order of use: palette of Okabe and Ito without yellow, which is too pale for lines.
LINE_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")

FREE_COLOUR = "#BEEEC7"
# In order of precedence: a cell with several flags has the colour of the first of them.
HAZARD_COLOURS: dict[Hazard, str] = {
    Hazard.DROPOUT: "#000000",
    Hazard.OUT_OF_RANGE: "#0C4381",
    Hazard.AMBIGUOUS: "#E983B0",
    Hazard.OCCLUDED: "#6B6B6B",
    Hazard.SELF: "#8F6A3F",
    Hazard.UNSCANNED: "#DADADA",
    Hazard.SOFT: "#1717F4",
    Hazard.DROP: "#7A1F1F",
    Hazard.STEP: "#D55E00",
    Hazard.STEEP: "#E69F00",
    Hazard.ROUGH: "#2F93D6",
    Hazard.CONFLICT: "#68199D",
    Hazard.UNCERTAIN: "#9EC9F3",
    Hazard.STALE: "#A898CC",
    Hazard.EDGE: "#F6E27A",
}

DOTS_PER_INCH = 150
STYLE_SHEET = Path(__file__).with_name("figures.mplstyle")


@contextmanager
def styled() -> Iterator[None]:
    """Apply the style while drawing, because titles, colour bars and legends get their sizes when they are created.

    Example:
        with styled():
            figure, axes = new_figure()
            axes[0, 0].set_title("Heights")

    Raises:
        MissingExtra: matplotlib is not installed.
    """
    matplotlib = optional_library("matplotlib", None, "a plot")
    from cycler import cycler

    own: Any = {"savefig.dpi": DOTS_PER_INCH, "axes.prop_cycle": cycler(color=LINE_COLOURS)}
    with matplotlib.rc_context(own, fname=STYLE_SHEET):
        yield


def new_figure(
    rows: int = 1, columns: int = 1, size: tuple[float, float] = (5.0, 4.0), **options: Any
) -> tuple[Figure, Array]:
    """Make a figure with axes, a (rows, columns) object array.

    Args:
        rows: number of rows of axes.
        columns: number of columns of axes.
        size: width and height [inch], at DOTS_PER_INCH pixels per inch.
        options: passed to matplotlib's `Figure.subplots` (`sharex`, `gridspec_kw`, ...).

    Raises:
        MissingExtra: matplotlib is not installed.
    """
    with styled():
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        figure = Figure(figsize=size, layout="constrained", dpi=DOTS_PER_INCH)
        FigureCanvasAgg(figure)
        axes = figure.subplots(rows, columns, squeeze=False, **options)
    return figure, axes


def save_figure(figure: Figure, path: Path) -> Path:
    """Write a figure to a .png, .svg or .pdf file atomically; return the path.

    Raises:
        MissingFile: the folder does not exist.
        InvalidInput: the path is a folder.
        OSError: the file cannot be written.
    """
    with styled(), whole_file(path) as temporary:
        figure.savefig(temporary, facecolor="white")
    return path


def draw_layer(axes: Axes, geometry: GridGeometry, values: Array, **options: Any) -> AxesImage:
    """Draw a layer a[iy, ix] of a grid: x up, y to the left, axes in metres; NaN in pale grey.

    Args:
        axes: axes to draw on.
        geometry: geometry of the grid.
        values: (ny, nx) numbers, or (ny, nx, 3) or (ny, nx, 4) colours 0 ... 1.
        options: passed to `imshow` (`cmap`, `vmin`, `vmax`, ...); the default colours are those of heights.
    """
    ny, nx = geometry.shape
    (x0, y0), cell = geometry.origin, geometry.resolution
    picture = np.swapaxes(np.asarray(values), 0, 1)
    extent = (y0, y0 + ny * cell, x0, x0 + nx * cell)
    options = {"cmap": HEIGHT_COLOURS, **options}
    axes.set_facecolor(UNKNOWN_COLOUR)
    image = axes.imshow(picture, origin="lower", extent=extent, interpolation="nearest", aspect="equal", **options)
    axes.set_xlim(extent[1], extent[0])
    axes.set_ylim(extent[2], extent[3])
    axes.set_xlabel("y [m]")
    axes.set_ylabel("x [m]")
    return image


def hazard_picture(hazard: Flags) -> tuple[Float32, list[tuple[str, str]]]:
    """Colours of a hazard layer and its legend.

    Args:
        hazard: (ny, nx) uint16 flags.

    Returns:
        (ny, nx, 3) float32 colours 0 ... 1, and (name, colour) of all flags shown, free cells first.
    """
    picture = np.full((*hazard.shape, 3), rgb(FREE_COLOUR), dtype=np.float32)
    left = np.ones(hazard.shape, dtype=bool)
    shown: list[tuple[str, str]] = []
    for flag, colour in HAZARD_COLOURS.items():
        here = left & ((hazard & np.uint16(flag)) != 0)
        left &= ~here
        if here.any():
            picture[here] = rgb(colour)
            shown.append((str(flag.name).lower().replace("_", " "), colour))
    if left.any():
        shown.insert(0, ("free", FREE_COLOUR))
    return picture, shown


def draw_hazards(axes: Axes, geometry: GridGeometry, hazard: Flags, legend: bool = True) -> None:
    """Draw a hazard layer with a legend, each cell in the colour of its first flag."""
    from matplotlib.patches import Patch

    picture, shown = hazard_picture(hazard)
    draw_layer(axes, geometry, picture)
    if legend:
        handles = [Patch(facecolor=colour, edgecolor="#555555", linewidth=0.4, label=name) for name, colour in shown]
        axes.legend(handles=handles, loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0, fontsize=7.0)


def rgb(colour: str) -> tuple[float, float, float]:
    """Red, green, blue 0 ... 1 of "#RRGGBB"."""
    red, green, blue = (int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5))
    return red, green, blue
