"""Plot of a layer, and the summary of a grid in a console or a notebook."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from guara_perception.arrays import Float
from guara_perception.exceptions import InvalidInput, MissingExtra
from guara_perception.terrain.drawing.style import (
    TRAVERSABILITY_COLOURS,
    draw_hazards,
    draw_layer,
    new_figure,
    styled,
)
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK, cells_by_flag
from guara_perception.terrain.layers.layered_grid import LayeredGrid
from guara_perception.terrain.layers.layers import LAYER_NAMES

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Label of the colour bar of each layer except `hazard`, and the factor to its unit.
COLOUR_BARS = {
    "elevation": ("height above the soles [mm]", 1e3),
    "elevation_min": ("lowest sample [mm]", 1e3),
    "elevation_max": ("highest sample [mm]", 1e3),
    "variance": ("variance of the height [mm²]", 1e6),
    "variance_local": ("variance not shared with neighbours [mm²]", 1e6),
    "slope": ("slope [degrees]", 180 / np.pi),
    "step_height": ("step height [mm]", 1e3),
    "roughness": ("roughness [mm]", 1e3),
    "clearance": ("distance to the nearest hazard [mm]", 1e3),
    "traversability": ("traversability, 0 never ... 1 ideal", 1.0),
    "age": ("pauses since last seen", 1.0),
    "looks": ("scans that saw the cell", 1.0),
    "ceiling": ("upper bound of unknown ground [mm]", 1e3),
}
SHOWN_FLAGS = 4
# Vertical position of the text that explains the grey colours, relative to the height of the axes (negative: below).
KEY_Y = -0.16
HTML_SIZE_INCH = (4.2, 3.0)


def plot(
    terrain: LayeredGrid,
    layer: str = "elevation",
    *,
    hazards: bool = True,
    footholds: Iterable[Any] = (),
    regions: Iterable[Any] = (),
    axes: Axes | None = None,
) -> Axes:
    """Draw one layer with x up and y to the left, in metres; cells without a value are pale grey.

    Args:
        layer: any layer; "hazard" is drawn in one colour per flag with a legend.
        hazards: True = veil the known cells that are not traversable (except in the layer "hazard").
        footholds: positions to mark, each a `Foothold` or a pair (x, y) [m].
        regions: areas to outline, each a `SteppableRegion`.
        axes: matplotlib axes; None = new ones that a notebook or `plt.show()` shows.

    Raises:
        InvalidInput: there is no such layer, a foothold lacks x and y, or a region has fewer than three vertices.
        MissingExtra: matplotlib is not installed.
    """
    if not isinstance(layer, str) or layer not in LAYER_NAMES:
        given = repr(layer) if isinstance(layer, str) else f"a {type(layer).__name__}"
        hint = "" if isinstance(layer, str) else "; draw your own values on the axes that plot returns"
        raise InvalidInput(f"layer is {given}, allowed: {', '.join(LAYER_NAMES)}{hint}")
    marks = [_xy_of(foothold) for foothold in footholds]
    outlines = [_outline_of(region) for region in regions]
    with styled():
        if axes is None:
            import matplotlib.pyplot as plt

            axes = plt.subplots(layout="constrained")[1]
        if layer == "hazard":
            draw_hazards(axes, terrain.geometry, terrain.layers["hazard"])
        else:
            _draw_values(axes, terrain, layer, hazards)
        for x, y in outlines:
            # A black line on a white one is visible on any background.
            for width, colour in ((2.4, "white"), (1.0, "black")):
                axes.plot(y, x, color=colour, linewidth=width, zorder=2)
        if marks:
            x, y = np.transpose(marks)
            axes.scatter(y, x, s=50, facecolor="white", edgecolor="black", zorder=3)
        axes.set_title(f"{layer.replace('_', ' ')}, {terrain.extent}, step {terrain.step}")
        if layer != "hazard":
            key = f"pale grey: {'no bound' if layer == 'ceiling' else 'unknown'}"
            key += ", veiled: not traversable" if hazards else ""
            # Below the axes, so that a title set by the user does not replace it.
            axes.text(0.5, KEY_Y, key, transform=axes.transAxes, ha="center", va="top", fontsize="small")
    return axes


def describe(terrain: LayeredGrid) -> str:
    """Summary of a grid in two to four lines; a stale grid has a line with the reasons."""
    hazard = terrain.layers["hazard"]
    known = (hazard & UNKNOWN_MASK) == 0
    (x0, y0), cell, (ny, nx) = terrain.origin, terrain.resolution, terrain.shape
    lines = [
        f"{type(terrain).__name__}: {terrain.extent} of step {terrain.step}, {nx} x {ny} cells of {1e3 * cell:g} mm, "
        f"x {x0:.2f} ... {x0 + nx * cell:.2f} m, y {y0:.2f} ... {y0 + ny * cell:.2f} m in {terrain.frame}",
        f"  known {known.mean():.1%}, traversable {(terrain.layers['traversability'] > 0).mean():.1%}",
    ]
    if known.any():
        height = terrain.layers["elevation"][known]
        lines[1] += f", heights {1e3 * height.min():.1f} ... {1e3 * height.max():.1f} mm"
    counts = {name: count for name, count in cells_by_flag(hazard).items() if count}
    most = sorted(counts, key=lambda name: -counts[name])[:SHOWN_FLAGS]
    if most:
        rest = f" and {len(counts) - len(most)} more kinds" if len(counts) > len(most) else ""
        lines.append("  hazards: " + ", ".join(f"{name} {counts[name]}" for name in most) + rest)
    if terrain.stale_because:
        lines.append("  stale: " + "; ".join(terrain.stale_because))
    return "\n".join(lines)


def describe_as_html(terrain: LayeredGrid) -> str:
    """Summary of a grid for notebooks, with plots of heights and hazards if matplotlib is installed."""
    text = html.escape(describe(terrain))
    try:
        figure, axes = new_figure(1, 2, (2 * HTML_SIZE_INCH[0], HTML_SIZE_INCH[1]))
    except MissingExtra:
        return f"<pre>{text}</pre>"
    plot(terrain, axes=axes[0, 0])
    plot(terrain, "hazard", axes=axes[0, 1])
    stream = io.BytesIO()
    with styled():
        figure.savefig(stream, format="png", dpi=90, facecolor="white")
    picture = base64.b64encode(stream.getvalue()).decode("ascii")
    return f'<pre>{text}</pre><img alt="heights and hazards" src="data:image/png;base64,{picture}"/>'


def _draw_values(axes: Axes, terrain: LayeredGrid, layer: str, hazards: bool) -> None:
    label, factor = COLOUR_BARS[layer]
    values = factor * terrain.layers[layer].astype(np.float64)
    unknown = (terrain.layers["hazard"] & UNKNOWN_MASK) != 0
    if layer != "ceiling":
        values[unknown] = np.nan
    colours = {"cmap": TRAVERSABILITY_COLOURS, "vmin": 0, "vmax": 1} if layer == "traversability" else {}
    image = draw_layer(axes, terrain.geometry, values, **colours)
    axes.figure.colorbar(image, ax=axes, label=label, shrink=0.85)
    refused = (terrain.layers["traversability"] == 0) & ~unknown
    if hazards and refused.any():
        veil = np.zeros((*terrain.shape, 4))
        veil[..., :3] = 1.0
        veil[refused, 3] = 0.55
        draw_layer(axes, terrain.geometry, veil)


def _outline_of(region: Any) -> tuple[Float, Float]:
    """Closed outline of a region, x and y [m]."""
    vertices = np.asarray(getattr(region, "vertices", ()), dtype=np.float64)
    if vertices.ndim != 2 or vertices.shape[1] not in (2, 3) or len(vertices) < 3:
        raise InvalidInput(
            f"a region is a {type(region).__name__}; it must have three or more vertices, (n, 2) or (n, 3) [m]"
        )
    closed = np.concatenate((vertices, vertices[:1]))
    return closed[:, 0], closed[:, 1]


def _xy_of(foothold: Any) -> tuple[float, float]:
    try:
        x, y = (foothold.x, foothold.y) if hasattr(foothold, "x") else foothold
        return float(x), float(y)
    except (TypeError, ValueError):
        hint = "; best_foothold found none: skip None, and see best_refused for reasons" if foothold is None else ""
        raise InvalidInput(f"a foothold is {foothold!r}; it must have x and y, or be a pair (x, y) [m]{hint}") from None
