"""The whole suite, `python -m benchmarks all`: speed and accuracy beside what a user would pick instead."""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path

import cv2

from benchmarks import growth, scans, starting, stripes, sweeps, transport
from benchmarks.plots import error_against_time
from benchmarks.report import machine, to_terminal, write_page
from benchmarks.section import FULL, QUICK, Effort, Section
from benchmarks.targets import judged
from testbed import scenes

ROOT = Path(__file__).resolve().parents[1]
OWN_DATA = ROOT / "tests" / "data"
PICTURE = "images/extraction.png", "Error against time of stripe extraction; down and left is better"


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
        lambda: growth.growth(standard, effort),
        lambda: transport.messaging(effort),
        lambda: starting.memory(standard),
        lambda: starting.starting(OWN_DATA, effort),
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


def write(docs: Path, sections: dict[str, Section], described: dict[str, str]) -> None:
    """docs/performance.md and its picture."""
    (docs / "images").mkdir(parents=True, exist_ok=True)
    error_against_time(sections["extraction_synthetic"], docs / PICTURE[0])
    write_page(docs / "performance.md", list(sections.values()), described, PICTURE)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks all", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer rounds, under a minute; writes no documents")
    parser.add_argument("--scans", type=Path, nargs="*", default=[OWN_DATA / "scans" / "paper"], help="DATA/scans/NAME")
    parser.add_argument("--json", type=Path, help="file for all figures as numbers")
    parser.add_argument(
        "--docs", type=Path, help="folder for performance.md and its picture; default: docs, quick: none"
    )
    arguments = parser.parse_args()
    start = time.monotonic()
    described = machine()
    sections = measure(QUICK if arguments.quick else FULL, arguments.scans)
    docs = arguments.docs or (None if arguments.quick else ROOT / "docs")
    if docs is not None:
        write(docs, sections, described)
    if arguments.json is not None:
        figures = {name: section.figures for name, section in sections.items()}
        arguments.json.write_text(json.dumps({"machine": described, **figures}, indent=1))
    print(f"\n{time.monotonic() - start:.0f} s")


if __name__ == "__main__":
    main()
