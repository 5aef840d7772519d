"""What all pictures of the report share: size, colours, and how one becomes part of the page."""

from __future__ import annotations

import base64
import io
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from guara_perception.arrays import Image

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Colours that stay apart for colour-blind readers.
BLUE, ORANGE, GREEN, RED, GREY = "#0072b2", "#e69f00", "#009e73", "#d55e00", "#999999"
SERIES = (BLUE, ORANGE, GREEN, "#cc79a7", "#56b4e9", RED, "#000000")
DPI = 110


def new_figure(width: float = 9.0, height: float = 4.2, columns: int = 1, **keywords: Any) -> tuple[Figure, list[Any]]:
    """A figure without a window, and its axes in a list."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure as AggFigure

    figure = AggFigure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, columns, squeeze=False, **keywords)
    return figure, list(axes[0])


def to_png(figure: Figure) -> bytes:
    """The figure as a PNG."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=DPI)
    return buffer.getvalue()


def data_url(png: bytes) -> str:
    """A PNG as part of the page itself."""
    return "data:image/png;base64," + base64.b64encode(png).decode("ascii")


def for_show(picture: Image) -> Image:
    """A camera picture as RGB, stretched to full contrast so that dark ones can be seen."""
    if picture.dtype == np.uint16:
        picture = (picture >> 8).astype(np.uint8)
    rgb = cv2.cvtColor(picture, cv2.COLOR_GRAY2RGB if picture.ndim == 2 else cv2.COLOR_BGR2RGB)
    high = max(float(np.percentile(rgb, 99.8)), 1.0)
    return np.clip(rgb * (235.0 / high), 0, 255).astype(np.uint8)
