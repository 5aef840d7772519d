"""Range images of the recorded scans against truth, and against the grids of the same scans."""

from __future__ import annotations

from pathlib import Path

import pytest

import guara_perception as gp
from benchmarks.range_images import HEAD, ImageFigures, image_figures
from kinematics import RobotModel


@pytest.mark.slow
@pytest.mark.parametrize("name", ["paper", "dark", "tilt"])
def test_range_images_hold_what_was_seen(name: str, data: Path, calibration: gp.Calibration, robot: RobotModel) -> None:
    """No pixel is known that camera or laser cannot see; the grid of the image is the scan's own.

    Heights within 0.1 mm in the mean, hazards differ in at most 2 % of the cells, none is free by the image alone.
    Unknown pixels are as many, beside the unknown cells, as truth itself would leave, to a twentieth.
    """
    found = image_figures(data / "scans" / name, calibration, robot)
    assert found.made_up[0] == 0 and found.free_alone == 0
    assert found.mean < 0.1 and found.differ < 0.02
    assert found.unknown / found.unknown_cells < max(1.15, 1.05 * found.perfect)
    assert name in found.budget(name) and len(found.row()) == HEAD.count("|")


def test_an_empty_floor_has_a_row_too() -> None:
    """Where nothing is unknown, the ratio is 1 and the budget has no shares."""
    found = ImageFigures(0.0, 0.0, 1.0, (0, 0), (0, 0, 0), 0.0, 0.0, 0, 0.1, 2_900_000)
    assert found.row()[:5] == (0.0, 0.0, 1.0, 1.0, 0)
    assert "0 unknown pixels in known cells: 0 %" in found.budget("empty")
