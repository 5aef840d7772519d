"""The benchmark as a smoke test: everything runs and every table has its rows; no time is asserted."""

import importlib
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.__main__ import programs
from benchmarks.all import TARGETS, described_machine, page, sections_of
from benchmarks.contenders import OURS, USER
from benchmarks.peers import ROOT
from benchmarks.rounds import alternate
from benchmarks.section import QUICK

pytestmark = pytest.mark.slow

TINY = replace(QUICK, rounds=1, size=(160, 128), stripes=12, synthetic_stripes=2)


@pytest.fixture(scope="module")
def sections():
    """All sections of a tiny run."""
    return {section.name: section for section in sections_of(TINY, [])}


@pytest.mark.heavy
def test_every_section_has_its_table(sections):
    """Each row has as many cells as the header."""
    assert len(sections) == 5
    for section in sections.values():
        assert section.rows
        assert {len(row) for row in section.rows} == {len(section.header)}
        assert len(section.table().splitlines()) == 1 + len(section.rows)


@pytest.mark.heavy
def test_every_contender_takes_part_in_the_whole_scan(sections):
    """This project and the OpenCV user are there, each with an error."""
    contenders = {row[1]: row for row in sections["whole_scans"].rows}
    for name in (*OURS, USER):
        assert np.isfinite(contenders[name][5]) and contenders[name][3].median > 0


@pytest.mark.heavy
def test_every_target_is_judged(sections):
    """The table of targets holds each once, with a number."""
    rows = sections["targets"].rows
    assert [row[0] for row in rows] == [what for what, *_ in TARGETS]
    assert all(np.isfinite(row[1]) for row in rows)


@pytest.mark.heavy
def test_the_page_names_no_path(sections):
    """The generated page holds every table and nothing of the machine's folders."""
    text = page(sections.values(), described_machine())
    for section in sections.values():
        assert f"## {section.title}\n\n{section.description}\n\n{section.table(markdown=True)}\n" in text
    assert str(Path.home()) not in text and str(ROOT) not in text


def test_every_program_is_reached_by_its_name(root: Path):
    """Each module with a command line is listed, can be imported, and explains itself; another name is refused."""
    ends = re.compile(r'^if __name__ == "__main__":\n(?:.*\n)*? +main\(\)$', re.MULTILINE)
    modules = {path.stem for path in (root / "benchmarks").glob("*.py") if ends.search(path.read_text())}
    assert modules - {"__main__"} == set(programs())
    for name, first_line in programs().items():
        assert first_line.endswith(".")
        assert callable(importlib.import_module(f"benchmarks.{name}").main)
    for arguments, code, expected_text in (
        (["accuracy", "--help"], 0, "usage: benchmarks accuracy"),
        (["transport", "--help"], 0, "  viewers "),
        (["transport", "viewers", "--help"], 0, "--scans"),
        (["transport", "nothing"], 2, "usage: benchmarks transport PART"),
        (["nothing"], 1, "benchmarks: no program 'nothing'; allowed: accuracy, all"),
        ([], 0, "usable_ground"),
    ):
        done = subprocess.run(
            [sys.executable, "-m", "benchmarks", *arguments], cwd=root, capture_output=True, text=True, check=False
        )
        assert done.returncode == code and expected_text in done.stdout + done.stderr


@pytest.mark.heavy
def test_contenders_take_turns():
    """Each begins a round in turn, the slow ones only in the first rounds; ratios pair the same rounds."""
    order = []
    ticks = iter(range(1000))
    runs = {name: lambda name=name: order.append(name) for name in "abc"}
    timings = alternate(runs, 3, clock=lambda: float(next(ticks)), slow="c", slow_rounds=1, warm=False)
    assert order == ["a", "b", "c", "b", "a", "a", "b"]
    assert timings.ratio("c", "a").median == 1.0
