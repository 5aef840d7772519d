"""A body that sways unseen while it is scanned: what robot.toml says of it keeps wrong ground from being free."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.app.demo.check import true_elevation
from guara_perception.app.node.simulated import SimulatedRobot
from guara_perception.simulation.light import Light
from guara_perception.simulation.rangefinder import SimulatedRangefinder
from guara_perception.simulation.world import World
from kinematics import RobotFileError, RobotModel, load_robot
from testbed.altered_robot import altered_guara

WRONG_M = 0.005
AMPLITUDE = np.radians(0.5)


def that_sways(folder: Path, amplitude: object) -> RobotModel:
    """Guará whose builder says that it sways by this [rad]."""
    return load_robot(altered_guara(folder, ("[pause]\n", f"[pause]\nstance_sway = {amplitude}\n")))


@pytest.mark.slow
def test_no_cell_is_free_that_an_unseen_sway_made_wrong(robot: RobotModel, tmp_path: Path) -> None:
    """A dim flat floor, 0.5 degrees at 1 Hz, still again at the end: nothing shows it but the heights."""
    world = World(light=dataclasses.replace(Light(), ambient=(3.0, 3.0, 3.0)))
    simulated = SimulatedRobot(world=world, size=(320, 256))
    pause = next(simulated.walk(cycles=0))
    swaying = that_sways(tmp_path / "much", AMPLITUDE)
    view = SimulatedRangefinder(world, simulated.calibration, robot, 0)
    grids = {}
    for name, model, amplitude in (
        ("still", robot, 0.0),
        ("swaying, unsaid", robot, AMPLITUDE),
        ("still, said", swaying, 0.0),
        ("swaying, said", swaying, AMPLITUDE),
    ):
        processor = gp.ScanProcessor(simulated.calibration, model, pause.stance, mode="coarse")
        for number, index in enumerate(range(0, 70, 2)):
            turn = amplitude * np.sin(2.0 * np.pi * number / 35.0)
            pose = pause.transform_base_to_world.copy()
            pose[:3, :3] = _pitch(turn) @ pose[:3, :3]
            pose[:3, 3] = _pitch(turn) @ pose[:3, 3]
            view.set_pose(pose)
            angle = simulated.calibration.stripe(index).mirror_angle
            processor.add(index, view.frame(mirror_angle=angle), view.frame(laser=0.0))
        grids[name] = processor.finish()
    truth = true_elevation(world, pause, grids["still"])
    free = {name: grid.hazard == 0 for name, grid in grids.items()}
    wrong = {name: int((free[name] & (np.abs(grid.elevation - truth) > WRONG_M)).sum()) for name, grid in grids.items()}
    assert wrong["still"] == wrong["swaying, said"] == 0 < wrong["swaying, unsaid"]
    assert "allows for up to 0.50 degrees" in " ".join(grids["still, said"].record.health.reasons)
    assert np.nanmax(grids["still, said"].variance_local) > 10 * np.nanmax(grids["still"].variance_local)


@pytest.mark.slow
def test_a_small_sway_costs_the_far_ground_alone(
    robot: RobotModel, tmp_path: Path, paper_scan: gp.Scan, calibration: gp.Calibration
) -> None:
    """Of a recorded scan without laser-off pictures: sigma at each cell is at least that of the sway there, near ground
    stays free, and health says so. With one, its texture shows that the body stood, and nothing is lost.
    """
    sway = np.radians(0.3)
    swaying = that_sways(tmp_path, sway)

    def grid_of(model: RobotModel, *, has_off: bool) -> gp.TerrainGrid:
        processor = gp.ScanProcessor(calibration, model, paper_scan.stance, paper_scan.mode)
        for stripe, on, off in paper_scan.frames():
            processor.add(stripe.index, on, off if has_off else None)
        return processor.finish()

    grid, still = grid_of(swaying, has_off=False), grid_of(robot, has_off=False)
    x, y = grid.geometry.centres()
    known = np.isfinite(grid.elevation)
    assert (np.sqrt(grid.variance) >= 0.97 * sway * np.hypot(x, y[:, None]))[known].all()
    free = grid.hazard == 0
    assert free.any() and not (free & (still.hazard != 0)).any()
    for each, said in ((grid, "allows for up to 0.30 degrees"), (still, "allows for none")):
        reasons = " ".join(each.record.health.reasons)
        assert "cannot be detected" in reasons and "no laser-off picture" in reasons and said in reasons
    seen = grid_of(swaying, has_off=True)
    assert seen.record.health.level == "ok"
    assert (seen.hazard == grid_of(robot, has_off=True).hazard).all()


@pytest.mark.parametrize("value", ["-0.001", "0.1", "nan", '"a"'])
def test_a_sway_that_is_none_is_refused(tmp_path: Path, value: str) -> None:
    with pytest.raises(RobotFileError, match="stance_sway is"):
        that_sways(tmp_path, value)


def _pitch(angle: float) -> np.ndarray:
    return np.array([[np.cos(angle), 0.0, np.sin(angle)], [0.0, 1.0, 0.0], [-np.sin(angle), 0.0, np.cos(angle)]])
