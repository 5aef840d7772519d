"""Grids from orthorectified range images equal those of the scan; invalid images are rejected."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.scanning.pictures import cause_image, sigma_image_mm
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK
from kinematics import RobotModel

LEVEL = np.zeros((512, 640), np.float32)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["paper", "dark", "tilt"])
def test_a_recorded_scan_gives_the_same_grid_by_its_range_image(
    name: str, data: Path, calibration: gp.Calibration, robot: RobotModel
) -> None:
    """Causes are kept: DROPOUT stays DROPOUT, and unknown cells of the scan are unknown again."""
    scan = gp.process_scan(data / "scans" / name, calibration, robot)
    image, causes = scan.pictures["ortho_image_mm"], cause_image(scan)
    terrain = gp.terrain_from_range_image(image, causes, sigma_mm=sigma_image_mm(scan), stamp=scan.stamp, step=7)
    assert terrain.geometry == scan.geometry and terrain.extent == "footprint" and terrain.step == 7
    unknown = np.isnan(scan.elevation)
    assert np.isnan(terrain.elevation[unknown]).all()
    np.testing.assert_array_equal(terrain.hazard[unknown] & UNKNOWN_MASK, scan.hazard[unknown] & UNKNOWN_MASK)
    assert ((terrain.hazard & gp.Hazard.DROPOUT) != 0).any()


def test_level_ground_with_a_hole_and_without_causes() -> None:
    """Known where pixels are, UNSCANNED in the hole; ground above the robot's limit is OUT_OF_RANGE."""
    image = LEVEL.copy()
    image[200:240, 300:340] = np.nan
    image[400:440, 300:340] = 5000.0
    terrain = gp.terrain_from_range_image(image, sigma_mm=0.2)
    assert terrain.record.to_json()["method"] == "range_image"
    assert terrain.hazard_at(0.5 + 220 * 0.45 / 512, -0.27 + 320 * 0.54 / 640) == gp.Hazard.UNSCANNED
    assert terrain.hazard_at(0.5 + 420 * 0.45 / 512, -0.27 + 320 * 0.54 / 640) == gp.Hazard.OUT_OF_RANGE
    assert terrain.is_traversable(0.80, 0.2)
    assert np.nanmax(np.sqrt(terrain.variance)) == pytest.approx(2e-4, rel=1e-3)


def test_another_area_and_resolution(robot: RobotModel) -> None:
    """The image covers the given area, in cells of the given size."""
    terrain = gp.terrain_from_range_image(
        np.zeros((100, 200)), area=((1.0, 1.5), (0.0, 1.0)), resolution=0.01, robot=robot
    )
    assert terrain.origin == (1.0, 0.0) and terrain.shape == (100, 50)
    assert terrain.height_at(1.25, 0.5) == 0.0


def test_a_coarse_picture_leaves_cells_unknown() -> None:
    """A cell without the centre of a pixel is unknown."""
    terrain = gp.terrain_from_range_image(np.zeros((45, 54)))
    assert 0.2 < np.isfinite(terrain.elevation).mean() < 0.3 and not terrain.traversability.any()


def changed(value: float) -> np.ndarray:
    image = LEVEL.copy()
    image[3, 4] = value
    return image


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"ortho_image_mm": LEVEL.T}, r"the ratio of the sides must not exceed 1\.25\. Rows must run along x"),
        ({"ortho_image_mm": LEVEL[None]}, "allowed: \\(rows along x, columns along y\\)"),
        ({"ortho_image_mm": "heights"}, "an array of numbers is needed"),
        ({"ortho_image_mm": changed(np.inf)}, "heights that are infinite or beyond"),
        ({"ortho_image_mm": changed(1e9)}, "heights that are infinite or beyond"),
        ({"causes": np.zeros((3, 3), np.uint8)}, "causes have shape"),
        ({"causes": np.full(LEVEL.shape, 200.5)}, "flags other than those of unknown cells"),
        ({"causes": changed(gp.Hazard.STEP)}, "flags other than those of unknown cells"),
        ({"causes": changed(gp.Hazard.DROPOUT)}, "causes contradict the heights: 1 pixels"),
        ({"sigma_mm": -1.0}, "NaN, infinite or negative at a known height"),
        ({"sigma_mm": changed(np.nan)}, "NaN, infinite or negative at a known height"),
        ({"sigma_mm": np.ones(3)}, "one number or"),
        ({"area": ((0.95, 0.5), (-0.27, 0.27))}, "area is .*ascending"),
        ({"area": (0.5, 0.95)}, "area is .*ascending"),
        ({"resolution": 0.007}, "0.007"),
    ],
)
def test_what_is_no_range_image_is_refused(arguments: dict[str, Any], text: str) -> None:
    with pytest.raises(gp.InvalidInput, match=text):
        gp.terrain_from_range_image(**{"ortho_image_mm": LEVEL, **arguments})
