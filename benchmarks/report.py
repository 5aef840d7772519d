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

HEAD = Path(__file__).with_name("performance_head.md")


def to_terminal(section: Section) -> str:
    """Title and aligned columns."""
    table = [section.header, *section.cells]
    widths = [max(len(row[i]) for row in table) for i in range(len(section.header))]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in table]
    return "\n".join([f"\n{section.title}", "-" * len(lines[0]), *lines])


def to_markdown(section: Section) -> str:
    """Heading, description and table."""
    table = [section.header, tuple("---" for _ in section.header), *section.cells]
    rows = ["| " + " | ".join(row) + " |" for row in table]
    return "\n".join([f"## {section.title}", "", section.description, "", *rows, ""])


def write_page(path: Path, sections: Sequence[Section], machine: Mapping[str, str]) -> None:
    """The page of the documents.

    Args:
        path: file to write.
        sections: in order, but the targets first: on the page they follow what they are taken from.
        machine: what the run was made on.
    """
    on = ["## Machine", "", *(f"- {name}: {value}" for name, value in machine.items()), ""]
    first, *others = sections
    tables = [*map(to_markdown, others), to_markdown(first)]
    path.write_text("\n".join([HEAD.read_text(), *tables, *on]).rstrip() + "\n")


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
