"""Benchmark suite (`make bench`): speed and accuracy, compared with what a user could choose instead."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import cv2

from benchmarks import memory, scans, stripes, sweeps
from benchmarks.command import options
from benchmarks.report import machine, to_terminal, write_page
from benchmarks.section import FULL, QUICK, Effort, Section
from benchmarks.targets import judged
from testbed import scenes

ROOT = Path(__file__).resolve().parents[1]
OWN_DATA = ROOT / "tests" / "data"


def measure(effort: Effort, folders: list[Path], say: Callable[[str], object] = print) -> dict[str, Section]:
    """All sections, each printed as soon as it is measured.

    Args:
        effort: how much is measured.
        folders: recorded scans that take part, DATA/scans/NAME.
        say: what to do with each table.
    """
    cv2.setNumThreads(1)
    standard = scenes.simulated(effort.size, effort.stripes)
    all_scans = [standard, *map(scenes.recorded, folders)]
    comparisons: list[Callable[[], Section]] = [
        lambda: stripes.synthetic(effort),
        lambda: stripes.frames_of_scans(all_scans, effort),
        lambda: scans.whole_scans(all_scans, effort),
        lambda: scans.stages(standard, effort),
        lambda: memory.memory(standard),
        lambda: sweeps.section(effort.faulty_sweeps),
    ]
    sections: dict[str, Section] = {}
    for compare in comparisons:
        section = compare()
        sections[section.name] = section
        say(to_terminal(section))
    targets = judged(sections, standard.name)
    say(to_terminal(targets))
    return {targets.name: targets, **sections}


def main() -> None:
    """Command line."""
    asked = options(
        __doc__,
        quick=(False, "fewer rounds, under a minute; writes no documents"),
        scans=([OWN_DATA / "scans" / "paper"], "DATA/scans/NAME"),
        docs=(Path, "folder for performance.md; default: docs, quick: none"),
    )
    start = time.monotonic()
    described = machine()
    sections = measure(QUICK if asked.quick else FULL, asked.scans)
    docs = asked.docs or (None if asked.quick else ROOT / "docs")
    if docs is not None:
        write_page(docs / "performance.md", list(sections.values()), described)
    print(f"\n{time.monotonic() - start:.0f} s")


if __name__ == "__main__":
    main()
