"""Benchmark suite (`make bench`): speed and accuracy, compared with what a user could choose instead."""

from __future__ import annotations

import os
import platform
import re
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path

import cv2
import numpy as np

from benchmarks import memory, scans, stripes
from benchmarks.command import options
from benchmarks.memory import BY_STRIPE
from benchmarks.peers import ROOT
from benchmarks.rounds import Ratio
from benchmarks.scans import LATENCY
from benchmarks.section import FULL, QUICK, Effort, Section
from testbed import scenes

HEAD = Path(__file__).with_name("performance_head.md")
SCAN, RATIO = "the standard scan", ("ours: precise", "x reference")
SYNTHETIC, FRAMES = ("extraction_synthetic", "clean", *RATIO), ("extraction_scans", SCAN, *RATIO)
# Figure, its largest allowed value, its goal, and where it is: section, first values of the row, and column.
TARGETS: tuple[tuple[str, float, float, tuple[str, ...]], ...] = (
    ("extraction / reference extraction, synthetic clean stripes", 0.8, 0.5, SYNTHETIC),
    ("extraction / reference extraction, frames of the scan", 0.8, 0.5, FRAMES),
    ("CPU of a whole scan / reference extraction of its frames", 2.0, 1.2, ("whole_scans", SCAN, *RATIO)),
    ("last frame to grid / reference extraction of one frame", 8.0, 5.0, ("whole_scans", SCAN, LATENCY, RATIO[1])),
    ("memory growth in a scan, MB", 16.0, 11.0, ("memory", BY_STRIPE, "MB")),
)


def sections_of(effort: Effort, folders: list[Path]) -> Iterator[Section]:
    """All sections, each as soon as it is measured; the targets come last.

    Args:
        effort: how much is measured.
        folders: recorded scans that take part, DATA/scans/NAME.
    """
    cv2.setNumThreads(1)
    standard = scenes.simulated(effort.size, effort.stripes)
    all_scans = [standard, *map(scenes.recorded, folders)]
    comparisons: tuple[Callable[[], Section], ...] = (
        lambda: stripes.synthetic(effort),
        lambda: stripes.frames_of_scans(all_scans, effort),
        lambda: scans.whole_scans(all_scans, effort),
        lambda: memory.memory(standard),
    )
    done: dict[str, Section] = {}
    for compare in comparisons:
        section = compare()
        done[section.name] = section
        yield section
    yield judged(done, standard.name)


def judged(sections: Mapping[str, Section], scan: str) -> Section:
    """Every target with its measured value; `scan` is the name of the standard scan."""
    rows = []
    for what, must, goal, path in TARGETS:
        name, *keys, column = (scan if key == SCAN else key for key in path)
        section = sections[name]
        (row,) = [row for row in section.rows if row[: len(keys)] == tuple(keys)]
        value = row[section.header.index(column)]
        value = value.median if isinstance(value, Ratio) else float(value)
        rows.append((what, value, must, goal, "reached" if value <= must else "not yet"))
    return Section(
        "targets",
        "Targets",
        f"On the standard scan ({scan}) where nothing else is said.",
        "figure:<58 | measured:.2f | at most:g | goal:g | limit is:<7",
        rows,
    )


def page(sections: Iterable[Section], machine: Mapping[str, str]) -> str:
    """Text of docs/performance.md: the head, a chapter for each section, and the machine of the run."""
    chapters = [f"## {each.title}\n\n{each.description}\n\n{each.table(markdown=True)}\n" for each in sections]
    about = "\n".join(f"- {name}: {value}" for name, value in machine.items())
    return "\n".join([HEAD.read_text(), *chapters, f"## Machine\n\n{about}\n"])


def described_machine() -> dict[str, str]:
    """Processor, cores, load, system and versions; no names of hosts, no paths."""
    info = Path("/proc/cpuinfo")
    found = re.search(r"model name\s*: (.*)", info.read_text()) if info.is_file() else None
    return {
        "processor": found[1].strip() if found else platform.processor() or platform.machine(),
        "cores": str(os.cpu_count()),
        "load at the start": f"{os.getloadavg()[0]:.1f} processes (quiet: well below the number of cores)",
        "system": f"{platform.system()} {platform.machine()}",
        "Python": platform.python_version(),
        "numpy": np.__version__,
        "OpenCV": cv2.__version__,
    }


def main() -> None:
    """Command line."""
    asked = options(
        __doc__,
        quick=(False, "fewer rounds, under a minute; writes no documents"),
        scans=([scenes.OWN_DATA / "scans" / "paper"], "DATA/scans/NAME"),
        docs=(Path, "folder for performance.md; default: docs, quick: none"),
    )
    start, machine = time.monotonic(), described_machine()
    sections = []
    for section in sections_of(QUICK if asked.quick else FULL, asked.scans):
        sections.append(section)
        print(f"\n{section.title}\n{'-' * len(section.title)}\n{section.table()}", flush=True)
    docs = asked.docs or (None if asked.quick else ROOT / "docs")
    if docs is not None:
        (docs / "performance.md").write_text(page(sections, machine))
    print(f"\n{time.monotonic() - start:.0f} s")


if __name__ == "__main__":
    main()
