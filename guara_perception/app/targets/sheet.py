"""Drawings in millimetres, cut into printed pages that can be joined."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from guara_perception.exceptions import InvalidInput

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Width and height in portrait.
PAPERS_MM = {"a4": (210.0, 297.0), "letter": (215.9, 279.4), "a3": (297.0, 420.0)}
# Unprintable margin of common printers.
MARGIN_MM = 10.0
# Overlap of adjacent pages of a drawing.
OVERLAP_MM = 10.0
MARK_MM = 4.0
MM_PER_INCH = 25.4


@dataclass(frozen=True, slots=True)
class Sheet:
    """Drawing to scale.

    Attributes:
        title: printed on every page.
        width_mm, height_mm: size of the drawing.
        draw: function that draws on axes in millimetres, with (0, 0) at the bottom left of the drawing.
    """

    title: str
    width_mm: float
    height_mm: float
    draw: Callable[[Axes], None]


@dataclass(frozen=True, slots=True)
class Page:
    """Printed page of a sheet.

    Attributes:
        sheet: sheet of which the page shows a part.
        paper_mm: width and height of the paper in the orientation of the page.
        corner_mm: position on the sheet of the bottom left corner of that part.
        size_mm: width and height of that part.
        row, column: indices of the page, from the bottom left.
        rows, columns: numbers of pages of the sheet, up and across.
    """

    sheet: Sheet
    paper_mm: tuple[float, float]
    corner_mm: tuple[float, float]
    size_mm: tuple[float, float]
    row: int
    column: int
    rows: int
    columns: int


def pages_of(sheet: Sheet, paper: str) -> list[Page]:
    """Cut a sheet into pages, in the paper orientation that needs the fewest.

    Raises:
        InvalidInput: unknown paper size.
    """
    if paper not in PAPERS_MM:
        raise InvalidInput(f"paper is {paper!r}, allowed: {', '.join(PAPERS_MM)}")
    width, height = PAPERS_MM[paper]
    turned = [(width, height), (height, width)]
    return min((list(_cut(sheet, size)) for size in turned), key=len)


def figure_of(page: Page) -> Figure:
    """Matplotlib figure of the paper's size with the page's part of its sheet at true scale."""
    from matplotlib.figure import Figure

    paper_width, paper_height = page.paper_mm
    (width, height), (x, y) = page.size_mm, page.corner_mm
    figure = Figure(figsize=(paper_width / MM_PER_INCH, paper_height / MM_PER_INCH))
    left, bottom = (paper_width - width) / 2, (paper_height - height) / 2
    axes = figure.add_axes((left / paper_width, bottom / paper_height, width / paper_width, height / paper_height))
    axes.set_xlim(x, x + width)
    axes.set_ylim(y, y + height)
    axes.set_axis_off()
    page.sheet.draw(axes)
    _joining_marks(axes, page)
    where = ""
    if page.rows * page.columns > 1:
        where = f", row {page.row + 1} of {page.rows} from the bottom, column {page.column + 1} of {page.columns} "
        where += "from the left"
    text = f"{page.sheet.title}{where}; print at 100 %"
    figure.text(0.5, 3.5 / paper_height, text, ha="center", va="center", fontsize=6)
    return figure


def _cut(sheet: Sheet, paper_mm: tuple[float, float]) -> Iterator[Page]:
    counts, sizes = [], []
    for length, available in zip((sheet.width_mm, sheet.height_mm), paper_mm, strict=True):
        room = available - 2 * MARGIN_MM
        count = 1 if length <= room else math.ceil((length - OVERLAP_MM) / (room - OVERLAP_MM))
        counts.append(count)
        sizes.append((length + (count - 1) * OVERLAP_MM) / count)
    columns, rows = counts
    for row in range(rows):
        for column in range(columns):
            corner = (column * (sizes[0] - OVERLAP_MM), row * (sizes[1] - OVERLAP_MM))
            yield Page(sheet, paper_mm, corner, (sizes[0], sizes[1]), row, column, rows, columns)


def _joining_marks(axes: Axes, page: Page) -> None:
    """Draw small crosses on the centre line of each overlap; they coincide when two pages are joined."""
    (x, y), (width, height) = page.corner_mm, page.size_mm
    half = OVERLAP_MM / 2
    along_x = [x + half] * (page.column > 0) + [x + width - half] * (page.column < page.columns - 1)
    along_y = [y + half] * (page.row > 0) + [y + height - half] * (page.row < page.rows - 1)
    positions = [(px, y + share * height) for px in along_x for share in (0.1, 0.9)]
    positions += [(x + share * width, py) for py in along_y for share in (0.1, 0.9)]
    for px, py in positions:
        axes.plot([px - MARK_MM / 2, px + MARK_MM / 2], [py, py], color="#3366cc", linewidth=0.3)
        axes.plot([px, px], [py - MARK_MM / 2, py + MARK_MM / 2], color="#3366cc", linewidth=0.3)
