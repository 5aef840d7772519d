"""Crosses are fitted with exact derivatives; floor texture is no cross, and its fit is ended."""

from __future__ import annotations

import re

import numpy as np
import pytest
import scipy.optimize
from hypothesis import given, settings
from hypothesis import strategies as st

from guara_perception.app.record.simulated import SimulatedWorkshop
from guara_perception.app.targets.drawings import cross_points
from guara_perception.calibration.calibration_input import Fiducials
from guara_perception.calibration.crosses import MOST_FITS, _cross_derivatives, _cross_model, find_crosses
from guara_perception.calibration.mount import locate_camera
from guara_perception.exceptions import CalibrationRefused
from guara_perception.images import to_grey
from guara_perception.simulation.target_pictures import TargetCamera
from kinematics import load_robot
from tests.thorough import examples

POSITIONS = np.random.default_rng(0).uniform(-1.4, 1.4, (300, 2))
SMALL = st.floats(-0.3, 0.3)


@settings(max_examples=examples(30))
@given(
    centre=st.tuples(SMALL, SMALL),
    angles=st.tuples(SMALL, SMALL),
    size=st.tuples(st.floats(0.6, 1.5), st.floats(0.05, 0.3)),
    blur=st.floats(0.05, 0.3).flatmap(lambda blur: st.sampled_from([blur, -blur])),
    light=st.tuples(st.floats(-50, 200), st.floats(0, 255), st.floats(-20, 20), st.floats(-20, 20)),
)
def test_derivatives_agree_with_finite_differences(centre, angles, size, blur, light) -> None:
    """With respect to each of the eleven parameters."""
    p = np.array([*centre, *angles, *size, blur, *light])
    step = 1e-6 * np.eye(11)
    wanted = [(_cross_model(p + s, POSITIONS) - _cross_model(p - s, POSITIONS)) / 2e-6 for s in step]
    np.testing.assert_allclose(_cross_derivatives(p, POSITIONS), np.transpose(wanted), atol=1e-4 * max(1.0, light[0]))


@pytest.mark.slow
def test_texture_of_a_floor_is_no_cross(monkeypatch: pytest.MonkeyPatch) -> None:
    """A fit to soil that resembles a cross may not converge: it is ended, and the spot is no cross."""
    workshop, fits = SimulatedWorkshop(), []
    real = scipy.optimize.least_squares
    monkeypatch.setattr(scipy.optimize, "least_squares", lambda *a, **k: fits.append(real(*a, **k)) or fits[-1])
    with workshop.rangefinder as rangefinder:
        picture = rangefinder.camera.grab(60.0).image
    where = np.asarray(cross_points(workshop.robot))
    to_footprint = workshop.robot.stance_pose(workshop.stance).transform_base_to_footprint
    transform = to_footprint @ workshop.truth.transform_camera_to_base
    marks = find_crosses(to_grey(np.asarray(picture)), workshop.truth.camera, transform, where)
    endless = [fit for fit in fits if not fit.success]
    assert endless and all(fit.nfev <= MOST_FITS for fit in fits)
    assert sum(mark is not None for mark in marks) <= len(fits) - len(endless)


def refusal(lie: np.ndarray, given: np.ndarray) -> str:
    """Refusal of crosses that lie elsewhere than given; empty when there is none."""
    workshop = SimulatedWorkshop()
    to_footprint = workshop.robot.stance_pose(workshop.stance).transform_base_to_footprint
    seen = to_footprint @ workshop.truth.transform_camera_to_base
    picture = TargetCamera.of(workshop.truth.camera, seed=1).crosses(lie, seen)
    nominal = to_footprint @ workshop.robot.transform_camera_to_base
    try:
        locate_camera(to_grey(picture), workshop.truth.camera, Fiducials("crosses", given), nominal)
    except CalibrationRefused as error:
        return str(error)
    return ""


@pytest.mark.slow
@pytest.mark.parametrize("wrong", range(5))
@pytest.mark.parametrize("off", [(0.010, 0.0), (0.0, 0.010)])
def test_the_one_cross_that_was_measured_wrongly_is_named(wrong: int, off: tuple[float, float]) -> None:
    """With its distance and its position according to the others, by leaving out each cross in turn."""
    given = cross_points(load_robot("guara"))
    lie = given.copy()
    lie[wrong] += off
    named = f"according to the others, cross {wrong + 1} at"
    told = rf"{named} .* is (9|10|11) mm off: it is at \((.*), (.*)\); measure it again"
    found = re.search(told, refusal(lie, given))
    assert found is not None
    assert np.abs(np.array(found.groups()[1:], float) - lie[wrong]).max() < 0.002
    assert refusal(given, given) == ""


@pytest.mark.slow
@pytest.mark.parametrize("forgotten", range(5))
def test_a_forgotten_cross_is_named_and_no_cross_is_called_wrongly_measured(forgotten: int) -> None:
    """Even where a spot of the floor resembles a cross."""
    given = cross_points(load_robot("guara"))
    told = refusal(np.delete(given, forgotten, axis=0), given)
    assert f"cross {forgotten + 1} at " in told and "measure" not in told
    assert "4 of 5 crosses were found" in told or "only a weak match was found for" in told


@pytest.mark.slow
def test_of_four_crosses_none_can_be_told_from_the_others() -> None:
    """Any three crosses fit some pose."""
    given = cross_points(load_robot("guara"))[:4]
    lie = given + np.array([[0.01, 0.0], [0.0, 0.0], [0.0, 0.0], [0.0, 0.0]])
    assert refusal(lie, given).endswith("measure the points again")
