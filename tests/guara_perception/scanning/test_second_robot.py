"""A recorded scan is processed for another robot: only the robot folder, the scan's stance and the mount differ."""

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.app.main import run
from kinematics import RobotModel, Stance, load_robot

TAPIR = Path(__file__).parents[2] / "robots" / "tapir"


@pytest.mark.slow
def test_second_robot_processes_a_recorded_scan(
    robot: RobotModel,
    calibration: gp.Calibration,
    paper_scan: gp.Scan,
    paper_terrain: gp.TerrainGrid,
    edited_scan: Callable[[Callable[[dict[str, Any]], object]], Path],
    tmp_path: Path,
) -> None:
    """Three joints per leg, other names, the camera over the floor as before: the same grid, by command."""
    tapir = load_robot(TAPIR)
    stance = Stance(tapir.posture(tapir.config.scan_posture), tapir.legs, (0.0, 0.0, -1.0))
    camera_to_footprint = (
        robot.stance_pose(paper_scan.stance).transform_base_to_footprint @ calibration.transform_camera_to_base
    )
    mount = np.linalg.inv(tapir.stance_pose(stance).transform_base_to_footprint) @ camera_to_footprint
    own = dataclasses.replace(calibration, robot=tapir.name, transform_camera_to_base=mount)
    gp.save_calibration(own, tmp_path / "tapir.json")

    def as_tapir(scan: dict[str, Any]) -> None:
        scan["robot"] = tapir.name
        scan["stance"] = json.loads(json.dumps(stance.to_dict()))

    folder = edited_scan(as_tapir)
    arguments = ["process", str(folder), "-c", str(tmp_path / "tapir.json"), "-o", str(tmp_path / "tapir.npz")]
    assert run([*arguments, "--robot", str(TAPIR)]) == 0
    terrain = gp.load_terrain(tmp_path / "tapir.npz")
    assert terrain.metadata["robot"] == tapir.name
    both = np.isfinite(terrain.elevation) & np.isfinite(paper_terrain.elevation)
    assert both.sum() > 0.98 * np.isfinite(paper_terrain.elevation).sum()
    np.testing.assert_allclose(terrain.elevation[both], paper_terrain.elevation[both], atol=2e-4)
