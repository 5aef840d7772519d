"""Plates smaller than the view: stripes and columns beside them are left out, and missed steps are still detected."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.app.files.calibration_session import open_session
from guara_perception.app.files.scan_folder import open_scan_folder
from guara_perception.app.main import run
from guara_perception.app.record.operator import TextOperator
from guara_perception.app.record.plate_scan import scan_uncalibrated
from guara_perception.app.record.simulated import FLOOR_MATERIAL, SimulatedWorkshop
from guara_perception.calibration.calibrate_session import calibrate_session
from guara_perception.calibration.calibration_input import CalibrationSession, Plate
from guara_perception.calibration.laser import heights_through
from guara_perception.calibration.result import CalibrationResult
from guara_perception.settings import Settings
from guara_perception.simulation.features import Box
from guara_perception.simulation.rangefinder import SimulatedRangefinder
from guara_perception.simulation.simulated_camera import renderer
from guara_perception.simulation.world import World
from kinematics import RobotModel
from tests.guara_perception.calibration.breaking import missed_step
from tests.made_once import made_once

pytestmark = pytest.mark.heavy

AREA, A3 = (0.45, 0.54), (0.297, 0.42)
# Height [m], centre [m], size [m] and rotation [rad] of plates as a user may place them.
PLATES = {
    "floor": (0.0, 0.725, 0.0, AREA, 0.0),
    "area_40": (0.04, 0.725, 0.0, AREA, 0.0),
    "area_80": (0.08, 0.725, 0.0, AREA, 0.0),
    "a3_near_40": (0.04, 0.64, 0.0, A3, 0.0),
    "a3_far_40": (0.04, 0.82, 0.02, A3, 0.06),
    "a3_near_80": (0.08, 0.64, 0.0, A3, 0.0),
    "a3_far_80": (0.08, 0.82, -0.02, A3, -0.05),
    "away_80": (0.08, 1.6, 0.0, A3, 0.0),
}
FITTING = {
    "the scanned area": ("floor", "area_40", "area_80"),
    "A3, moved": ("floor", "a3_near_40", "a3_far_40", "a3_near_80", "a3_far_80"),
    "two sizes": ("floor", "area_40", "a3_near_80", "a3_far_80"),
}


@pytest.fixture(scope="module")
def scans(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Scans of all plates, each with new mirror and camera noise."""

    def make(folder: Path) -> None:
        folder.mkdir()
        for seed, (name, (height, x, y, size, yaw)) in enumerate(PLATES.items()):
            workshop = SimulatedWorkshop()
            box = Box(x=x, y=y, size=size, height=height, yaw=yaw) if height else None
            world = World(features=() if box is None else (box,), material=FLOOR_MATERIAL)
            view = SimulatedRangefinder(world, workshop.truth, workshop.robot, seed)
            pose = workshop.robot.stance_pose(workshop.stance)
            view.set_pose(pose.transform_base_to_footprint, workshop.stance.joint_positions)
            workshop._scene = renderer(view)
            with workshop.rangefinder as rangefinder:
                scan_uncalibrated(rangefinder, workshop.robot, workshop.stance, folder / name, mode="coarse")

    return made_once(tmp_path_factory, "small-plates", make)


@pytest.fixture(scope="module")
def targets(tmp_path_factory: pytest.TempPathFactory) -> CalibrationSession:
    """The recorded session, for its board and cross images."""

    def record(folder: Path) -> None:
        assert run(["record", str(folder), "--simulated"]) == 0

    return open_session(made_once(tmp_path_factory, "recorded-session", record))


def session_of(targets: CalibrationSession, scans: Path, names: tuple[str, ...]) -> CalibrationSession:
    """The session with these plates instead of its own."""
    plates = tuple(Plate(name, PLATES[name][0], open_scan_folder(scans / name)) for name in names)
    return dataclasses.replace(targets, plates=plates)


def height_errors(result: CalibrationResult) -> np.ndarray:
    """Height errors of points on the floor and 60 mm above it, for a calibration used with the true camera [m]."""
    truth, base = SimulatedWorkshop().truth, result.transform_base_to_footprint
    true_camera, camera = (base @ one.transform_camera_to_base for one in (truth, result.calibration))
    true_planes = {stripe.index: stripe.plane @ np.linalg.inv(true_camera) for stripe in truth.stripes}
    y, errors = np.linspace(-0.25, 0.25, 11), []
    for stripe in result.calibration.stripes:
        plane = true_planes[stripe.index]
        for height in (0.0, 0.06):
            x = -(plane[1] * y + plane[2] * height + plane[3]) / plane[0]
            points = np.column_stack((x, y, np.full(11, height)))
            pixels = truth.camera.project((points - true_camera[:3, 3]) @ true_camera[:3, :3])
            found = stripe.plane @ np.linalg.inv(camera)
            errors.append(heights_through(pixels, result.calibration.camera, camera, found) - height)
    return np.array(errors)


@pytest.mark.parametrize("names", FITTING.values(), ids=list(FITTING))
def test_small_plates_calibrate_as_good(
    targets: CalibrationSession, scans: Path, robot: RobotModel, names: tuple[str, ...]
) -> None:
    """A plate of the scanned area, a moved A3 plate, and plates of two sizes measure to 0.1 mm."""
    result = calibrate_session(session_of(targets, scans, names), robot)
    assert result.verdict == "good", result.reasons
    assert np.nanmax(np.abs(height_errors(result))) < 1e-4
    beside = {names[one.plate] for one in result.lost}
    assert beside == {name for name in names if name.startswith("a3")}


def test_a_missed_step_is_told_from_a_stripe_beside_the_plate(
    targets: CalibrationSession, scans: Path, robot: RobotModel
) -> None:
    """On the same small plates, a mirror that misses a step is refused by name, not taken for the plate's edge."""
    broken = missed_step(session_of(targets, scans, FITTING["A3, moved"]), 1, 12)
    with pytest.raises(gp.CalibrationRefused) as refused:
        calibrate_session(broken, robot)
    assert "the mirror missed a step, or frames were swapped: plate a3_near_40: after stripe index 2" in str(
        refused.value
    )
    assert "fell off" not in str(refused.value)


@pytest.mark.parametrize("plate", [1, 2, 3])
def test_a_missed_step_near_a_plates_edge_is_refused(
    plate: int, targets: CalibrationSession, scans: Path, robot: RobotModel
) -> None:
    """Also where only a few stripes lie between the step and the edge, which could be taken for stripes beside it.

    The stripes after a step may lie where a plate of another height would put them: then that is the cause it names.
    """
    session = session_of(targets, scans, FITTING["A3, moved"])
    for first in (1, 3, 6, 15, 17, 20, 22, 25, 28, 31, 34):
        with pytest.raises(gp.CalibrationRefused, match="the mirror missed a step|plate heights look swapped"):
            calibrate_session(missed_step(session, plate, first), robot)


REFUSED = {
    (
        "area_40",
        "area_80",
    ): "or the stripe fell off the plate (scan the bare floor too, as a plate of 0 m): plate area_40",
    ("floor", "a3_near_40", "a3_near_80"): "stripes lie on plates of two heights (80 % needed); stripes 5",
    ("floor", "area_40", "away_80"): "plate away_80: all stripes are beside it: place it in the scanned area",
}


@pytest.mark.parametrize(("names", "reason"), REFUSED.items())
def test_plates_that_cannot_serve(
    targets: CalibrationSession, scans: Path, robot: RobotModel, names: tuple[str, ...], reason: str
) -> None:
    """Without the bare floor both faults are named; a plate that covers too little or nothing is refused."""
    with pytest.raises(gp.CalibrationRefused) as refused:
        calibrate_session(session_of(targets, scans, names), robot)
    assert reason in str(refused.value)


def test_the_operator_is_told_the_size(robot: RobotModel, monkeypatch: pytest.MonkeyPatch) -> None:
    """The request contains size and position of the plate."""
    asked: list[str] = []
    monkeypatch.setattr("click.pause", lambda text: None)
    operator = TextOperator(asked.append, Settings.of(robot))
    operator.lay_plate(0.0)
    operator.lay_plate(0.04)
    assert asked[0].startswith("Clear the floor in front of the robot: x 0.50 ... 0.95 m, y -0.27 ... 0.27 m")
    assert asked[1].startswith("Lay the plate of 40 mm, 0.45 x 0.54 m or larger, over x 0.50 ... 0.95 m")
