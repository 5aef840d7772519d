"""Sections as tables in the terminal and as a page of the documents, and what they were measured on."""

from __future__ import annotations

import os
import platform
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np

from benchmarks.section import Section

HEAD = """# Performance

Made by `make bench`; do not edit. `make bench-quick` prints the same with fewer rounds in under a minute.

Everybody works on the same frames in the same run: contenders take turns, who begins changes from round to round, and
each is compared with the reference of its own round. Tables give the median of these ratios and [smallest largest].
**Believe the ratios**: milliseconds of a machine that others use too move by a factor of two and more, and a ratio of
two wall times still varies with it. CPU time is used where totals are compared, wall time where somebody waits.
Frames are in memory, decoding is timed apart, OpenCV and the linear algebra run on one thread.

- *Reference*: a plain band extraction with OpenCV and numpy (red planes subtracted, five taps, block argmax, centre of
  gravity). It has no guard against two stripes, clipped light, texture or a changed background and gives no sigma.
- *Paper taken literally*: red channel, Otsu, skeleton, mean row, `griddata` of scipy for the range image, eqs. 20 and
  21, `generic_filter` for slope and step height on cells of 5 mm; arrays wherever arrays will do. The skeleton is this
  project's own Zhang-Suen thinning.
- *Point by point*: the same as it stands in the text, one loop over the points and one over the pixels, slope and step
  height on the paper's own picture of 512 x 640.
- *OpenCV user*: argmax and centre of gravity on the whole frame, `griddata` onto the cells, layers with OpenCV.
"""


def to_terminal(section: Section) -> str:
    """Title and aligned columns."""
    table = [section.header, *section.rows]
    widths = [max(len(row[i]) for row in table) for i in range(len(section.header))]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in table]
    return "\n".join([f"\n{section.title}", "-" * len(lines[0]), *lines])


def to_markdown(section: Section) -> str:
    """Heading, description and table."""
    table = [section.header, tuple("---" for _ in section.header), *section.rows]
    rows = ["| " + " | ".join(row) + " |" for row in table]
    return "\n".join([f"## {section.title}", "", section.description, "", *rows, ""])


def write_page(
    path: Path,
    sections: Sequence[Section],
    machine: Mapping[str, str],
    picture: tuple[str, str],
    remarks: str = "",
) -> None:
    """The page of the documents.

    Args:
        path: file to write.
        sections: in order, but the targets first: on the page they follow what they are taken from.
        machine: what the run was made on.
        picture: file name beside the page and caption.
        remarks: text about the targets, printed after their table.
    """
    on = ["## Machine", "", *(f"- {name}: {value}" for name, value in machine.items()), ""]
    name, caption = picture
    shown = [f"![{caption}]({name})", "", f"*{caption}*", ""]
    first, *others = sections
    limits = [to_markdown(first), *([remarks] if remarks else [])]
    path.write_text(
        "\n".join([HEAD, "\n".join(shown), *map(to_markdown, others), *limits, "\n".join(on)]).rstrip() + "\n"
    )


def machine() -> dict[str, str]:
    """Processor, cores, system and versions; no names of hosts, no paths."""
    info = Path("/proc/cpuinfo")
    found = re.search(r"model name\s*: (.*)", info.read_text()) if info.is_file() else None
    load = os.getloadavg()[0]
    return {
        "processor": found[1].strip() if found else platform.processor() or platform.machine(),
        "cores": str(os.cpu_count()),
        "load at the start": f"{load:.1f} processes wanted a core (quiet: well below the number of cores)",
        "system": f"{platform.system()} {platform.machine()}",
        "Python": platform.python_version(),
        "numpy": np.__version__,
        "OpenCV": cv2.__version__,
    }
