"""The benchmark as a smoke test: everything runs and every table has its rows; no time is asserted."""

import importlib
import json
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks import paper_chain
from benchmarks.__main__ import PROGRAMS
from benchmarks.all import measure, write
from benchmarks.contenders import LITERAL, OURS, USER
from benchmarks.growth import fit
from benchmarks.report import machine
from benchmarks.rounds import alternate
from benchmarks.section import FULL, QUICK
from benchmarks.targets import TARGETS
from guara_perception.terrain.layers.geometry import MOST_CELLS
from testbed import scenes

pytestmark = pytest.mark.slow

TINY = replace(
    QUICK,
    rounds=1,
    size=(160, 128),
    stripes=12,
    synthetic_stripes=2,
    stripe_counts=(6, 12),
    picture_sizes=((96, 96), (160, 128)),
    cell_sides=(16, 32),
    starts=1,
    pings=5,
    faulty_sweeps=2,
)


@pytest.fixture(scope="module")
def sections():
    """All sections of a tiny run."""
    return measure(TINY, [], say=lambda text: None)


@pytest.mark.heavy
def test_every_section_has_its_table(sections):
    """Each row has as many cells as the header, and figures can be written as JSON."""
    assert len(sections) == 10
    for section in sections.values():
        assert section.rows
        assert {len(row) for row in section.rows} == {len(section.header)}
        json.dumps(section.figures)


@pytest.mark.heavy
def test_every_contender_takes_part_in_the_whole_scan(sections):
    """This project, the paper and the OpenCV user are all there, each with an error."""
    (contenders,) = sections["whole_scans"].figures.values()
    for name in (*OURS, LITERAL, USER):
        assert np.isfinite(contenders[name]["mean"]) and contenders[name]["ratio"] > 0


@pytest.mark.heavy
def test_every_target_is_judged(sections):
    """The table of targets holds each once, with a number."""
    figures = sections["targets"].figures
    assert list(figures) == [target.what for target in TARGETS]
    assert all(np.isfinite(figure["value"]) for figure in figures.values())


@pytest.mark.heavy
def test_the_page_names_no_path_and_shows_its_picture(sections, tmp_path: Path):
    """The generated page holds every table; its picture is there; nothing of the machine's folders is in it."""
    write(tmp_path, sections, machine())
    page = (tmp_path / "performance.md").read_text()
    for section in sections.values():
        assert f"## {section.title}" in page
    assert (tmp_path / "images" / "extraction.png").stat().st_size > 1000
    assert str(Path.home()) not in page and str(scenes.ROBOTS.parent) not in page


def test_the_largest_grid_is_accepted():
    """What `make bench` measures last and only in full must not be refused."""
    assert max(FULL.cell_sides) ** 2 <= MOST_CELLS


def test_every_program_is_reached_by_its_name(root: Path):
    """Each module with a command line is listed, can be imported, and explains itself; another name is refused."""
    ends = re.compile(r'^if __name__ == "__main__":\n(?:.*\n)*? +main\(\)$', re.MULTILINE)
    modules = {path.stem for path in (root / "benchmarks").glob("*.py") if ends.search(path.read_text())}
    assert modules - {"__main__"} == set(PROGRAMS)
    for name in PROGRAMS:
        assert callable(importlib.import_module(f"benchmarks.{name}").main)
    for arguments, code, expected_text in (
        (["accuracy", "--help"], 0, "usage: benchmarks accuracy"),
        (["transport", "--help"], 0, "  viewers "),
        (["transport", "viewers", "--help"], 0, "--scans"),
        (["transport", "nothing"], 2, "usage: benchmarks transport PART"),
        (["nothing"], 1, "benchmarks: no program 'nothing'; allowed: all, accuracy"),
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


def test_exponent_of_a_power_law_is_found():
    """A cost that grows as n to the 1.5 has the exponent 1.5."""
    assert fit([10, 100, 1000], [n**1.5 for n in (10, 100, 1000)]) == pytest.approx(1.5)


def test_orthorectification_moves_what_is_high_towards_the_nadir():
    """Eqs. 20 and 21 send a raised pixel towards the nadir, by its height over that of the camera."""
    height = np.full((paper_chain.ROWS, paper_chain.COLUMNS), np.nan)
    height[200:210, 500:510] = 0.05
    optical_centre, x, y = np.array([0.3, 0.0, 0.5]), (0.5, 0.95), (-0.27, 0.27)
    ortho = paper_chain.orthorectified(height, optical_centre, x, y)
    rows, columns = np.nonzero(np.isfinite(ortho))
    # The nadir is below the middle of the columns, and beyond row 0, at (0.3 - 0.5) / 0.45 of the rows.
    nadir_row, nadir_column = -0.2 / 0.45 * paper_chain.ROWS - 0.5, paper_chain.COLUMNS / 2 - 0.5
    assert columns.mean() - nadir_column == pytest.approx(0.9 * (504.5 - nadir_column), abs=0.5)
    assert rows.mean() - nadir_row == pytest.approx(0.9 * (204.5 - nadir_row), abs=0.5)


@pytest.mark.heavy
def test_resized_scan_keeps_its_heights():
    """The same scene through a camera of half the resolution gives about the same grid."""
    whole = scenes.simulated((320, 256), 24)
    half = scenes.resized(whole, (160, 128))
    assert half.frames[0][1].shape == (128, 160, 3)
    grids = [scenes_grid(scan) for scan in (whole, half)]
    both = np.isfinite(grids[0]) & np.isfinite(grids[1])
    assert both.any() and np.median(np.abs(grids[0] - grids[1])[both]) < 0.002


def scenes_grid(scan: scenes.ScanInMemory) -> np.ndarray:
    processor = scan.processor()
    for index, on, off in scan.frames:
        processor.add(index, on, off)
    return processor.finish().elevation
