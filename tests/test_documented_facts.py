"""What the documents state is what the program does: names of files, fields and flags, figures of safety."""

import json
import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.ranging.scan_geometry import scan_geometry
from guara_perception.settings import Settings
from guara_perception.terrain.layers.geometry import (
    EXTRA_RING_CELLS,
    LARGEST_DRIFT_CELLS,
    LEAST_MARGIN_CELLS,
    disc_kernel,
    half_cells,
)

ROOT = Path(__file__).parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def first_cells(page: str, heading: str) -> set[str]:
    """Names in the first column of the tables below a heading."""
    text = (ROOT / "docs" / page).read_text().split(f"\n{heading}\n")[1]
    text = re.split(r"\n#", text)[0]
    cells = re.findall(r"^\| (`.*?) \|", text, re.MULTILINE)
    return {name for cell in cells for name in re.findall(r"`([^`]+)`", cell)}


def test_every_name_of_the_grid_file_is_documented(paper_terrain: gp.TerrainGrid, tmp_path: Path):
    """The table of OUT.npz holds exactly the names of a real file."""
    paper_terrain.save(tmp_path / "out.npz")
    with np.load(tmp_path / "out.npz") as content:
        assert first_cells("files.md", "## Grid file, `OUT.npz`") == set(content.files)


def test_every_field_of_the_metadata_is_documented(paper_terrain: gp.TerrainGrid):
    """The table of the metadata holds exactly the fields of a real scan."""
    assert first_cells("files.md", "### Metadata of a scan") == {*paper_terrain.metadata, "extent"}


def test_every_field_of_the_calibration_is_documented(calibration_file: Path):
    """The table of calibration.json holds exactly the fields of a real one."""
    assert first_cells("files.md", "## `calibration.json`") == set(json.loads(calibration_file.read_text()))


def test_every_flag_is_documented_with_its_value():
    """The tables of hazards hold every flag once, with the value that it has."""
    rows = re.findall(r"^\| `([A-Z_]+)` \| (\d+) \|", (ROOT / "docs" / "safety.md").read_text(), re.MULTILINE)
    assert {name: int(value) for name, value in rows} == {flag.name: int(flag) for flag in gp.Hazard if flag}
    assert len(rows) == 15


def test_figures_of_the_safety_page_are_those_of_the_program(robot, calibration, paper_scan: gp.Scan):
    """Stripe pitch and margins that the page states follow from calibration, robot.toml and the code."""
    page = (ROOT / "docs" / "safety.md").read_text()
    settings = Settings.of(robot)
    pose = robot.stance_pose(paper_scan.stance)
    planes = scan_geometry(calibration, pose.transform_base_to_footprint, settings, "coarse").planes_in_footprint
    x = np.sort(-planes[:, 3] / planes[:, 0])
    pitch = np.diff(x[(x > settings.footprint_x[0] - 0.02) & (x < settings.footprint_x[1] + 0.02)]) * 1e3
    assert f"{pitch.min():.0f} to {pitch.max():.0f} mm in a coarse one" in page
    limits, cell = settings.limits, settings.resolution
    disc = disc_kernel(limits.disc_radius / cell).shape[0] // 2
    sole = [half_cells(length, cell) for length in (limits.sole_length, limits.sole_width)]
    hazard, fused, unknown = (
        [round((n + more) * cell * 1e3) for n in sole]
        for more in (0, disc + LEAST_MARGIN_CELLS, disc + EXTRA_RING_CELLS)
    )
    least = round(LEAST_MARGIN_CELLS * cell * 1e3)
    assert f"a hazard: {hazard[0]} mm along x, {hazard[1]} mm along y, and {least} mm more in the fused map" in page
    assert f"border of the grid: {unknown[0]} mm along x, {unknown[1]} mm along y in a single scan" in page
    beyond = round((LARGEST_DRIFT_CELLS - disc - LEAST_MARGIN_CELLS) * cell * 1e3)
    assert f"in the fused map: {fused[0]} mm along x, {fused[1]} mm along y, and up to {beyond} mm more" in page
    assert f"up to {round(LARGEST_DRIFT_CELLS * cell * 1e3)} mm in all (the largest margin" in page
    patch, in_map = ([round(2 * n + cell * 1e3) for n in margin] for margin in (unknown, fused))
    assert (
        f"known for at least {patch[0]} mm along x and {patch[1]} mm along y, in maps too" in page and in_map == patch
    )
    assert "(15 mm)" in page and limits.disc_radius == 0.015


@cache
def defined_tests() -> set[str]:
    """Names of all tests."""
    files = (ROOT / "tests").rglob("*.py")
    return {name for path in files for name in re.findall(r"def (test_\w+)", path.read_text())}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_tests_that_a_page_names_exist(page: Path):
    """Every `tests/...` path is a file, every `test_...` name a test."""
    assert set(re.findall(r"`(test_\w+)`", page.read_text())) <= defined_tests()
    for path in re.findall(r"`(tests/[\w/.]+)`", page.read_text()):
        assert (ROOT / path).exists(), path
